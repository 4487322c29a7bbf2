"""Straight pieces where they suffice."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from petkin.inputs import piecewise_linear
from petkin.inputs.linearise import needed_knots


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4])
def test_pieces_stay_within_tolerance_with_few_knots(tolerance):
    def curve(t):
        return 100 * t * np.exp(-3 * t) + 5 * np.exp(-0.02 * t)

    forcing = piecewise_linear(curve, np.array([0.0, 1.0, 90.0]), tolerance=tolerance)
    t = np.linspace(0, 90, 20001)
    assert np.abs(forcing(torch.as_tensor(t)).numpy() / curve(t) - 1).max() < 1.5 * tolerance
    assert forcing.knots.size < 6 / np.sqrt(tolerance)
    assert float(forcing.integral(torch.tensor([90.0], dtype=torch.float64))) == pytest.approx(
        np.trapezoid(curve(t), t), rel=2 * tolerance
    )


def test_knots_that_are_given_stay():
    forcing = piecewise_linear(lambda t: np.abs(t - 2.0), np.array([5.0, 0.0, 2.0]))
    assert forcing.knots.tolist() == [0.0, 2.0, 5.0]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-10, 10), min_size=2, max_size=60), st.floats(1e-6, 0.2))
def test_what_is_dropped_lies_within_tolerance(values, tolerance):
    y = np.array(values)
    t = np.arange(y.size, dtype=float)
    keep = needed_knots(t, y, tolerance=tolerance)
    assert keep[0]
    assert keep[-1]
    between = np.interp(t, t[keep], y[keep])
    assert np.abs(between - y).max() <= tolerance * np.abs(y).max() + 1e-12


def test_points_in_line_go():
    t = np.linspace(0, 10, 101)
    assert needed_knots(t, np.minimum(t, 4.0), tolerance=1e-9).sum() == 3
