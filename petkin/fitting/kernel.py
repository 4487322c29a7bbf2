"""Look up, polish, look again: the compiled search for the best rates of every curve.

Per curve, in compressed coordinates z (see `table`), minimise over amplitudes x >= 0 and rates u

    | z - x0 blood - x1 b(u1) - x2 b(u2) |^2.

1. *Look up* (`look_up`): every pair of coarse nodes.
2. *Polish* (`lanes`): variable projection with exact three-variable non-negative least squares at every step and
   Levenberg-Marquardt damping. A lane that ends is given the next curve at once, so that registers stay full.
3. *Look again*: where the residual still points along an exponential, polish from it too (Frank-Wolfe's test for a sum
   of non-negative exponentials) and keep the better end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from petkin.fitting import lanes
from petkin.fitting.lanes import LANES, OWN, REGISTER, ROWS
from petkin.fitting.look_up import GROUP, look_up

#: Curves worked through at a time, a multiple of GROUP: what is kept of them fits the second-level cache.
BLOCK = 128

#: Columns of the kernel's answer.
U1, U2, X0, X1, X2, COST, STEPS = range(7)

#: Times that a curve is looked at again.
_MOST_ROUNDS = 4
#: Largest step in u.
_REACH = 2.0
#: Columns of a curve's plan.
_STAGE, _ROUNDS, _THIRD, _BEFORE = range(4)

#: Sums may be reassociated; NaN and infinity keep their meaning.
_FAST = {"reassoc", "contract", "nsz", "arcp"}


class Tables(NamedTuple):
    """The compressed table as the kernel reads it; positions x count nodes, u = low + spacing x.

    Args:
        blood: length of the blood atom along axis 0; 0 leaves blood out.
        low, spacing: of the nodes in u.
        rows: b and db/dx of every node, as columns (R, 2 nodes).
        gram: rows^T rows (2 nodes, 2 nodes).
        own: of every interval, the upper triangle of its 4 x 4 block of `gram` and its four entries of rows[0],
            (nodes - 1, OWN).
        coarse: nodes of the look-up (C,).
        atoms, lead, near: unit atoms off the blood axis there, their lean on it, their Gram matrix; any precision.
        toward: gram to the coarse nodes, each of unit length (2 nodes, C).
        lean: blood component of those (C,).
        lengths: |b| of the coarse nodes (C,).
    """

    blood: float
    low: float
    spacing: float
    rows: NDArray[np.float64]
    gram: NDArray[np.float64]
    own: NDArray[np.float64]
    coarse: NDArray[np.int64]
    atoms: NDArray[np.floating]
    lead: NDArray[np.floating]
    near: NDArray[np.floating]
    toward: NDArray[np.float64]
    lean: NDArray[np.float64]
    lengths: NDArray[np.float64]


class Scratch(NamedTuple):
    """Room to work in, made once a call."""

    seen: NDArray[np.float64]
    scaled: NDArray[np.floating]
    projections: NDArray[np.floating]
    scores: NDArray[np.floating]
    chosen: NDArray[np.int32]
    work: NDArray[np.float64]
    curve: NDArray[np.int64]
    plan: NDArray[np.float64]
    along: NDArray[np.float64]
    found: NDArray[np.float64]


def search(
    z: NDArray[np.float64], sizes: NDArray[np.float64], tables: Tables, tolerance: float, again: float
) -> NDArray[np.float64]:
    """Fit every column of z, on this thread and without the interpreter's lock.

    Args:
        z: compressed curves (R, N), C order.
        sizes: |z|^2 of every curve (N,).
        tables: see `Tables`.
        tolerance: a polish ends when its expected relative gain falls below this.
        again: second start where (r . b)^2 exceeds this share of the cost; infinity for none.

    Returns:
        (7, N): u1 >= u2, blood, x1, x2, cost (without the part of the curve outside the compressed space), steps of the
        polish that led there.
    """
    nodes, precision = len(tables.coarse), tables.atoms.dtype
    scratch = Scratch(
        seen=np.empty((BLOCK, tables.rows.shape[1])),
        scaled=np.zeros((len(z), GROUP), precision),
        projections=np.empty((nodes, GROUP), precision),
        scores=np.empty(GROUP, precision),
        chosen=np.empty(BLOCK, np.int32),
        work=np.zeros(ROWS * LANES),
        curve=np.empty(LANES, np.int64),
        plan=np.empty((BLOCK, 4)),
        along=np.empty(nodes),
        found=np.empty((BLOCK, 7)),
    )
    answer = np.empty((7, z.shape[1]))
    _search(z, sizes, tables, scratch, tolerance, again, answer)
    return answer


@njit(cache=True, nogil=True, error_model="numpy")
def _search(z, sizes, tables, scratch, tolerance, again, answer):
    # Arrays are unpacked once: handing the tuples on costs a reference count an array and call.
    blood, low, spacing, rows, gram, own, coarse, atoms, lead, near, toward, lean, lengths = tables
    seen, scaled, projections, scores, chosen, work, curve, plan, along, found = scratch
    last, reach = float(own.shape[0]), _REACH / spacing
    for start in range(0, z.shape[1], BLOCK):
        size = min(BLOCK, z.shape[1] - start)
        _see(z, start, size, rows, seen)
        for first in range(0, size, GROUP):
            _scale(z, sizes, start + first, min(GROUP, size - first), scaled)
            look_up(scaled, atoms, lead, near, blood > 0.0, projections, scores, chosen[first : first + GROUP])
        plan[:] = 0.0
        used = fed = 0
        while True:
            while used < LANES and fed < size:
                faster, slower = divmod(chosen[fed], len(coarse))
                curve[used] = fed
                _enter(work, used, coarse[faster], coarse[slower])
                work[lanes.SIZE * LANES + used] = sizes[start + fed]
                work[lanes.BLOOD_SEEN * LANES + used] = blood * z[0, start + fed]
                used, fed = used + 1, fed + 1
            if used == 0:
                break
            _gather(work, used, curve, gram, own, seen)
            registers = (used + REGISTER - 1) // REGISTER
            lanes.evaluate(work, registers, blood)
            lanes.propose(work, registers, last, reach, tolerance)
            n = 0
            while n < used:
                if work[lanes.DONE * LANES + n] == 0.0:
                    n += 1
                    continue
                v = curve[n]
                _settle(work, n, found, v, plan[v, _STAGE] == 0.0)
                x, y = _again(
                    found,
                    plan,
                    v,
                    seen,
                    blood,
                    own.shape[0],
                    coarse,
                    toward,
                    lean,
                    lengths,
                    along,
                    tolerance,
                    again,
                )
                if x >= 0.0:
                    _enter(work, n, x, y)
                    n += 1
                else:
                    used -= 1
                    curve[n] = curve[used]
                    for row in range(lanes.STATE):
                        work[row * LANES + n] = work[row * LANES + used]
        _hand_over(found, start, size, low, spacing, answer)


@njit(cache=True, error_model="numpy")
def _hand_over(found, start, size, low, spacing, answer):
    """A block's answers, the faster exponential first and u instead of positions."""
    for v in range(size):
        swap = found[v, U2] > found[v, U1]
        n = start + v
        answer[U1, n] = low + spacing * (found[v, U2] if swap else found[v, U1])
        answer[U2, n] = low + spacing * (found[v, U1] if swap else found[v, U2])
        answer[X1, n] = found[v, X2] if swap else found[v, X1]
        answer[X2, n] = found[v, X1] if swap else found[v, X2]
        answer[X0, n], answer[COST, n], answer[STEPS, n] = found[v, X0], found[v, COST], found[v, STEPS]


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _see(z, start, size, rows, seen):
    """Every row of the table on every curve of the block, eight directions at a time."""
    for v in range(size):
        n = start + v
        for k in range(rows.shape[1]):
            seen[v, k] = 0.0
        r = 0
        while r + 8 <= rows.shape[0]:
            z0, z1, z2, z3 = z[r, n], z[r + 1, n], z[r + 2, n], z[r + 3, n]
            z4, z5, z6, z7 = z[r + 4, n], z[r + 5, n], z[r + 6, n], z[r + 7, n]
            for k in range(rows.shape[1]):
                seen[v, k] += (
                    (z0 * rows[r, k] + z1 * rows[r + 1, k]) + (z2 * rows[r + 2, k] + z3 * rows[r + 3, k])
                ) + ((z4 * rows[r + 4, k] + z5 * rows[r + 5, k]) + (z6 * rows[r + 6, k] + z7 * rows[r + 7, k]))
            r += 8
        while r < rows.shape[0]:
            for k in range(rows.shape[1]):
                seen[v, k] += z[r, n] * rows[r, k]
            r += 1


