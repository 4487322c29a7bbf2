"""Regressions whose columns all curves have in common, compiled: one pass over every curve, from frames to status.

As in `gram_schmidt`, but the response is the curve itself: its components along axes that are orthonormal beforehand,
then what is left of it, squared, without cancellation. Such a fit costs little more than reading the curves, so it
computes in the precision that they have.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.verdict import conclude
from petkin.jit import njit

Array = NDArray[np.float64]
Answer = tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating], NDArray[np.uint8]]

#: Curves in step. As in `lanes`, no loop that rounds has a remainder that might round another way.
_LANES = 512
_STRICT = {"contract", "nsz"}
#: Sum of a curve (kBq/mL) from which on it counts as infinite.
_LARGEST = 1e30


def regress_curves(
    frames: NDArray[np.floating],
    part: slice,
    tissue: tuple[Array, Array, NDArray[np.intp]],
    axes: Array,
    inverse: Array,
    unit: tuple[Array, float],
    outcome: int,
    answer: Answer,
) -> None:
    """Fill in the answers of some curves; all is computed in the type of the frames.

    Args:
        frames: curves, frames first (K, N), float32 or float64.
        part: which of them.
        tissue: what is taken off every used frame and what the rest is multiplied by (U,), which they are (U,).
        axes: orthonormal (S, U).
        inverse: what makes unknowns from components along the axes (S, S).
        unit: standard deviations of the unknowns (S,) and sum of squared residuals at unit noise.
        outcome: which unknown the method is used for.
        answer: room for values and percent errors (M, N), chi-square, status (N,); quantities are the first M unknowns.
    """
    kind, (shared, used) = frames.dtype, axes.shape
    y, parts, theta = (np.zeros((rows, _LANES), kind) for rows in (used, shared, shared))
    deviations = np.repeat(unit[0].astype(kind)[:, None], _LANES, axis=1)
    wrss, total = np.zeros((2, _LANES), kind)
    room = y, parts, theta, deviations, wrss, np.full(_LANES, unit[1], kind), total, np.empty(_LANES, np.bool_)
    offset, factor = (numbers.astype(kind) for numbers in tissue[:2])
    fixed = (offset, factor, tissue[2]), axes.astype(kind), inverse.astype(kind), kind.type(used - shared)
    _regress(frames, (part.start, part.stop), fixed, outcome, room, answer)


@njit(nogil=True)
def _regress(frames, part, fixed, outcome, room, answer):
    y, parts, theta, deviations, wrss, freedom, total, finite = room
    (offset, factor, used), axes, inverse, degrees = fixed
    for first in range(part[0], part[1], _LANES):
        last = min(first + _LANES, part[1])
        _add_up(frames, first, last, total)
        for u in range(len(used)):
            _take(frames[used[u]][first:last], offset[u], factor[u], y[u])
        for s in range(len(axes)):
            _combine(axes[s], y, parts[s])
        _measure(axes, parts, y, wrss)
        for n in range(_LANES):
            finite[n] = (abs(total[n]) < _LARGEST) & (wrss[n] < np.inf)
        for i in range(len(axes)):
            _combine(inverse[i], parts, theta[i])
        found = theta, deviations, wrss, freedom, total, finite
        conclude(found, outcome, degrees, answer, first, last)


@njit(fastmath=_STRICT)
def _add_up(frames, first, last, total):
    """Sums of some curves."""
    for n in range(_LANES):
        total[n] = 0.0
    k = 0
    while k + 4 <= len(frames):
        # cut row by row: the compiler knows them contiguous
        one, two = frames[k][first:last], frames[k + 1][first:last]
        three, four = frames[k + 2][first:last], frames[k + 3][first:last]
        for n in range(len(one)):
            total[n] += (one[n] + two[n]) + (three[n] + four[n])
        k += 4
    while k < len(frames):
        one = frames[k][first:last]
        for n in range(len(one)):
            total[n] += one[n]
        k += 1


@njit(fastmath=_STRICT)
def _take(frame, offset, factor, y):
    for n in range(len(frame)):
        y[n] = (frame[n] - offset) * factor


@njit(fastmath=_STRICT)
def _combine(weights, rows, out):
    """weights @ rows."""
    for n in range(_LANES):
        out[n] = 0.0
    u = 0
    while u + 4 <= len(weights):
        a, b, c, d = weights[u], weights[u + 1], weights[u + 2], weights[u + 3]
        one, two, three, four = rows[u], rows[u + 1], rows[u + 2], rows[u + 3]
        for n in range(len(out)):
            out[n] += (a * one[n] + b * two[n]) + (c * three[n] + d * four[n])
        u += 4
    while u < len(weights):
        a, one = weights[u], rows[u]
        for n in range(len(out)):
            out[n] += a * one[n]
        u += 1


@njit(fastmath=_STRICT)
def _measure(axes, parts, y, wrss):
    """Sum of squares of what is left of y without its parts along the axes, two axes at a time."""
    for n in range(_LANES):
        wrss[n] = 0.0
    odd = len(axes) % 2
    for u in range(len(y)):
        left = y[u]
        if odd:
            along, part = axes[0, u], parts[0]
            for n in range(len(left)):
                left[n] -= along * part[n]
        for s in range(odd, len(axes) - 2, 2):
            a, b, one, two = axes[s, u], axes[s + 1, u], parts[s], parts[s + 1]
            for n in range(len(left)):
                left[n] -= a * one[n] + b * two[n]
        if len(axes) > odd:
            a, b, one, two = axes[-2, u], axes[-1, u], parts[-2], parts[-1]
            for n in range(len(left)):
                rest = left[n] - (a * one[n] + b * two[n])
                wrss[n] += rest * rest
        else:
            for n in range(len(left)):
                wrss[n] += left[n] * left[n]
