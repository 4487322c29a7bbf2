"""Projected Levenberg-Marquardt along a wall that bends: distances beyond it are residuals that count outside alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from petkin.levenberg_marquardt import polish

Array = NDArray[np.float64]
RADIUS = 2.0


def fit(wanted: Array, firm: float, start: Array) -> tuple[Array, Array, NDArray[np.bool_], int]:
    """The points of a disc that are nearest to some points, and how often slopes were asked for."""
    asked = 0

    def values(theta: Array, _: NDArray[np.intp]) -> Array:
        return np.column_stack([theta, firm * (np.hypot(*theta.T) - RADIUS)])

    def jacobian(theta: Array, rows: NDArray[np.intp]) -> tuple[Array, Array]:
        nonlocal asked
        asked += 1
        own = np.broadcast_to(np.eye(2), (len(theta), 2, 2))
        edge = firm * theta / np.hypot(*theta.T)[:, None]
        return values(theta, rows), np.concatenate([own, edge[:, None]], axis=1)

    z = np.concatenate([wanted.T, np.zeros((1, len(wanted)))])
    sizes = (wanted**2).sum(axis=1)
    box = np.full(2, -10.0), np.full(2, 10.0)
    return *polish(values, jacobian, z, sizes, start, *box, 1e-12, walls=1), asked


@pytest.mark.parametrize("firm", [10.0, 100.0])
def test_the_nearest_point_within_a_wall_is_found_along_it(firm: float) -> None:
    wanted = np.array([[2.0, 3.0], [0.5, -0.3], [-4.0, 0.1]])
    found, cost, converged, asked = fit(wanted, firm, np.array([[-1.0, 1.5], [1.9, 0.1], [-1.5, 1.2]]))
    away = np.hypot(*wanted.T)
    # the minimum of (d - x)^2 + firm^2 (x - r)^2 along the way to what is wanted, for a point beyond the wall
    length = np.where(away > RADIUS, (away + firm**2 * RADIUS) / (1.0 + firm**2), away)
    np.testing.assert_allclose(found, wanted * (length / away)[:, None], rtol=1e-5)
    np.testing.assert_allclose(cost, (away - length) ** 2 + firm**2 * np.maximum(length - RADIUS, 0.0) ** 2, atol=1e-9)
    assert converged.all()
    assert asked < 80


def test_a_wall_that_is_not_met_changes_nothing() -> None:
    wanted, start = np.array([[0.5, -0.3]]), np.array([[-0.2, 0.9]])
    held, free = fit(wanted, 1000.0, start), fit(wanted, 0.0, start)
    np.testing.assert_array_equal(held[0], free[0])
    assert held[3] == free[3]
