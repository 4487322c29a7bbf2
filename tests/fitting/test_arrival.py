"""Delay and dispersion at once: both recovered, and said to be alike where they are."""

from __future__ import annotations

import numpy as np
import torch

from petkin.dynamics import PiecewiseLinear
from petkin.fitting.arrival import Arrival, estimate_arrival
from petkin.fitting.delay import Delay
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


def test_both_are_recovered_within_their_errors():
    truth = np.array([[0.15, 0.12, 0.06, 0.04, 0.05]])
    clean = frame_averages("2TCM", truth, arrival=ARRIVAL + DELAY)[0]
    sd = counting_sd(clean[None], 0.01, C11)[0]
    curve = clean + sd * np.random.default_rng(4).standard_normal(len(FRAMES))
    found = estimate_arrival(curve, freed(sampled(TAU)), PLAIN, 1.0 / sd**2, TWO_TISSUE, rate_bounds=(1e-3, 5.0))
    assert abs(found.dispersion - TAU) < 3.0 * found.se
    assert abs(found.delay.minutes - DELAY) < 3.0 * found.delay.se
    assert 0.2 < found.correlation < 0.99  # an input freed from more dispersion comes earlier, so its delay is longer
    assert found.told > 1.0


def test_what_cannot_be_told_is_said():
    delay = Delay(0.1, 0.01, False, (np.zeros(1), np.zeros(1)), np.zeros(1))
    nan = float("nan")
    assert "cannot tell it from none" in Arrival(2 / 60, nan, delay, nan, 0.3).sentence
    assert "the two cannot be told apart (correlation 0.98)" in Arrival(4 / 60, 2 / 60, delay, 0.98, 5.0).sentence
    told = Arrival(6 / 60, 1 / 60, delay, 0.7, 9.0).sentence
    assert told == "Dispersion 6 s (standard error 1 s), estimated with the delay (correlation 0.70)."
