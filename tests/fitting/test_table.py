"""The basis table: slopes at its nodes, against another program's spline and against exact ones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from petkin.fitting.table import build_table

from .fitting_problems import ARTERIAL, PLAIN


@pytest.mark.parametrize("nodes", [8, 64])
def test_slopes_are_those_of_the_spline_with_the_same_ends(nodes: int) -> None:
    table = build_table(ARTERIAL, PLAIN, rate_bounds=(1e-3, 5.0), nodes=nodes)
    ends = (1, table.slope[0]), (1, table.slope[-1])
    spline = CubicSpline(table.u, table.basis, bc_type=ends)
    np.testing.assert_allclose(table.slope, spline(table.u, 1), rtol=0, atol=1e-13 * np.abs(table.slope).max())


def test_slopes_are_derivatives() -> None:
    """Against central differences of exact values, on tables moved by a thousandth of a node."""
    low, high, nodes = np.log(2e-3), np.log(5.001), 160
    shift = 1e-3 * (high - low) / (nodes - 1)

    def moved(by: float):
        rates = [float(np.exp(u + by)) - 1e-3 for u in (low, high)]
        return build_table(ARTERIAL, PLAIN, rate_bounds=(rates[0], rates[1]), nodes=nodes)

    exact = (moved(shift).basis - moved(-shift).basis) / (2 * shift)
    slope = moved(0.0).slope
    np.testing.assert_allclose(slope, exact, rtol=0, atol=1e-6 * np.abs(exact).max())
