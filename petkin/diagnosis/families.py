"""Families of contrasts, and what columns score against them.

    c = E a + N b + noise,    C = cov(N b + noise) = diag(V_j) + N N',    scores E' C^{-1} c

V_j is given: a row's own few samples tell it too roughly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Family:
    """Contrasts of one kind.

    Args:
        rows: (J, K).
        nuisance: columns of what they may hold besides, as large as it may be (n, J, K).
        size: standard deviation of their noise (J,).
    """

    rows: Array
    nuisance: Array
    size: Array


def scored(family: Family, columns: Array, least: float) -> tuple[Array, Array]:
    """E C^{-1} c and E C^{-1} E' of columns E (m, J K), by Woodbury's identity: N has fewer rows than C."""
    weight = np.repeat(np.maximum(family.size, least) ** -2.0, family.rows.shape[1])
    nuisance = family.nuisance.reshape(len(family.nuisance), -1)
    inner = np.eye(len(nuisance)) + (nuisance * weight) @ nuisance.T
    weighted = columns * weight
    free = weighted - np.linalg.solve(inner, nuisance @ weighted.T).T @ (nuisance * weight)
    return free @ family.rows.ravel(), free @ columns.T


def root(covariance: Array) -> Array:
    """A of A'A = covariance."""
    values, axes = np.linalg.eigh(covariance)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * axes.T
