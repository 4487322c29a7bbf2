"""Curves in blocks, and the product of a small matrix with one: what every compiled pass over curves is made of."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from petkin.jit import njit

#: Curves in step. A block of a few rows stays in the first-level cache. Loops run over whole blocks, never over a
#: remainder that might round another way: a curve's result does not depend on its neighbours, to the bit.
BLOCK = 64
_B = np.uint64(BLOCK)
_2B, _3B, _4B = np.uint64(2 * BLOCK), np.uint64(3 * BLOCK), np.uint64(4 * BLOCK)


Number = TypeVar("Number", np.float32, np.float64)


def even_rows(matrix: NDArray[Number]) -> NDArray[Number]:
    """The matrix, row by row, with one of zeros where it has an odd number of them, as `multiply` takes it."""
    more = np.zeros((len(matrix) % 2, matrix.shape[1]), matrix.dtype)
    return np.ascontiguousarray(np.concatenate([matrix, more]) if len(more) else matrix)


@njit(fastmath={"contract", "nsz"})
def multiply(matrix, block, out):
    """matrix @ block: rows of BLOCK numbers one after another in flat arrays, an even number of them in the matrix.

    Two rows at a time share what is read of the block, eight columns at a time what is written. (Unsigned indices are
    known not to count from the end, which is what lets the compiler see that rows do not overlap.)
    """
    columns = matrix.shape[1]
    for pair in range(matrix.shape[0] // 2):
        i, j = 2 * pair, 2 * pair + 1
        one = np.uint64(i * BLOCK)
        other = one + _B
        for n in range(_2B):
            out[one + n] = 0
        for eight in range(columns // 8):
            r = 8 * eight
            a0, a1, a2, a3 = matrix[i, r], matrix[i, r + 1], matrix[i, r + 2], matrix[i, r + 3]
            a4, a5, a6, a7 = matrix[i, r + 4], matrix[i, r + 5], matrix[i, r + 6], matrix[i, r + 7]
            b0, b1, b2, b3 = matrix[j, r], matrix[j, r + 1], matrix[j, r + 2], matrix[j, r + 3]
            b4, b5, b6, b7 = matrix[j, r + 4], matrix[j, r + 5], matrix[j, r + 6], matrix[j, r + 7]
            first = np.uint64(r * BLOCK)
            for n in range(_B):
                k = first + n
                m = k + _4B
                z0, z1, z2, z3 = block[k], block[k + _B], block[k + _2B], block[k + _3B]
                z4, z5, z6, z7 = block[m], block[m + _B], block[m + _2B], block[m + _3B]
                out[one + n] += ((a0 * z0 + a1 * z1) + (a2 * z2 + a3 * z3)) + (
                    (a4 * z4 + a5 * z5) + (a6 * z6 + a7 * z7)
                )
                out[other + n] += ((b0 * z0 + b1 * z1) + (b2 * z2 + b3 * z3)) + (
                    (b4 * z4 + b5 * z5) + (b6 * z6 + b7 * z7)
                )
        for r in range(columns // 8 * 8, columns):
            a, b, first = matrix[i, r], matrix[j, r], np.uint64(r * BLOCK)
            for n in range(_B):
                out[one + n] += a * block[first + n]
                out[other + n] += b * block[first + n]