@njit(cache=True, error_model="numpy")
def _scale(z, sizes, start, count, scaled):
    """Curves of unit length for the look-up."""
    for n in range(count):
        scale = 1.0 / np.sqrt(max(sizes[start + n], 1e-300))
        for r in range(z.shape[0]):
            scaled[r, n] = z[r, start + n] * scale


@njit(cache=True, error_model="numpy")
def _enter(work, n, x, y):
    """Start a polish from the positions x, y in lane n: the first trial counts as a gain."""
    for row in range(lanes.SIZE):
        work[row * LANES + n] = 0.0
    work[lanes.TRIAL_1 * LANES + n], work[lanes.TRIAL_2 * LANES + n] = x, y
    work[lanes.GAIN * LANES + n] = -1.0
    work[lanes.DAMPING * LANES + n] = 1e-2


@njit(cache=True, error_model="numpy")
def _gather(work, count, curve, gram, own, seen):
    """What the formulas need at every lane's trial. Unsigned indices are known not to count from the end."""
    last = np.uint64(own.shape[0] - 1)
    two = np.uint64(2)
    for n in range(count):
        v = np.uint64(curve[n])
        x = work[lanes.TRIAL_1 * LANES + n]
        i = min(np.uint64(x), last)
        work[lanes.FRACTION_1 * LANES + n] = x - i
        for k in range(OWN):
            work[(lanes.OWN_1 + k) * LANES + n] = own[i, np.uint64(k)]
        for k in range(4):
            work[(lanes.SEEN_1 + k) * LANES + n] = seen[v, two * i + np.uint64(k)]
        y = work[lanes.TRIAL_2 * LANES + n]
        j = min(np.uint64(y), last)
        work[lanes.FRACTION_2 * LANES + n] = y - j
        for k in range(OWN):
            work[(lanes.OWN_2 + k) * LANES + n] = own[j, np.uint64(k)]
        for k in range(4):
            row = two * j + np.uint64(k)
            work[(lanes.SEEN_2 + k) * LANES + n] = seen[v, row]
            for m in range(4):
                work[(lanes.CROSS + 4 * k + m) * LANES + n] = gram[row, two * i + np.uint64(m)]


