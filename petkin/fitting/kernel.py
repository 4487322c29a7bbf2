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
from numpy.typing import NDArray

from petkin.fitting import lanes
from petkin.fitting.lanes import LANES, OWN, REGISTER, ROWS
from petkin.fitting.look_up import GROUP, look_up
from petkin.jit import njit

#: Curves worked through at a time, a multiple of GROUP: what is kept of them fits the second-level cache.
BLOCK = 128

#: Columns of the kernel's answer.
U1, U2, X0, X1, X2, COST, STEPS = range(7)

#: Times that a curve is looked at again.
MOST_ROUNDS = 4
#: Largest step in u.
REACH = 2.0
#: Columns of a curve's plan.
_STAGE, _ROUNDS, _THIRD, _BEFORE = range(4)

#: Sums may be reassociated; NaN and infinity keep their meaning.
_STRICT = {"contract", "nsz"}
_FAST = {"reassoc", "contract", "nsz", "arcp"}


class Tables(NamedTuple):
    """The compressed table as the kernel reads it; positions x count nodes, u = low + spacing x.

    Args:
        blood: length of the blood atom along axis 0; 0 leaves blood out.
        low, spacing: of the nodes in u.
        first, last: positions that rates keep between.
        rows: b and db/dx of every node, as columns (R, 2 nodes).
        gram: rows^T rows (2 nodes, 2 nodes).
        own: of every interval, the upper triangle of its 4 x 4 block of `gram` and its four entries of rows[0],
            (nodes - 1, OWN).
        coarse: nodes of the look-up (C,).
        atoms, lead, near: unit atoms off the blood axis there, their lean on it, their Gram matrix; any precision.
        units: unit vectors along b at the coarse nodes (C, R).
        lean: their lean on the axis (C,).
        toward: rows to those, flat (2 nodes * C,).
    """

    blood: float
    low: float
    spacing: float
    first: float
    last: float
    rows: NDArray[np.float64]
    gram: NDArray[np.float64]
    own: NDArray[np.float64]
    coarse: NDArray[np.int64]
    atoms: NDArray[np.floating]
    lead: NDArray[np.floating]
    near: NDArray[np.floating]
    units: NDArray[np.float64]
    lean: NDArray[np.float64]
    toward: NDArray[np.float64]


class Scratch(NamedTuple):
    """Room to work in, made once a call."""

    curves: NDArray[np.float64]
    room: NDArray[np.float64]
    beside: NDArray[np.float64]
    scaled: NDArray[np.floating]
    projections: NDArray[np.floating]
    scores: NDArray[np.floating]
    chosen: NDArray[np.int32]
    work: NDArray[np.float64]
    curve: NDArray[np.int64]
    plan: NDArray[np.float64]
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
        curves=np.empty((BLOCK, len(z))),
        room=np.empty(BLOCK),
        beside=np.empty((BLOCK, nodes)),
        scaled=np.zeros((len(z), GROUP), precision),
        projections=np.empty((nodes, GROUP), precision),
        scores=np.empty(GROUP, precision),
        chosen=np.empty(BLOCK, np.int32),
        work=np.zeros(ROWS * LANES),
        curve=np.empty(LANES, np.int64),
        plan=np.empty((BLOCK, 4)),
        found=np.empty((BLOCK, 7)),
    )
    answer = np.empty((7, z.shape[1]))
    _search(z, sizes, tables, scratch, tolerance, again, answer)
    return answer


@njit(nogil=True)
def _search(z, sizes, tables, scratch, tolerance, again, answer):
    # Arrays are unpacked once: handing the tuples on costs a reference count an array and call.
    blood, low, spacing, lowest, highest, rows, gram, own, coarse, atoms, lead, near, units, lean, toward = tables
    curves, room, beside, scaled, projections, scores, chosen, work, curve, plan, found = scratch
    reach = REACH / spacing
    for start in range(0, z.shape[1], BLOCK):
        size = min(BLOCK, z.shape[1] - start)
        _see(z, start, size, units, curves, room, beside)
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
            _gather(work, used, curve, curves, rows, gram, own)
            registers = (used + REGISTER - 1) // REGISTER
            lanes.evaluate(work, registers, blood)
            lanes.propose(work, registers, lowest, highest, reach, tolerance)
            n = 0
            while n < used:
                if work[lanes.DONE * LANES + n] == 0.0:
                    n += 1
                    continue
                v = curve[n]
                _settle(work, n, found, v, plan[v, _STAGE] == 0.0)
                x, y = _again(found, plan, v, beside, blood, coarse, lean, toward, tolerance, again)
                if x >= 0.0:
                    _enter(work, n, x, y)
                    n += 1
                else:
                    used -= 1
                    curve[n] = curve[used]
                    for row in range(lanes.STATE):
                        work[row * LANES + n] = work[row * LANES + used]
                    work[lanes.CELL_1 * LANES + n] = work[lanes.CELL_2 * LANES + n] = -1.0
        _hand_over(found, start, size, low, spacing, answer)


