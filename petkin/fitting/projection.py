"""Curves seen through a compression: the one pass over the data that a fit makes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.blocks import BLOCK, even_rows, multiply
from petkin.fitting.table import Compression
from petkin.jit import njit

Array = NDArray[np.float64]

#: Activity (kBq/mL) from which on a value counts as infinite: its square must stay a number.
_LARGEST = 1e30


class Lens(NamedTuple):
    """What compiled passes need to see a block of curves through a compression.

    Args:
        axes: frames to coordinates, an even number of rows.
        weights: frame weights (K,).
        every: the sum of all exponentials in the table, in coordinates (R,).
        curves: scratch, frame values of a block, flat rows.
        block: coordinates of a block, flat rows (R, or one more, times BLOCK).
        sizes, squares, shares: of every curve of it, weighted and plain sums of squares, and its share of `every`.
    """

    axes: Array
    weights: Array
    every: Array
    curves: Array
    block: Array
    sizes: Array
    squares: Array
    shares: Array


def lens(packed: Compression, weights: Array) -> Lens:
    """For one thread; all arrays may be written to and lie row by row, so that compiled passes are of one kind."""
    axes, weights = even_rows(packed.project), np.require(weights, requirements=["C", "W"])
    rows, frames = axes.shape
    every = np.ascontiguousarray(packed.basis.sum(axis=0))
    return Lens(axes, weights, every, np.zeros(frames * BLOCK), np.empty(rows * BLOCK), *np.empty((3, BLOCK)))


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
    _project_all(frames, start, lens(packed, weights), z, sizes, finite, signal)
    return z, sizes, finite, signal


@njit(nogil=True)
def _project_all(frames, start, seen, z, sizes, finite, signal):
    for first in range(0, z.shape[1], BLOCK):
        width = min(BLOCK, z.shape[1] - first)
        project_block(frames, start + first, width, seen)
        note(seen, first, width, sizes, finite, signal)
        block = seen.block
        for r in range(z.shape[0]):
            for n in range(width):
                z[r, first + n] = block[r * BLOCK + n]


@njit()
def project_block(frames, first, width, seen):
    """Look at some curves: fills the block of the lens and its numbers."""
    # Arrays are unpacked once: handing tuples on costs a reference count an array and call.
    axes, weights, every, curves, block, sizes, squares, shares = seen
    _read(frames, first, width, curves)
    _measure(weights, curves, sizes, squares)
    multiply(axes, curves, block)
    _add(every, block, shares)


@njit()
def note(seen, first, width, sizes, finite, signal):
    """Write down what of the block does not depend on a model: see `project_curves`."""
    whole, squares, shares = seen.sizes, seen.squares, seen.shares
    for n in range(width):
        sizes[first + n] = whole[n]
        finite[first + n] = squares[n] < _LARGEST * _LARGEST
        signal[first + n] = shares[n] > 0.0


@njit()
def _read(frames, first, width, y):
    for k in range(frames.shape[0]):
        here, there = frames[k, first : first + width], y[k * BLOCK : k * BLOCK + width]
        for n in range(width):
            there[n] = here[n]


@njit(fastmath={"contract", "nsz"})
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


@njit(fastmath={"contract", "nsz"})
def _add(every, out, total):
    """every @ out."""
    for n in range(BLOCK):
        total[n] = 0.0
    for r in range(len(every)):
        for n in range(BLOCK):
            total[n] += every[r] * out[r * BLOCK + n]
