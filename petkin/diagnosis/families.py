"""Families of contrasts, and what columns score against them.

    c = E a + N b + noise,    C = cov(N b + noise) = V (x) 1 + N N',    scores E' C^{-1} c

V, the covariance of the rows in every sample, is given: a row's own few samples tell it too roughly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: The least whose square is not zero.
_TINY = 1e-150


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
    size, axes = np.linalg.eigh(family.noise)
    white = (axes / np.sqrt(np.maximum(size, max(least, _TINY) ** 2))).T

    def whitened(values: Array) -> Array:
        return (white @ values).reshape(len(values), -1)

    rows, nuisance = whitened(family.rows[None])[0], whitened(family.nuisance)
    seen = whitened(columns.reshape(-1, *family.rows.shape))
    inner = np.eye(len(nuisance)) + nuisance @ nuisance.T
    free = seen - np.linalg.solve(inner, nuisance @ seen.T).T @ nuisance
    return free @ rows, free @ seen.T


def root(covariance: Array) -> Array:
    """A of A'A = covariance."""
    values, axes = np.linalg.eigh(covariance)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * axes.T
