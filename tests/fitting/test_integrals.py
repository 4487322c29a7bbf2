"""Running integrals of curves from frame values against formulas, whatever frames report."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from petkin.fitting.integrals import curve_integrals, input_integrals
from petkin.imaging import FrameObservation, FrameSchedule

from .fitting_problems import C11, EDGES, FENG, FRAMES, bolus

MODES = pytest.mark.parametrize(
    ("observation", "tolerance"),
    [
        (FrameObservation(FRAMES), 2e-5),
        (FrameObservation(FRAMES, C11), 2e-5),
        (FrameObservation(FRAMES, C11, corrected=False), 2e-5),
        (FrameObservation(FRAMES, mid_frame=True), 2e-3),
    ],
)
RATES = torch.tensor([0.15, 0.03], dtype=torch.float64)


def double_area(times: np.ndarray) -> np.ndarray:
    """int_0^t int_0^s C_P du ds by the terms' antiderivatives."""
    s, total = np.maximum(times - 0.735, 0.0), np.zeros_like(times)
    for c, b, n in FENG:
        e = np.exp(b * s)
        total += c * ((e - 1) / b**2 - s / b) if n == 0 else c * ((b * s - 2) * e + 2 + b * s) / b**3
    return total


def test_integrals_of_the_input_are_exact():
    once, twice = input_integrals(bolus(), FrameObservation(FRAMES, mid_frame=True))
    np.testing.assert_allclose(twice, double_area(FRAMES.mid), rtol=1e-9, atol=1e-9)
    once_too, mean = input_integrals(bolus(), FrameObservation(FRAMES))
    nodes, shares = np.polynomial.legendre.leggauss(40)
    late = FRAMES.start > 1.0
    times = FRAMES.mid[late, None] + 0.5 * FRAMES.duration[late, None] * nodes
    np.testing.assert_allclose(mean[late], double_area(times.ravel()).reshape(times.shape) @ shares / 2, rtol=1e-10)
    np.testing.assert_allclose(once[-5:], once_too[-5:], rtol=1e-3)


@MODES
def test_integrals_of_a_tissue_curve_follow_from_its_frames(observation, tolerance):
    """a int_0^t C = int_0^t C_P - C for C = e^{-at} * C_P, and once more; from 1 min after arrival on."""
    curves = observation.of_response(bolus(), RATES).numpy()
    once, twice = curve_integrals(observation)
    area, double = input_integrals(bolus(), observation)
    expected = (area - curves) / RATES.numpy()[:, None]
    late = FRAMES.mid > 1.735
    np.testing.assert_allclose((curves @ once.T)[:, late], expected[:, late], rtol=tolerance)
    expected = (double - expected) / RATES.numpy()[:, None]
    np.testing.assert_allclose((curves @ twice.T)[:, FRAMES.mid > 4.0], expected[:, FRAMES.mid > 4.0], rtol=tolerance)


def test_what_a_frame_adds_to_later_integrals_is_its_area():
    once, _ = curve_integrals(FrameObservation(FRAMES))
    np.testing.assert_allclose(once[-1, :-10], np.diff(EDGES)[:-10], rtol=1e-5)


def test_a_gap_is_bridged_by_a_straight_line_and_the_start_rises_from_zero():
    frames = FrameSchedule(np.array([2.0, 3.0, 4.0, 9.0, 10.0]), np.array([3.0, 4.0, 5.0, 10.0, 11.0]))
    once, _ = curve_integrals(FrameObservation(frames))
    area = once @ np.array([5.0, 5.0, 5.0, 5.0, 5.0])
    np.testing.assert_allclose(area[3], 5.0 + 15.0 + 20.0 + 2.5, rtol=0.02)
    edges_twice = FrameSchedule(frames.start, np.array([3.0004, 4.0004, 5.0, 10.0, 11.0]))
    np.testing.assert_allclose(curve_integrals(FrameObservation(edges_twice))[0], once, atol=0.01)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_few_frames_have_integrals_too(count):
    once, twice = curve_integrals(FrameObservation(FrameSchedule.uniform(count, 2.0)))
    assert np.isfinite(once).all()
    assert np.isfinite(twice).all()