@njit()
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


@njit(fastmath=_STRICT)
def _see(z, start, size, units, curves, room, beside):
    """A block's curves, one after another, and their components along the coarse nodes."""
    for r in range(z.shape[0]):
        here = z[r, start : start + size]
        for v in range(size):
            curves[v, r] = here[v]
    for c in range(units.shape[0]):
        for v in range(size):
            room[v] = 0.0
        r = 0
        while r + 4 <= units.shape[1]:
            u0, u1, u2, u3 = units[c, r], units[c, r + 1], units[c, r + 2], units[c, r + 3]
            z0, z1, z2, z3 = z[r, start:], z[r + 1, start:], z[r + 2, start:], z[r + 3, start:]
            for v in range(size):
                room[v] += (u0 * z0[v] + u1 * z1[v]) + (u2 * z2[v] + u3 * z3[v])
            r += 4
        while r < units.shape[1]:
            for v in range(size):
                room[v] += units[c, r] * z[r, start + v]
            r += 1
        for v in range(size):
            beside[v, c] = room[v]


@njit()
def _scale(z, sizes, start, count, scaled):
    """Curves of unit length for the look-up."""
    for n in range(count):
        scale = 1.0 / np.sqrt(max(sizes[start + n], 1e-300))
        for r in range(z.shape[0]):
            scaled[r, n] = z[r, start + n] * scale


@njit(forceinline=True)
def _enter(work, n, x, y):
    """Start a polish from the positions x, y in lane n: the first trial counts as a gain."""
    for row in range(lanes.SIZE):
        work[row * LANES + n] = 0.0
    work[lanes.TRIAL_1 * LANES + n], work[lanes.TRIAL_2 * LANES + n] = x, y
    work[lanes.CELL_1 * LANES + n] = work[lanes.CELL_2 * LANES + n] = -1.0
    work[lanes.GAIN * LANES + n] = -1.0
    work[lanes.DAMPING * LANES + n] = 1e-2


@njit()
def _gather(work, count, curve, curves, rows, gram, own):
    """What the formulas need at every lane's trial, where its cell is another than before."""
    # Unsigned indices are known not to count from the end.
    last, two = np.uint64(own.shape[0] - 1), np.uint64(2)
    for n in range(count):
        x, y = work[lanes.TRIAL_1 * LANES + n], work[lanes.TRIAL_2 * LANES + n]
        i, j = min(np.uint64(x), last), min(np.uint64(y), last)
        work[lanes.FRACTION_1 * LANES + n], work[lanes.FRACTION_2 * LANES + n] = x - i, y - j
        new_1, new_2 = work[lanes.CELL_1 * LANES + n] != i, work[lanes.CELL_2 * LANES + n] != j
        if new_1:
            work[lanes.CELL_1 * LANES + n] = i
            _gather_one(work, n, i, lanes.OWN_1, lanes.SEEN_1, curves[curve[n]], rows, own)
        if new_2:
            work[lanes.CELL_2 * LANES + n] = j
            _gather_one(work, n, j, lanes.OWN_2, lanes.SEEN_2, curves[curve[n]], rows, own)
        if new_1 | new_2:
            for k in range(4):
                for m in range(4):
                    work[(lanes.CROSS + 4 * k + m) * LANES + n] = gram[two * j + np.uint64(k), two * i + np.uint64(m)]


@njit(fastmath=_STRICT, forceinline=True)
def _gather_one(work, n, cell, own_row, seen_row, z, rows, own):
    """The record of a cell, and its four rows on the curve."""
    for k in range(OWN):
        work[(own_row + k) * LANES + n] = own[cell, np.uint64(k)]
    first = np.uint64(2) * cell
    second, third, fourth = first + np.uint64(1), first + np.uint64(2), first + np.uint64(3)
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    for r in range(len(z)):
        here = z[r]
        s0 += rows[r, first] * here
        s1 += rows[r, second] * here
        s2 += rows[r, third] * here
        s3 += rows[r, fourth] * here
    k = seen_row * LANES + n
    work[k], work[k + LANES], work[k + 2 * LANES], work[k + 3 * LANES] = s0, s1, s2, s3


