"""Delay and dispersion at once: both recovered, and said to be alike where they are."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from petkin.dynamics import PiecewiseLinear
from petkin.fitting.arrival import estimate_arrival
from petkin.inputs.dispersion import dispersed, undispersed
from petkin.inputs.input_function import InputFunction
from petkin.kinetics import TWO_TISSUE

from .fitting_problems import ARRIVAL, C11, FRAMES, PLAIN, bolus, counting_sd, frame_averages

TAU, DELAY = 6.0 / 60.0, 0.2
TIMES = np.r_[np.arange(0, 6, 1 / 60), np.arange(6, 95, 0.5)]


def sampled(tau: float) -> np.ndarray:
    """The bolus behind a dispersion, every second at first."""
    smeared = dispersed(bolus(), tau, end=96.0, tolerance=1e-5) if tau else bolus()
    return smeared(torch.tensor(TIMES)).numpy()


def freed(values: np.ndarray):
    def at(tau: float) -> InputFunction:
        corrected = undispersed(TIMES, values, tau) if tau else values
        curve = PiecewiseLinear(torch.tensor(TIMES), torch.tensor(corrected))
        return InputFunction(curve, curve)

    return at


@pytest.mark.parametrize("tau", [TAU, 0.0])
def test_both_are_recovered_within_their_errors(tau):
    truth = np.array([[0.15, 0.12, 0.06, 0.04, 0.05]])
    clean = frame_averages("2TCM", truth, arrival=ARRIVAL + DELAY)[0]
    sd = counting_sd(clean[None], 0.01, C11)[0]
    curve = clean + sd * np.random.default_rng(4).standard_normal(len(FRAMES))
    found = estimate_arrival(curve, freed(sampled(tau)), PLAIN, 1.0 / sd**2, TWO_TISSUE, rate_bounds=(1e-3, 5.0))
    error = found.se if np.isfinite(found.se) else 1.5 / 60.0
    assert abs(found.dispersion - tau) < 3.0 * error + 0.5 / 60.0
    assert abs(found.delay.minutes - DELAY) < 3.0 * found.delay.se + 2.0 / 60.0
    if tau:
        assert found.correlation < -0.2  # more dispersion taken off is less delay: the input comes early
        assert "estimated with the delay" in found.sentence
    else:
        assert "cannot tell it from none" in found.sentence
