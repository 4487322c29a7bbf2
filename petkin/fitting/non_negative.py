"""Non-negative least squares of many small problems that share their columns, one after another in compiled code.

    minimise |z - A x|^2 subject to x >= 0

by the active set method: the column that would help most enters, the least squares of those that are in is solved by
Gram-Schmidt, and whoever turns negative on the way there leaves.

Reference: Lawson CL, Hanson RJ. Solving least squares problems. Prentice-Hall 1974, chapter 23,
doi:10.1137/1.9781611971217.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.jit import njit

Array = NDArray[np.float64]

#: Columns that may be in at once: a spectrum has a handful.
MOST = 12
#: A column that leans less than this share of the curve's length on the residual does not help.
_HELPS = 1e-10
#: Part of a unit column outside the span of those that are in, below which it is one of them.
_APART = 1e-9


@njit(nogil=True)
def solve_non_negative(columns: Array, z: Array, x: Array) -> None:
    """Amplitudes of every curve.

    Args:
        columns: A, unit length each (M, R).
        z: curves (R, N).
        x: answer (M, N).
    """
    count, size = columns.shape
    inside = np.zeros(MOST, np.int64)
    axes, upper = np.zeros((MOST, size)), np.zeros((MOST, MOST))
    trial, kept = np.zeros(MOST), np.zeros(MOST)
    left = np.zeros(size)
    for n in range(z.shape[1]):
        taken = 0
        length = 0.0
        for r in range(size):
            left[r] = z[r, n]
            length += z[r, n] * z[r, n]
        least = _HELPS * np.sqrt(length)
        refused = -1
        for _ in range(3 * MOST):
            enters = _most_helpful(columns, left, inside, taken, refused, least)
            if enters < 0 or taken == MOST:
                break
            inside[taken], kept[taken] = enters, 0.0
            taken += 1
            if not _solve(columns, z, n, inside, taken, axes, upper, trial) or trial[taken - 1] <= 0.0:
                taken -= 1
                refused = enters
                continue
            refused = -1
            while True:
                share = 1.0
                for k in range(taken):
                    if trial[k] <= 0.0:
                        share = min(share, kept[k] / (kept[k] - trial[k]))
                for k in range(taken):
                    kept[k] += share * (trial[k] - kept[k])
                if share == 1.0:
                    break
                stays = 0
                for k in range(taken):
                    if trial[k] > 0.0 or kept[k] > 1e-14 * np.sqrt(length):
                        inside[stays], kept[stays] = inside[k], kept[k]
                        stays += 1
                taken = stays
                _solve(columns, z, n, inside, taken, axes, upper, trial)
            for r in range(size):
                left[r] = z[r, n]
                for k in range(taken):
                    left[r] -= kept[k] * columns[inside[k], r]
        for j in range(count):
            x[j, n] = 0.0
        for k in range(taken):
            x[inside[k], n] = kept[k]


@njit()
def _most_helpful(columns, left, inside, taken, refused, least):
    """The column outside that leans most on what is left, or -1."""
    best, found = least, -1
    for j in range(columns.shape[0]):
        lean = 0.0
        for r in range(columns.shape[1]):
            lean += columns[j, r] * left[r]
        if lean > best and j != refused:
            new = True
            for k in range(taken):
                new = new and inside[k] != j
            if new:
                best, found = lean, j
    return found


@njit()
def _solve(columns, z, n, inside, taken, axes, upper, trial):
    """Least squares with the columns that are in; False where the last depends on the others."""
    for k in range(taken):
        for r in range(columns.shape[1]):
            axes[k, r] = columns[inside[k], r]
        for i in range(k):
            upper[i, k] = 0.0
            for r in range(columns.shape[1]):
                upper[i, k] += axes[i, r] * axes[k, r]
            for r in range(columns.shape[1]):
                axes[k, r] -= upper[i, k] * axes[i, r]
        square = 0.0
        for r in range(columns.shape[1]):
            square += axes[k, r] * axes[k, r]
        upper[k, k] = np.sqrt(square)
        if upper[k, k] < _APART:
            return False
        trial[k] = 0.0
        for r in range(columns.shape[1]):
            axes[k, r] /= upper[k, k]
            trial[k] += axes[k, r] * z[r, n]
    for k in range(taken - 1, -1, -1):
        for i in range(k + 1, taken):
            trial[k] -= upper[k, i] * trial[i]
        trial[k] /= upper[k, k]
    return True