@njit(forceinline=True)
def _settle(work, n, out, v, first):
    """A lane's end into the answer (positions instead of u), if it is the first or better than what is there."""
    cost = work[lanes.SIZE * LANES + n] - work[lanes.GAIN * LANES + n]
    if first or cost < out[v, COST]:
        out[v, U1], out[v, U2] = work[lanes.POSITION_1 * LANES + n], work[lanes.POSITION_2 * LANES + n]
        out[v, X0], out[v, X1] = work[lanes.BLOOD * LANES + n], work[lanes.FIRST * LANES + n]
        out[v, X2], out[v, COST], out[v, STEPS] = work[lanes.SECOND * LANES + n], cost, work[lanes.STEPS * LANES + n]


@njit(forceinline=True)
def _again(out, plan, v, beside, blood, coarse, lean, toward, tolerance, again):
    """Positions of the curve's next polish, or -1 where it is finished."""
    if plan[v, _STAGE] == 1.0 and out[v, X2] > 0.0:
        plan[v, _STAGE] = 2.0
        return max(out[v, U2], plan[v, _THIRD]), min(out[v, U2], plan[v, _THIRD])
    if plan[v, _STAGE] > 0.0 and out[v, COST] > plan[v, _BEFORE] * (1.0 - tolerance):
        return -1.0, 0.0
    if plan[v, _ROUNDS] == MOST_ROUNDS:
        return -1.0, 0.0
    first, second = _taken(out[v, U1], out[v, X1], lean, toward), _taken(out[v, U2], out[v, X2], lean, toward)
    taken = (first, second, out[v, X0] * blood)
    if _count_above(np.sqrt(again * out[v, COST]), beside, v, taken, lean, toward) == 0:
        return -1.0, 0.0
    node = _steepest(beside, v, taken, lean, toward)
    third = float(coarse[node])
    plan[v, _ROUNDS] += 1.0
    plan[v, _THIRD], plan[v, _BEFORE] = third, out[v, COST]
    plan[v, _STAGE] = 1.0 if out[v, X1] > 0.0 else 2.0
    keep = out[v, U1] if out[v, X1] > 0.0 else out[v, U2]
    return max(keep, third), min(keep, third)


@njit(fastmath=_STRICT, forceinline=True)
def _along(c, beside, v, taken, lean, toward):
    """What the residual holds along coarse node c."""
    (i, a0, a1, a2, a3), (j, b0, b1, b2, b3), bled = taken
    p, q, nodes = i + np.uint64(c), j + np.uint64(c), np.uint64(len(lean))
    twice = nodes + nodes
    first = (a0 * toward[p] + a1 * toward[p + nodes]) + (a2 * toward[p + twice] + a3 * toward[p + twice + nodes])
    second = (b0 * toward[q] + b1 * toward[q + nodes]) + (b2 * toward[q + twice] + b3 * toward[q + twice + nodes])
    return beside[v, np.uint64(c)] - bled * lean[c] - first - second


@njit(forceinline=True)
def _taken(position, x, lean, toward):
    """Where the four rows of an exponential begin in `toward`, and what they are weighted by."""
    nodes = len(lean)
    i = min(int(position), len(toward) // (2 * nodes) - 2)
    a0, a1, a2, a3 = lanes.value_weights(position - i)
    return np.uint64(2 * i * nodes), x * a0, x * a1, x * a2, x * a3


@njit(fastmath=_STRICT, forceinline=True)
def _count_above(threshold, beside, v, taken, lean, toward):
    """Coarse nodes along which the residual exceeds the threshold."""
    count = 0
    for c in range(len(lean)):
        count += _along(c, beside, v, taken, lean, toward) > threshold
    return count


@njit()
def _steepest(beside, v, taken, lean, toward):
    """The coarse node along which it is largest."""
    node, top = 0, -np.inf
    for c in range(len(lean)):
        here = _along(c, beside, v, taken, lean, toward)
        node, top = (c, here) if here > top else (node, top)
    return node
