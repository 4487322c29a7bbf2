"""One free rate beside columns that all curves share: scored at every other node, then a few Newton steps.

Per curve, in compressed coordinates z, minimise over amplitudes x and one rate a = exp(u) - RATE_OFFSET

    | z - x0 axis - x1 b(u) - x2 b(0) |^2,

axis the first coordinate (blood, or a reference curve), b(0) the last column of a trapping model. With the amplitudes
projected out this is a function of one number, so all of its interval is looked at and no second start is needed.
It serves 1TCM (`SINGLE`: x0, x1 >= 0), 2TCM3k (`TRAPPED`: and x2 >= 0) and SRTM (`SIGNED`: x0, x1 of either sign).

On any `Compression` (kinds from `petkin.fitting.scan`, the rest from here and beside):

    packed = compress(build_table(arterial, observation, rate_bounds=(slow, fast), nodes=80), weights, size=16)
    z, sizes, finite, signal = project_curves(packed, weights, frames, 0, N)
    found = search_one_rate(one_rate_tables(packed), z, sizes, SIGNED, tolerance=1e-4)
    R1, x1, a = found[X0], found[X1], np.exp(found[U1]) - RATE_OFFSET

For SRTM the table is built from `InputFunction(reference, reference)`; there R1 = x0, k2 = x1 + R1 a and
BPND = k2 / a - 1.

Reference: Gunn RN, Lammertsma AA, Hume SP, Cunningham VJ. NeuroImage 1997;6:279-287, doi:10.1006/nimg.1997.0303
(one rate, linear amplitudes); Golub GH, Pereyra V. SIAM J Numer Anal 1973;10:413-432, doi:10.1137/0710036.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from petkin.fitting import newton
from petkin.fitting.scan import BLOCK, SIGNED, TRAPPED, project, score, take
from petkin.fitting.table import Compression

Array = NDArray[np.float64]

#: Columns of the answer: u of the free rate and of the trapped column; amplitudes of axis, b(u), b(0); cost; steps.
U1, U2, X0, X1, X2, COST, STEPS = range(7)


class OneRateTables(NamedTuple):
    """A compressed table as this kernel reads it; positions x count nodes, u = low + spacing x.

    Args:
        axis: length of the shared column along the first coordinate; 0 leaves it out.
        low, spacing: of the nodes in u.
        first, last: positions that the free rate keeps between.
        rows: b and db/dx of every node, as columns (R, 2 nodes).
        own: see `InnerProducts`.
        trap: rows on b(0) (2 nodes,).
        node: the first that is scanned; then every other.
        scanned: unit atoms there, off the axis (C, R), single precision.
        lead: their lean on the axis (C,), 0 without it.
        near: their lean on b(0), which is the first of them where that takes part (C,).
    """

    axis: float
    low: float
    spacing: float
    first: float
    last: float
    rows: Array
    own: Array
    trap: Array
    node: int
    scanned: NDArray[np.float32]
    lead: NDArray[np.float32]
    near: NDArray[np.float32]


def one_rate_tables(
    packed: Compression, *, axis: bool = True, rates: tuple[float, float] = (0.0, np.inf)
) -> OneRateTables:
    """Tables for `search_one_rate`.

    Args:
        packed: compressed table; for `TRAPPED` its first node must be a = 0.
        axis: whether the column along the first coordinate takes part.
        rates: interval of the free rate, 1/min; the table's where that is narrower.
    """
    products = packed.products
    first, last = packed.positions(rates)
    atoms = packed.basis[int(np.ceil(first)) : int(last) + 1 : 2].copy()
    lead = atoms[:, 0].copy() if axis else np.zeros(len(atoms))
    if axis:
        atoms[:, 0] = 0.0
    length = np.linalg.norm(atoms, axis=1)
    atoms /= length[:, None]
    return OneRateTables(
        packed.blood if axis else 0.0,
        products.low,
        products.spacing,
        first,
        last,
        products.rows,
        products.own,
        products.gram[:, 0].copy(),
        int(np.ceil(first)),
        atoms.astype(np.float32),
        (lead / length).astype(np.float32),
        (atoms @ atoms[0]).astype(np.float32),
    )


def search_one_rate(tables: OneRateTables, z: Array, sizes: Array, kind: int, *, tolerance: float) -> Array:
    """Best rate and amplitudes of every column of z, on this thread and without the interpreter's lock.

    Args:
        tables: from `one_rate_tables`.
        z: compressed curves (R, N), C order.
        sizes: sum_k w_k y_k^2 of every curve (N,).
        kind: `SINGLE`, `TRAPPED` or `SIGNED`.
        tolerance: the step that promises less than this share of the cost is the last.

    Returns:
        (7, N): u, u of b(0), x0, x1, x2, cost, steps; `MAX_STEPS` where it did not converge.
    """
    answer = np.empty((7, z.shape[1]))
    nodes = len(tables.lead)
    scratch = (
        np.zeros((len(z), BLOCK)),
        np.empty(BLOCK),
        np.zeros((len(z), BLOCK), np.float32),
        np.empty((nodes, BLOCK), np.float32),
        np.zeros((nodes, BLOCK), np.float32),
        np.empty(BLOCK, np.float32),
        np.empty(BLOCK, np.int32),
        np.zeros(newton.ROWS * BLOCK),
    )
    _search(z, sizes, tables, scratch, kind, tolerance, answer)
    return answer


@njit(cache=True, nogil=True, error_model="numpy")
def _search(z, sizes, tables, scratch, kind, tolerance, answer):
    # Arrays are unpacked once: handing the tuples on costs a reference count an array and call.
    axis, low, spacing, first, last, rows, own, trap, node, scanned, lead, near = tables
    here, lengths, scaled, along, scores, top, best, work = scratch
    for start in range(0, z.shape[1], BLOCK):
        size = min(BLOCK, z.shape[1] - start)
        take(z, sizes, start, size, here, lengths, scaled)
        project(scanned, scaled, along)
        score(scaled, along, lead, near, kind, axis > 0.0, scores, top, best)
        _start(here, sizes, rows, kind, axis > 0.0, scores, best, start, size, node, first, last, work)
        left = size
        while left > 0:
            newton.gather(here, rows, own, trap, kind == TRAPPED, size, work)
            if kind == TRAPPED:
                newton.step(work, axis > 0.0, rows[0, 0], trap[0], first, last, tolerance, True, False)
            elif kind == SIGNED:
                newton.step(work, axis > 0.0, 0.0, 0.0, first, last, tolerance, False, True)
            else:
                newton.step(work, axis > 0.0, 0.0, 0.0, first, last, tolerance, False, False)
            left = 0
            for n in range(size):
                left += work[newton.DONE * BLOCK + n] < newton.ENDED
        _hand_over(work, start, size, axis, low, spacing, answer)


@njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")
def _start(here, sizes, rows, kind, has_axis, scores, best, start, size, node, first, last, work):
    """The first trial: the top of the parabola through the best node and its neighbours."""
    for row in range(newton.OWN):
        for n in range(BLOCK):
            work[row * BLOCK + n] = 0.0
    for n in range(BLOCK):
        work[newton.CELL * BLOCK + n] = -1.0
        work[newton.GAIN * BLOCK + n] = -1.0
        work[newton.ON_AXIS * BLOCK + n] = here[0, n] if has_axis else 0.0
    if kind == TRAPPED:
        for r in range(here.shape[0]):
            for n in range(BLOCK):
                work[newton.ON_TRAP * BLOCK + n] += rows[r, 0] * here[r, n]
    for n in range(size):
        i = best[n]
        offset = 0.0
        if 0 < i < scores.shape[0] - 1:
            below, top, above = float(scores[i - 1, n]), float(scores[i, n]), float(scores[i + 1, n])
            bend = 2.0 * top - below - above
            offset = (above - below) / bend if bend > 0.0 else 0.0  # in nodes, two between scanned ones
        work[newton.TRIAL * BLOCK + n] = min(max(node + 2.0 * i + offset, first), last)
        work[newton.SIZE * BLOCK + n] = sizes[start + n]
    for n in range(size, BLOCK):
        work[newton.DONE * BLOCK + n] = newton.ENDED


@njit(cache=True, error_model="numpy")
def _hand_over(work, start, size, axis, low, spacing, answer):
    """A block's answers."""
    unit = 1.0 / axis if axis > 0.0 else 0.0
    for n in range(size):
        answer[U1, start + n] = low + spacing * work[newton.POSITION * BLOCK + n]
        answer[U2, start + n] = low
        answer[X0, start + n] = work[newton.FIRST * BLOCK + n] * unit
        answer[X1, start + n] = work[newton.SECOND * BLOCK + n]
        answer[X2, start + n] = work[newton.THIRD * BLOCK + n]
        answer[COST, start + n] = work[newton.SIZE * BLOCK + n] - work[newton.GAIN * BLOCK + n]
        answer[STEPS, start + n] = work[newton.STEPS * BLOCK + n]
