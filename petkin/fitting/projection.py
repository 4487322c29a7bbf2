"""Curves seen through a compression: the one pass over the data that a fit makes."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from petkin.fitting.table import Compression

Array = NDArray[np.float64]

#: Curves handled at a time.
BLOCK = 64
#: Activity (kBq/mL) from which on a value counts as infinite: its square must stay a number.
_LARGEST = 1e30


def project_curves(packed: Compression, weights: Array, frames: NDArray[np.floating], start: int, stop: int):
    """Compressed coordinates of curves start .. stop.

    Args:
        packed: compressed table.
        weights: frame weights (K,).
        frames: curves, frames first (K, N), float32 or float64, in either memory order.
        start, stop: which curves.

    Returns:
        z (R, n); sum_k w_k y_k^2 (n,); whether all values of a curve are finite (n,): others count as zero; whether it
        holds signal (n,), a positive share of the sum of all exponentials in the table.
    """
    z = np.empty((packed.size, stop - start))
    sizes = np.empty(stop - start)
    finite, signal = np.empty((2, stop - start), np.bool_)
    room = np.zeros(frames.shape[0] * BLOCK), np.empty(packed.size * BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    every = np.ascontiguousarray(packed.basis.sum(axis=0))
    _project_all(frames, start, packed.project, weights, every, z, sizes, finite, signal, room)
    return z, sizes, finite, signal


@njit(cache=True, nogil=True, error_model="numpy")
def _project_all(frames, start, project, weights, every, z, sizes, finite, signal, room):
    y, out, total, plain = room
    for first in range(0, z.shape[1], BLOCK):
        width = min(BLOCK, z.shape[1] - first)
        _read(frames, start + first, width, y)
        _measure(weights, y, total, plain)
        for n in range(width):
            finite[first + n] = plain[n] < _LARGEST * _LARGEST
            sizes[first + n] = total[n]
        _project(project, y, out)
        _add(every, out, total)
        for n in range(width):
            signal[first + n] = total[n] > 0.0
        for r in range(project.shape[0]):
            for n in range(width):
                z[r, first + n] = out[r * BLOCK + n]


@njit(cache=True, error_model="numpy")
def _read(frames, first, width, y):
    for k in range(frames.shape[0]):
        here, there = frames[k, first : first + width], y[k * BLOCK : k * BLOCK + width]
        for n in range(width):
            there[n] = here[n]


@njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")
def _measure(weights, y, total, plain):
    """Weighted and plain sums of squares of a block of curves; zeros for those that are not finite."""
    frames = len(weights)
    for n in range(BLOCK):
        total[n], plain[n] = 0.0, 0.0
    k = 0
    while k + 4 <= frames:
        w0, w1, w2, w3 = weights[k], weights[k + 1], weights[k + 2], weights[k + 3]
        for n in range(BLOCK):
            i = k * BLOCK + n
            y0, y1, y2, y3 = y[i], y[i + BLOCK], y[i + 2 * BLOCK], y[i + 3 * BLOCK]
            y0, y1, y2, y3 = y0 * y0, y1 * y1, y2 * y2, y3 * y3
            total[n] += (w0 * y0 + w1 * y1) + (w2 * y2 + w3 * y3)
            plain[n] += (y0 + y1) + (y2 + y3)
        k += 4
    while k < frames:
        for n in range(BLOCK):
            square = y[k * BLOCK + n] * y[k * BLOCK + n]
            total[n] += weights[k] * square
            plain[n] += square
        k += 1
    for n in range(BLOCK):
        if not plain[n] < _LARGEST * _LARGEST:
            total[n] = 0.0
            for k in range(frames):
                y[k * BLOCK + n] = 0.0


@njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")
def _project(axes, y, out):
    """axes @ y, eight frames at a time."""
    frames = axes.shape[1]
    for r in range(axes.shape[0]):
        for n in range(BLOCK):
            out[r * BLOCK + n] = 0.0
        k = 0
        while k + 8 <= frames:
            a0, a1, a2, a3 = axes[r, k], axes[r, k + 1], axes[r, k + 2], axes[r, k + 3]
            a4, a5, a6, a7 = axes[r, k + 4], axes[r, k + 5], axes[r, k + 6], axes[r, k + 7]
            for n in range(BLOCK):
                i = k * BLOCK + n
                near = (a0 * y[i] + a1 * y[i + BLOCK]) + (a2 * y[i + 2 * BLOCK] + a3 * y[i + 3 * BLOCK])
                far = (a4 * y[i + 4 * BLOCK] + a5 * y[i + 5 * BLOCK]) + (a6 * y[i + 6 * BLOCK] + a7 * y[i + 7 * BLOCK])
                out[r * BLOCK + n] += near + far
            k += 8
        while k < frames:
            for n in range(BLOCK):
                out[r * BLOCK + n] += axes[r, k] * y[k * BLOCK + n]
            k += 1


@njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")
def _add(every, out, total):
    """every @ out."""
    for n in range(BLOCK):
        total[n] = 0.0
    for r in range(len(every)):
        for n in range(BLOCK):
            total[n] += every[r] * out[r * BLOCK + n]