@njit(cache=True, error_model="numpy")
def _settle(work, n, out, v, first):
    """A lane's end into the answer (positions instead of u), if it is the first or better than what is there."""
    cost = work[lanes.SIZE * LANES + n] - work[lanes.GAIN * LANES + n]
    if first or cost < out[v, COST]:
        out[v, U1], out[v, U2] = work[lanes.POSITION_1 * LANES + n], work[lanes.POSITION_2 * LANES + n]
        out[v, X0], out[v, X1] = work[lanes.BLOOD * LANES + n], work[lanes.FIRST * LANES + n]
        out[v, X2], out[v, COST], out[v, STEPS] = work[lanes.SECOND * LANES + n], cost, work[lanes.STEPS * LANES + n]


@njit(cache=True, error_model="numpy")
def _again(out, plan, v, seen, blood, intervals, coarse, toward, lean, lengths, along, tolerance, again):
    """Positions of the curve's next polish, or -1 where it is finished."""
    if plan[v, _STAGE] == 1.0 and out[v, X2] > 0.0:
        plan[v, _STAGE] = 2.0
        return max(out[v, U2], plan[v, _THIRD]), min(out[v, U2], plan[v, _THIRD])
    if plan[v, _STAGE] > 0.0 and out[v, COST] > plan[v, _BEFORE] * (1.0 - tolerance):
        return -1.0, 0.0
    if plan[v, _ROUNDS] == _MOST_ROUNDS:
        return -1.0, 0.0
    gain, node = _point(out, v, seen, blood, intervals, coarse, toward, lean, lengths, along)
    if node < 0 or gain <= again * out[v, COST]:
        return -1.0, 0.0
    third = float(coarse[node])
    plan[v, _ROUNDS] += 1.0
    plan[v, _THIRD], plan[v, _BEFORE] = third, out[v, COST]
    plan[v, _STAGE] = 1.0 if out[v, X1] > 0.0 else 2.0
    keep = out[v, U1] if out[v, X1] > 0.0 else out[v, U2]
    return max(keep, third), min(keep, third)


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _point(out, v, seen, blood, intervals, coarse, toward, lean, lengths, along):
    """Largest (r . b / |b|)^2 over coarse nodes with r . b > 0, and its node (-1 if none); r the residual."""
    i, j = min(int(out[v, U1]), intervals - 1), min(int(out[v, U2]), intervals - 1)
    a0, a1, a2, a3 = lanes.value_weights(out[v, U1] - i)
    b0, b1, b2, b3 = lanes.value_weights(out[v, U2] - j)
    one, two = -out[v, X1], -out[v, X2]
    i, j, bled = 2 * i, 2 * j, out[v, X0] * blood
    for c in range(len(coarse)):
        along[c] = seen[v, 2 * coarse[c]] / lengths[c]
    for c in range(len(coarse)):
        first = a0 * toward[i, c] + a1 * toward[i + 1, c] + a2 * toward[i + 2, c] + a3 * toward[i + 3, c]
        other = b0 * toward[j, c] + b1 * toward[j + 1, c] + b2 * toward[j + 2, c] + b3 * toward[j + 3, c]
        along[c] += one * first + two * other - bled * lean[c]
    node = 0
    for c in range(1, len(coarse)):
        node = c if along[c] > along[node] else node
    return (along[node] ** 2, node) if along[node] > 0.0 else (0.0, -1)
