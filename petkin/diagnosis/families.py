"""Families of contrasts, and what columns score against them.

    c = E a + N b + noise,    C = cov(N b + noise) = V (x) 1 + N N',    scores E' C^{-1} c

V, the covariance of the rows in every sample, is given: a row's own few samples tell it too roughly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve

Array = NDArray[np.float64]

#: The least whose square is not zero.
_TINY = 1e-150
#: Shares of the usual size that are tried.
_SHARES = (0.1, 0.2, 0.4, 0.7, 1.2)


@dataclass(frozen=True)
class Family:
    """Contrasts of one kind.

    Args:
        rows: (J, K).
        nuisance: columns of what they may hold besides, as large as it may be (n, J, K).
        noise: covariance of their noise (J, J), the same in every sample.
    """

    rows: Array
    nuisance: Array
    noise: Array


def scored(family: Family, columns: Array, least: float) -> tuple[Array, Array]:
    """E C^{-1} c and E C^{-1} E' of columns E (m, J K), by Woodbury's identity: N has fewer rows than C.

    No mixture of rows has noise of a standard deviation below `least`.
    """
    seen, rows, free = _freed(family, columns, least)
    return free @ rows, free @ seen.T


def misfit(family: Family, column: Array, least: float) -> float:
    """chi2 per degree of freedom that a column (J K) leaves, however large it is.

    (c' C^{-1} c - (e' C^{-1} c)^2 / e' C^{-1} e) / (J K - 1)
    """
    both = np.stack([column.ravel(), family.rows.ravel()])
    seen, rows, free = _freed(family, both, least)
    (known, shared), (_, whole) = free @ seen.T
    left = whole - shared**2 / known if known > 0 else whole
    return float(left) / max(rows.size - 1, 1)


def _freed(family: Family, columns: Array, least: float) -> tuple[Array, Array, Array]:
    """Whitened columns (m, J K), whitened rows (J K,), and columns that see no more of the nuisance than is likely."""
    whitened = _whitening(family, least)
    rows, nuisance = whitened(family.rows[None])[0], whitened(family.nuisance)
    seen = whitened(columns.reshape(-1, *family.rows.shape))
    inner = np.eye(len(nuisance)) + nuisance @ nuisance.T
    return seen, rows, seen - np.linalg.solve(inner, nuisance @ seen.T).T @ nuisance


def holding(family: Family, further: Array, least: float, *, times: float) -> Family:
    """The family holding more besides: so many times as large a share of it as is likeliest.

    Args:
        family: the contrasts.
        further: columns of what they may hold besides (n, J, K), of the usual size.
        least: no mixture of rows has noise of a smaller standard deviation.
        times: more than 1 where few rows tell the share, or it differs between them.
    """
    whitened = _whitening(family, least)
    rows, nuisance = whitened(family.rows[None])[0], whitened(np.concatenate([family.nuisance, further]))
    inner, held = nuisance @ nuisance.T, nuisance @ rows

    def likely(share: float) -> float:
        size = np.repeat([1.0, share], [len(family.nuisance), len(further)])
        return likelihood(rows, size[:, None] * inner * size, size * held)

    share = times * max(_SHARES, key=likely)
    return replace(family, nuisance=np.concatenate([family.nuisance, share * further]))


def likelihood(rows: Array, inner: Array, held: Array) -> float:
    """Log likelihood of rows without any effect, but for a constant of their noise:

        -(c' C^{-1} c + log |1 + N V^{-1} N'|) / 2

    Args:
        rows: c, whitened (J K,).
        inner: N V^{-1} N' (n, n).
        held: N V^{-1} c (n,).
    """
    factors = lu_factor(np.eye(len(inner)) + inner)
    square = rows @ rows - held @ lu_solve(factors, held)
    return float(-0.5 * (square + np.log(np.abs(np.diag(factors[0]))).sum()))


def _whitening(family: Family, least: float) -> Callable[[Array], Array]:
    """Rows (n, J, K) in units in which the noise is white (n, J K)."""
    size, axes = np.linalg.eigh(family.noise)
    white = (axes / np.sqrt(np.maximum(size, max(least, _TINY) ** 2))).T

    def whitened(values: Array) -> Array:
        return np.asarray((white @ values).reshape(len(values), family.rows.size), np.float64)

    return whitened


def root(covariance: Array) -> Array:
    """A of A'A = covariance."""
    values, axes = np.linalg.eigh(covariance)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * axes.T
