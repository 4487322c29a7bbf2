"""One free rate beside columns that all curves share: scored at every third node, then climbed to the top.

Per curve, in compressed coordinates z, minimise over amplitudes x and one rate a = exp(u) - RATE_OFFSET

    | z - x0 axis - x1 b(u) - x2 b(0) |^2,

axis the first coordinate (blood, or a reference curve), b(0) the last column of a trapping model. With the amplitudes
projected out this is a function of one number, so all of its interval is looked at and no second start is needed; it
is made of polynomials (`off_atoms`), and Newton's steps end the search (`climb`).
It serves 1TCM (`SINGLE`: x0, x1 >= 0), 2TCM3k (`TRAPPED`: and x2 >= 0) and SRTM (`SIGNED`: x0, x1 of either sign).

On any `Compression` (kinds from `petkin.fitting.scan`, the rest from here and beside):

    packed = compress(build_table(arterial, observation, rate_bounds=(slow, fast), nodes=80), weights, size=16)
    z, sizes, finite, signal = project_curves(packed, weights, frames, 0, N)
    found = search_one_rate(one_rate_tables(packed, SIGNED), z, sizes)
    R1, x1, a = found[X0], found[X1], np.exp(found[U1]) - RATE_OFFSET

For SRTM the table is built from `InputFunction(reference, reference)`; there R1 = x0, k2 = x1 + R1 a and
BPND = k2 / a - 1.

Reference: Gunn RN, Lammertsma AA, Hume SP, Cunningham VJ. NeuroImage 1997;6:279-287, doi:10.1006/nimg.1997.0303
(one rate, linear amplitudes); Golub GH, Pereyra V. SIAM J Numer Anal 1973;10:413-432, doi:10.1137/0710036.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import climb
from petkin.fitting.blocks import BLOCK, even_rows, multiply
from petkin.fitting.off_atoms import off_atoms, shared_axes, supports, without
from petkin.fitting.projection import lens, note, project_block
from petkin.fitting.scan import SIGNED, TRAPPED, score, shrink
from petkin.fitting.table import Compression
from petkin.jit import njit

Array = NDArray[np.float64]

#: Columns of the answer: u of the free rate and of the trapped column; amplitudes of axis, b(u), b(0); cost; steps.
U1, U2, X0, X1, X2, COST, STEPS = range(7)

#: Nodes from one that is scanned to the next.
_SCANNED = 3
#: Least position beside b(0).
_APART = 1e-3


class OneRateTables(NamedTuple):
    """A compressed table as this kernel reads it; positions x count nodes, u = low + spacing x.

    Args:
        kind: `SINGLE`, `TRAPPED` or `SIGNED`.
        has_axis: whether the shared column along the first coordinate takes part.
        low, spacing: of the nodes in u.
        first, last: positions that the free rate keeps between; the first of every support (S,).
        axes, mix: of every support, orthonormal axes of axis and b(0) where they are at work, and what makes their
            amplitudes from components along them (S, 2, R), (S, 2, 2).
        without: of every support, numbers of those without axis and without b(0) (S, 2); -1 for none.
        cubics, numbers: of every support, see `off_atoms`, flat (S, cells * R * 4), (S, cells * NUMBERS).
        node: the first that is scanned; then every third.
        scanned: unit atoms there, off the axis, single precision, an even number of rows.
        lead: their lean on the axis (C,), 0 without it.
        near: their lean on b(0), which is the first of them where that takes part (C,).
    """

    kind: int
    has_axis: bool
    low: float
    spacing: float
    first: Array
    last: float
    axes: Array
    mix: Array
    without: Array
    cubics: Array
    numbers: Array
    node: int
    scanned: NDArray[np.floating]
    lead: NDArray[np.float32]
    near: NDArray[np.float32]


def one_rate_tables(
    packed: Compression, kind: int, *, axis: bool = True, rates: tuple[float, float] = (0.0, np.inf)
) -> OneRateTables:
    """Tables for `search_one_rate`.

    Args:
        packed: compressed table; for `TRAPPED` its first node must be a = 0.
        kind: `SINGLE`, `TRAPPED` or `SIGNED`.
        axis: whether the column along the first coordinate takes part.
        rates: interval of the free rate, 1/min; the table's where that is narrower.
    """
    spacing = float(packed.u[1] - packed.u[0])
    columns = np.stack([packed.blood * axis * np.eye(1, packed.size)[0], packed.basis[0] * (kind == TRAPPED)])
    chosen = supports(columns, all_free=kind == SIGNED)
    at_work = [shared_axes(columns, support) for support in chosen]
    atoms = [off_atoms(packed.basis, packed.slope * spacing, axes) for axes, _ in at_work]
    first, last = packed.positions(rates)
    node = int(np.ceil(first))
    scanned = packed.basis[node : int(last) + 1 : _SCANNED].copy()
    lead = scanned[:, 0].copy() if axis else np.zeros(len(scanned))
    if axis:
        scanned[:, 0] = 0.0
    length = np.linalg.norm(scanned, axis=1)
    scanned /= length[:, None]
    return OneRateTables(
        kind,
        axis,
        float(packed.u[0]),
        spacing,
        # Where b(0) is among the columns at work, b(u) must lie off it.
        np.array([max(first, _APART) if numbers[0, 0] == 0.0 else first for _, numbers in atoms]),
        last,
        np.stack([axes for axes, _ in at_work]),
        np.stack([mix for _, mix in at_work]),
        np.array([[without(chosen, at, d) for d in range(2)] for at in chosen], np.float64),
        np.stack([cubics.ravel() for cubics, _ in atoms]),
        np.stack([numbers.ravel() for _, numbers in atoms]),
        node,
        even_rows(scanned.astype(np.float32)),
        (lead / length).astype(np.float32),
        (scanned @ scanned[0]).astype(np.float32),
    )


def search_one_rate(tables: OneRateTables, z: Array, sizes: Array) -> Array:
    """Best rate and amplitudes of every column of z, on this thread and without the interpreter's lock.

    Args:
        tables: from `one_rate_tables`.
        z: compressed curves (R, N), C order.
        sizes: sum_k w_k y_k^2 of every curve (N,).

    Returns:
        (7, N): u, u of b(0), x0, x1, x2, cost, steps; `MAX_STEPS` where it did not converge.
    """
    answer = np.empty((7, z.shape[1]))
    _search(z, sizes, np.zeros(len(z) * BLOCK), tables, _scratch(tables, len(z)), answer)
    return answer


def search_in_frames(
    tables: OneRateTables,
    packed: Compression,
    weights: Array,
    frames: NDArray[np.floating],
    rows: slice,
    *,
    off: float = 0.0,
) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """The same from frame values, seen through the compression block by block, which never leave the cache.

    Args:
        tables: from `one_rate_tables`.
        packed, weights, frames: see `project_curves`.
        rows: which curves, with a start and a stop.
        off: taken off every curve along the axis.

    Returns:
        as `search_one_rate`, and what `project_curves` says beside coordinates.
    """
    count = rows.stop - rows.start
    answer, sizes = np.empty((7, count)), np.empty(count)
    finite, signal = np.empty((2, count), np.bool_)
    scratch = _scratch(tables, packed.size)
    _search_frames(frames, rows.start, lens(packed, weights), off, tables, scratch, answer, sizes, finite, signal)
    return answer, sizes, finite, signal


def _scratch(tables: OneRateTables, size: int) -> tuple[NDArray[Any], ...]:
    """Room to work in: lengths, the block at unit length, scores, what climbs."""
    seen, scores = np.zeros((2, len(tables.scanned), BLOCK), np.float32)
    return (
        np.empty(BLOCK),
        np.zeros(size * BLOCK, np.float32),
        seen.ravel(),
        seen,
        scores,
        np.empty(BLOCK, np.float32),
        np.empty(BLOCK, np.int32),
        np.empty(BLOCK, np.int64),
        np.zeros(climb.ROWS * BLOCK),
    )


@njit(nogil=True)
def _search(z, sizes, here, tables, scratch, answer):
    for start in range(0, z.shape[1], BLOCK):
        size = min(BLOCK, z.shape[1] - start)
        for r in range(z.shape[0]):
            row = z[r, start : start + size]
            for n in range(size):
                here[r * BLOCK + n] = row[n]
            for n in range(size, BLOCK):
                here[r * BLOCK + n] = 0.0
        _search_block(here, sizes[start : start + size], tables, scratch, answer[:, start : start + size])


@njit(nogil=True)
def _search_frames(frames, first, seen, off, tables, scratch, answer, sizes, finite, signal):
    here = seen.block
    for start in range(0, answer.shape[1], BLOCK):
        size = min(BLOCK, answer.shape[1] - start)
        project_block(frames, first + start, size, seen)
        note(seen, start, size, sizes, finite, signal)
        if off != 0.0:
            for n in range(size):
                before = here[n]
                here[n] -= off
                sizes[start + n] -= off * (before + here[n])
        _search_block(here, sizes[start : start + size], tables, scratch, answer[:, start : start + size])


@njit()
def _search_block(here, sizes, tables, scratch, answer):
    """Answers of the curves of a block, flat rows."""
    # Arrays are unpacked once: handing the tuples on costs a reference count an array and call.
    kind, axis, low, spacing, first, last, axes, mix, without, cubics, numbers, node, scanned, lead, near = tables
    lengths, scaled, flat, seen, scores, top, best, slots, work = scratch
    signed, size = kind == SIGNED, len(sizes)
    shrink(here, sizes, lengths, scaled)
    multiply(scanned, scaled, flat)
    score(scaled, seen, lead, near, kind, axis, scores, top, best)
    _start(scores[: len(lead)], best, size, node, work)
    for s in range(len(cubics)):
        if climb.climb(s, cubics[s], numbers[s], here, size, first[s], last, signed, slots, work):
            climb.project_shared(axes[s], here, work)
            climb.settle(mix[s], s, without[s], signed, work)
    _hand_over(work, sizes, low, spacing, answer)


@njit(fastmath={"contract", "nsz"})
def _start(scores, best, size, node, work):
    """Where to climb from: the top of the parabola through the best node and its neighbours."""
    for row in (climb.WANTED, climb.GAIN, climb.X0, climb.X1, climb.X2):
        for n in range(BLOCK):
            work[row * BLOCK + n] = 0.0
    for n in range(size):
        i = best[n]
        offset = 0.0
        if 0 < i < scores.shape[0] - 1:
            below, top, above = float(scores[i - 1, n]), float(scores[i, n]), float(scores[i + 1, n])
            bend = 2.0 * top - below - above
            offset = (above - below) / bend if bend > 0.0 else 0.0
        work[climb.START * BLOCK + n] = work[climb.BEST * BLOCK + n] = node + _SCANNED * (i + 0.5 * offset)


@njit()
def _hand_over(work, sizes, low, spacing, answer):
    """A block's answers."""
    for n in range(len(sizes)):
        answer[U1, n] = low + spacing * work[climb.BEST * BLOCK + n]
        answer[U2, n] = low
        answer[X0, n] = work[climb.X0 * BLOCK + n]
        answer[X1, n] = work[climb.X1 * BLOCK + n]
        answer[X2, n] = work[climb.X2 * BLOCK + n]
        answer[COST, n] = sizes[n] - work[climb.GAIN * BLOCK + n]
        answer[STEPS, n] = work[climb.STEPS * BLOCK + n]
