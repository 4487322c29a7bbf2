"""Curves seen through a compression: the one pass over the data that a fit makes."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from petkin.fitting.table import Compression

Array = NDArray[np.float64]

#: Curves handled at a time.
_BLOCK = 64
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
        z (R, n); sum_k w_k y_k^2 (n,); whether all values of a curve are finite (n,): others count as zero.
    """
    z = np.empty((packed.size, stop - start))
    sizes = np.empty(stop - start)
    finite = np.empty(stop - start, np.bool_)
    scratch = np.zeros((frames.shape[0], _BLOCK)), np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    _project(frames, start, packed.project, weights, z, sizes, finite, scratch)
    return z, sizes, finite


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")
def _project(frames, start, project, weights, z, sizes, finite, scratch):
    y, total, wrong, out = scratch
    for first in range(0, z.shape[1], _BLOCK):
        width = min(_BLOCK, z.shape[1] - first)
        for n in range(_BLOCK):
            total[n], wrong[n] = 0.0, 0.0
        for k in range(frames.shape[0]):
            for n in range(width):
                y[k, n] = frames[k, start + first + n]
            for n in range(_BLOCK):
                total[n] += weights[k] * y[k, n] * y[k, n]
                wrong[n] += 0.0 if abs(y[k, n]) < _LARGEST else 1.0
        for n in range(width):
            good = wrong[n] == 0.0
            finite[first + n] = good
            sizes[first + n] = total[n] if good else 0.0
        for r in range(project.shape[0]):
            for n in range(_BLOCK):
                out[n] = 0.0
            k = 0
            while k + 4 <= project.shape[1]:
                q0, q1, q2, q3 = project[r, k], project[r, k + 1], project[r, k + 2], project[r, k + 3]
                for n in range(_BLOCK):
                    out[n] += (q0 * y[k, n] + q1 * y[k + 1, n]) + (q2 * y[k + 2, n] + q3 * y[k + 3, n])
                k += 4
            while k < project.shape[1]:
                for n in range(_BLOCK):
                    out[n] += project[r, k] * y[k, n]
                k += 1
            for n in range(width):
                z[r, first + n] = out[n] if finite[first + n] else 0.0
