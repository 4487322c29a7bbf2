"""Transient responses: curves by an ODE solver, truth recovered, silence not taken for a response."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from petkin.errors import InputError
from petkin.fitting import Choices, Given, ReferenceCurve, Status
from petkin.fitting.transient import response
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.methods import find_method

FRAMES = FrameSchedule(np.arange(0.0, 90.0, 1.5), np.arange(1.5, 91.0, 1.5))
METHOD = find_method("lpntPET")
K2_REFERENCE, R1, K2, K2A = 0.12, 1.1, 0.132, 0.044


@cache
def simulated(gamma: float, start: float = 35.0, peak: float = 45.0, sharpness: float = 1.0):
    """Frame means of the region and of the reference region: dC_T/dt with k2a + gamma h(t), by Runge-Kutta."""

    def plasma(t: float) -> float:
        return 300.0 * t * np.exp(-2.5 * t) + 8.0 * (1 - np.exp(-t)) * np.exp(-0.02 * t)

    def slopes(t: float, y: np.ndarray) -> list[float]:
        rate = K2A + gamma * float(response(np.array(t), start, peak, sharpness))
        reference = 0.1 * plasma(t) - K2_REFERENCE * y[0]
        return [reference, R1 * 0.1 * plasma(t) - rate * y[1], y[0], y[1]]

    edges = np.append(FRAMES.start, 90.0)
    areas = solve_ivp(slopes, (0.0, 90.0), np.zeros(4), t_eval=edges, rtol=1e-9, atol=1e-10, max_step=0.5).y[2:]
    reference, region = np.diff(areas, axis=1) / FRAMES.duration
    return region, reference


def given() -> Given:
    _, reference = simulated(0.0)
    return Given(FrameObservation(FRAMES), FRAMES.duration, reference=ReferenceCurve("cerebellum", reference))


def noisy(curve: np.ndarray, share: float, count: int) -> np.ndarray:
    return curve + share * curve.mean() * np.random.default_rng(1).standard_normal((count, len(curve)))


def test_a_response_on_the_grid_is_recovered_without_noise():
    starts = np.linspace(9.0, 76.5, 20)
    start = float(starts[8])
    curve, _ = simulated(0.02, start, start + 10.0, 1.0)
    result = METHOD.fit(curve[None], given(), Choices(), False)
    assert result["tD"][0] == pytest.approx(start, abs=3.6)
    assert result["tP"][0] == pytest.approx(start + 10.0, abs=5.1)
    assert result["gamma"][0] == pytest.approx(0.02, rel=0.15)
    assert result["k2a"][0] == pytest.approx(K2A, rel=0.05)
    assert result["R1"][0] == pytest.approx(R1, rel=0.02)
    assert result["BPND"][0] == pytest.approx(K2 / K2A - 1, rel=0.05)
    assert result.columns[0].values[0] < 1e-6
    assert result.predicted is not None
    np.testing.assert_allclose(result.predicted[0][10:], curve[10:], rtol=5e-3)


def test_a_response_is_found_in_noise_and_its_start_within_its_error():
    curve, _ = simulated(0.03)
    result = METHOD.fit(noisy(curve, 0.01, 60), given(), Choices(), False)
    sure = result.status == Status.OK
    assert sure.mean() > 0.9
    assert np.median(result["tD"][sure]) == pytest.approx(35.0, abs=4.0)
    assert np.median(result["gamma"][sure]) == pytest.approx(0.03, rel=0.35)
    error = 0.01 * result.percent_se("tD") * result["tD"]
    assert (np.abs(result["tD"] - 35.0) < 2.0 * error)[sure].mean() > 0.6
    assert error.min() > 1.7  # half a step of the grid


def test_silence_is_not_taken_for_a_response():
    """No response, 300 curves: a p below 0.05 comes up in about that share, in spite of the search for the best."""
    curve, _ = simulated(0.0)
    result = METHOD.fit(noisy(curve, 0.01, 300), given(), Choices(), True)
    assert (result.columns[0].values < 0.05).mean() < 0.12
    assert (result.status == Status.NOT_IDENTIFIABLE).mean() > 0.85


def test_odd_curves_and_neighbours():
    curve, _ = simulated(0.03)
    curves = np.vstack([noisy(curve, 0.02, 5), np.full((1, len(curve)), np.nan), np.zeros((1, len(curve)))])
    result = METHOD.fit(curves, given(), Choices(), True)
    assert list(result.status[-2:]) == [Status.NOT_FINITE, Status.NO_SIGNAL]
    assert np.isnan(result["gamma"][-2:]).all()
    alone = METHOD.fit(curves[2:3], given(), Choices(), True)
    for symbol in ("gamma", "tD", "R1"):
        np.testing.assert_array_equal(result[symbol][2:3], alone[symbol])


def test_without_a_reference_region_it_is_refused():
    with pytest.raises(InputError, match="lpntPET needs a reference region"):
        METHOD.fit(np.ones((1, 60)), Given(FrameObservation(FRAMES), FRAMES.duration), Choices(), False)
