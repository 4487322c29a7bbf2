"""Exponentials off the columns that all curves share, as polynomials between nodes: what one free rate climbs.

With the shared columns at work projected out of b(u), the sum of squares that it explains of a curve z beside them is
(z . b)^2 / (b . b). The table reads b as a cubic between nodes, so these are a cubic and a polynomial of degree six.

Which shared columns are at work is a *support*; amplitudes that must not be negative make for one table a support.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Numbers of a cell besides the cubics: a square (7), leans on two axes (4 each), one that fills a line of the cache.
NUMBERS = 16
#: Below this share of its length, an exponential off the other columns is nothing but rounding.
_SAME = 1e-12


def supports(columns: Array, *, all_free: bool) -> list[tuple[int, ...]]:
    """Which of the shared columns (D, R) may be at work, all first; no other where amplitudes have either sign.

    A column of zeros takes no part.
    """
    every = np.flatnonzero(columns.any(axis=1)).tolist()
    if all_free:
        return [tuple(every)]
    return [chosen for size in range(len(every), -1, -1) for chosen in combinations(every, size)]


def without(chosen: list[tuple[int, ...]], support: tuple[int, ...], column: int) -> int:
    """The number of the support without a column; -1 where that is not at work, or leaving it out is no choice."""
    rest = tuple(d for d in support if d != column)
    return chosen.index(rest) if rest in chosen and rest != support else -1


def shared_axes(columns: Array, support: tuple[int, ...]) -> tuple[Array, Array]:
    """Orthonormal axes (D, R) of the columns at work, and what makes amplitudes from components along them (D, D)."""
    axes, mix = np.zeros_like(columns), np.zeros((len(columns), len(columns)))
    if support:
        chosen = list(support)
        q, upper = np.linalg.qr(columns[chosen].T)
        axes[: len(chosen)] = q.T
        mix[chosen, : len(chosen)] = np.linalg.inv(upper)
    return axes, mix


def off_atoms(basis: Array, slope: Array, axes: Array) -> tuple[Array, Array]:
    """Coefficients of s^0, s^1, .. in every cell, s from 0 to 1.

    Args:
        basis, slope: b and its change a node, at the nodes (M, R).
        axes: orthonormal (2, R); rows of zeros where fewer are at work.

    Returns:
        b off the axes (M - 1, R, 4); its square, of degree six, then its leans on the axes (M - 1, NUMBERS).
    """
    lean, lean_change = basis @ axes.T, slope @ axes.T
    off = basis - lean @ axes
    off[np.linalg.norm(off, axis=1) < _SAME * np.linalg.norm(basis, axis=1)] = 0.0
    cubics = _cubics(off, slope - lean_change @ axes)
    numbers = np.zeros((len(cubics), NUMBERS))
    products = cubics.transpose(0, 2, 1) @ cubics
    for i in range(4):
        numbers[:, i : i + 4] += products[:, i]
    numbers[:, 7:15] = _cubics(lean, lean_change).reshape(-1, 8)
    return cubics, numbers


def _cubics(value: Array, slope: Array) -> Array:
    """Coefficients of cubics (M - 1, ..., 4) from values and slopes at the nodes between them (M, ...)."""
    step, start, end = value[1:] - value[:-1], slope[:-1], slope[1:]
    return np.stack([value[:-1], start, 3.0 * step - 2.0 * start - end, start + end - 2.0 * step], axis=-1)
