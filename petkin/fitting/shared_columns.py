"""Regressions whose columns all curves have in common, compiled: one pass over every curve, from frames to status.

As in `gram_schmidt`, but the response is the curve itself: its components along axes that are orthonormal beforehand,
then what is left of it, squared, without cancellation.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from petkin.fitting.verdict import conclude

Array = NDArray[np.float64]

#: Curves in step. As in `lanes`, no loop that rounds has a remainder that might round another way.
_LANES = 512
_STRICT = {"contract", "nsz"}
#: Activity (kBq/mL) from which on a value counts as infinite: its square must stay a number.
_LARGEST = 1e30


def regress_curves(
    frames: NDArray[np.floating],
    start: int,
    tissue: tuple[Array, Array, NDArray[np.intp]],
    axes: Array,
    inverse: Array,
    unit: tuple[Array, float],
    outcome: int,
    answer: tuple[Array, Array, Array, NDArray[np.uint8]],
) -> None:
    """Fill in the answers of curves from `start` on.

    Args:
        frames: curves, frames first (K, N), float32 or float64.
        start: first of them.
        tissue: what is taken off every used frame and what the rest is multiplied by (U,), which they are (U,).
        axes: orthonormal (S, U).
        inverse: what makes unknowns from components along the axes (S, S).
        unit: standard deviations of the unknowns (S,) and sum of squared residuals at unit noise.
        outcome: which unknown the method is used for.
        answer: room for values and percent errors (M, n), chi-square, status (n,); quantities are the first M unknowns.
    """
    shared, used = axes.shape
    y, parts, theta = (np.zeros((rows, _LANES)) for rows in (used, shared, shared))
    deviations, freedom = np.repeat(unit[0][:, None], _LANES, axis=1), np.full(_LANES, unit[1])
    wrss, total, plain = np.zeros((3, _LANES))
    room = y, parts, theta, deviations, wrss, freedom, total, plain, np.empty(_LANES, np.bool_)
    _regress(frames, start, tissue, axes, inverse, outcome, room, answer)


@njit(cache=True, nogil=True, error_model="numpy")
def _regress(frames, start, tissue, axes, inverse, outcome, room, answer):
    y, parts, theta, deviations, wrss, freedom, total, plain, finite = room
    values, percent, chi2, status = answer
    offset, factor, used = tissue
    degrees = float(axes.shape[1] - axes.shape[0])
    for first in range(0, len(status), _LANES):
        here = slice(first, min(first + _LANES, len(status)))
        block = frames[:, start + here.start : start + here.stop]
        _look(block, total, plain)
        for n in range(_LANES):
            finite[n] = plain[n] < _LARGEST * _LARGEST
        for u in range(len(used)):
            _take(block[used[u]], offset[u], factor[u], y[u])
        for s in range(len(axes)):
            _combine(axes[s], y, parts[s])
        _measure(axes, parts, y, wrss)
        for i in range(len(axes)):
            _combine(inverse[i], parts, theta[i])
        found = theta, deviations, wrss, freedom, total, finite
        conclude(found, outcome, degrees, values[:, here], percent[:, here], chi2[here], status[here])


@njit(cache=True, fastmath=_STRICT, error_model="numpy")
def _look(block, total, plain):
    """Sums and sums of squares of a block of curves."""
    for n in range(_LANES):
        total[n], plain[n] = 0.0, 0.0
    k, width = 0, block.shape[1]
    while k + 4 <= block.shape[0]:
        one, two, three, four = block[k], block[k + 1], block[k + 2], block[k + 3]
        for n in range(width):
            a, b, c, d = np.float64(one[n]), np.float64(two[n]), np.float64(three[n]), np.float64(four[n])
            total[n] += (a + b) + (c + d)
            plain[n] += (a * a + b * b) + (c * c + d * d)
        k += 4
    while k < block.shape[0]:
        one = block[k]
        for n in range(width):
            a = np.float64(one[n])
            total[n] += a
            plain[n] += a * a
        k += 1


@njit(cache=True, fastmath=_STRICT, error_model="numpy")
def _take(frame, offset, factor, y):
    for n in range(len(frame)):
        y[n] = (frame[n] - offset) * factor


@njit(cache=True, fastmath=_STRICT, error_model="numpy")
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


@njit(cache=True, fastmath=_STRICT, error_model="numpy")
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
