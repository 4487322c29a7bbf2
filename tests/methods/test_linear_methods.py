"""What every linear method owes: exactness on curves that obey it, invariance, odd curves, and errors that cover."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import t as student

from petkin.dynamics import ExponentialSum
from petkin.fitting import Choices, FitResult, Given, Status
from petkin.imaging import FrameObservation
from petkin.inputs import InputFunction
from petkin.methods import find_method

from ..fitting.fitting_problems import ARRIVAL, ARTERIAL, C11, FRAMES, PLAIN, bolus, counting_sd, frame_averages

K = len(FRAMES)


@dataclass(frozen=True)
class Case:
    """A method, and a model whose curves obey its equation.

    Args:
        label: method.
        model: of the curves.
        parameters: of the model, vB last.
        expected: what the method must find, by symbol.
        tolerance: relative error left by the spline through areas.
        unknowns: of the regression.
    """

    label: str
    model: str
    parameters: tuple[float, ...]
    expected: dict[str, float]
    tolerance: float
    unknowns: int


TWO = {"K1": 0.15, "k2": 0.15, "k3": 0.06, "k4": 0.03, "VT": 3.0}
CASES = [
    Case("Patlak", "2TCM3k", (0.12, 2.0, 1.0, 0.0), {"Ki": 0.04}, 1e-4, 2),
    Case("Logan", "1TCM", (0.2, 0.1, 0.0), {"VT": 2.0, "intercept": -10.0}, 1e-5, 2),
    Case("MA1", "1TCM", (0.2, 0.1, 0.0), {"VT": 2.0, "intercept": -10.0}, 1e-5, 2),
    Case("MA2", "2TCM", (0.15, 0.15, 0.06, 0.03, 0.0), {"VT": 3.0, "VND": 1.0, "VS": 2.0, "K1": 0.15}, 5e-5, 4),
    Case("LS2TCM", "2TCM", (0.15, 0.15, 0.06, 0.03, 0.05), {**TWO, "vB": 0.05}, 4e-4, 5),
]
EACH = pytest.mark.parametrize("case", CASES, ids=lambda c: c.label)


def clean(case: Case, arrival: float = ARRIVAL) -> np.ndarray:
    return frame_averages(case.model, np.array([case.parameters]), arrival=arrival)


def noisy(case: Case, count: int, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Curves and true weights."""
    curve = clean(case)
    sd = counting_sd(curve, share)
    return curve + sd * np.random.default_rng(5).standard_normal((count, K)), 1.0 / sd[0] ** 2


def fit(case: Case, curves: np.ndarray, weights: np.ndarray | None = None, **rest) -> FitResult:
    weights = FRAMES.duration * np.exp(-C11 * FRAMES.mid) if weights is None else weights
    given = Given(rest.pop("observation", PLAIN), weights, rest.pop("arterial", ARTERIAL))
    return find_method(case.label).fit(curves, given, Choices(**rest), False)


@EACH
def test_curves_that_obey_the_equation_give_their_parameters_back(case):
    result = fit(case, clean(case))
    assert result.status.tolist() == [Status.OK]
    for symbol, value in case.expected.items():
        assert result[symbol][0] == pytest.approx(value, rel=case.tolerance), symbol
    assert {e.symbol for e in result.estimates} >= set(case.expected)
    assert result.predicted is not None
    used = np.isfinite(result.predicted[0])
    assert used.sum() == result.settings["frames_used"]
    late = used & (FRAMES.mid > 2.0)
    np.testing.assert_allclose(result.predicted[0, late], clean(case)[0, late], rtol=2e-3)


@EACH
def test_so_do_curves_that_frames_weigh_by_decay_or_that_arrive_later(case):
    whole, late = clean(case), clean(case, arrival=1.5)
    outcome = find_method(case.label).outcome
    delayed = fit(case, late, arterial=InputFunction(bolus(1.5), bolus(1.5)))
    assert delayed[outcome][0] == pytest.approx(case.expected[outcome], rel=10 * case.tolerance)
    fine = np.linspace(0.0, 90.0, 5401)
    shares = frame_averages(case.model, np.array([case.parameters]), edges=fine)[0]
    decayed = shares * np.exp(-C11 * 0.5 * (fine[1:] + fine[:-1]))
    weight = np.exp(-C11 * 0.5 * (fine[1:] + fine[:-1]))
    place = np.searchsorted(FRAMES.end, 0.5 * (fine[1:] + fine[:-1]))
    values = np.bincount(place, decayed, K) / np.bincount(place, weight, K)
    assert not np.allclose(values, whole[0], rtol=1e-3)
    result = fit(case, values[None], observation=FrameObservation(FRAMES, C11))
    assert result[outcome][0] == pytest.approx(case.expected[outcome], rel=10 * case.tolerance)


@EACH
def test_units_of_activity_and_of_weights_do_not_matter(case):
    curves, weights = noisy(case, 5, 0.02)
    plain = fit(case, curves, weights)
    twice = ExponentialSum(2.0 * bolus().coefficients, bolus().exponents, bolus().powers, ARRIVAL)
    scaled = fit(case, 2.0 * curves, 7.0 * weights, arterial=InputFunction(twice, twice))
    for a, b in zip(plain.estimates, scaled.estimates):
        np.testing.assert_allclose(b.value, a.value, rtol=1e-6)
        np.testing.assert_allclose(b.percent_se, a.percent_se, rtol=1e-5)


@EACH
def test_batch_and_loop_agree_to_the_byte_and_single_precision_nearly(case):
    curves, weights = noisy(case, 70, 0.02)
    whole = fit(case, curves, weights)
    single = fit(case, np.asfortranarray(curves, np.float32), weights)
    for n in (0, 33, 69):
        alone = fit(case, curves[n : n + 1], weights)
        for a, b in zip(alone.estimates, whole.estimates):
            assert a.value.tobytes() == b.value[n : n + 1].tobytes()
            assert a.percent_se.tobytes() == b.percent_se[n : n + 1].tobytes()
    for a, b in zip(whole.estimates, single.estimates):
        np.testing.assert_allclose(b.value, a.value, rtol=2e-4, atol=1e-5 * np.abs(a.value).max())


@EACH
def test_odd_curves_end_in_a_code_and_leave_their_neighbours_alone(case):
    good = noisy(case, 1, 0.02)[0][0]
    broken = np.where(np.arange(K) == K - 2, np.nan, good)
    negative = np.where(np.arange(K) == K - 2, -0.3 * good, good)
    odd = np.stack([good, broken, negative, np.zeros(K), -good, np.full(K, np.inf)])
    result = fit(case, odd)
    assert result.status[[0, 1, 3, 4, 5]].tolist() == [
        Status.OK,
        Status.NOT_FINITE,
        Status.NO_SIGNAL,
        Status.NO_SIGNAL,
        Status.NOT_FINITE,
    ]
    outcome = find_method(case.label).outcome
    assert np.isfinite(result[outcome][2])
    assert np.isnan(result[outcome][[1, 3, 4, 5]]).all()
    assert result[outcome][:1].tobytes() == fit(case, good[None])[outcome].tobytes()
    assert fit(case, odd[:0]).status.shape == (0,)


@EACH
def test_ninety_percent_intervals_cover(case):
    """2000 noisy curves with their true weights; 90 percent intervals, of the mean that the method tends to."""
    curves, weights = noisy(case, 2000, 0.02)
    result = fit(case, curves, weights)
    freedom = result.settings["frames_used"] - case.unknowns
    for estimate in result.estimates:
        half = student.ppf(0.95, freedom) * estimate.percent_se * np.abs(estimate.value) / 100
        tends_to = np.median(estimate.value)
        covered = (np.abs(estimate.value - tends_to) <= half).mean()
        assert 0.87 < covered < 0.93, (estimate.symbol, covered)


@EACH
def test_blood_taken_off_beforehand_is_blood_that_was_not_there(case):
    bare = replace(case, parameters=(*case.parameters[:-1], 0.0))
    bloody = replace(case, parameters=(*case.parameters[:-1], 0.07))
    outcome = find_method(case.label).outcome
    fixed = {"vB": 0.0} if case.label == "LS2TCM" else {}
    expected = fit(bare, clean(bare), fixed=fixed)[outcome]
    np.testing.assert_allclose(fit(bloody, clean(bloody), fixed={"vB": 0.07})[outcome], expected, rtol=1e-6)


def test_derivatives_behind_the_errors_are_those_of_differences():
    from petkin.methods import ls2tcm, ma1, ma2

    theta = np.array([[0.014, 0.02], [0.15, 0.2], [0.05, 0.04], [-0.25, -0.3], [-0.005, -0.006]])
    for read, rows in ((ma1._read, [1, 3]), (ma2._read, [0, 1, 3, 4]), (ls2tcm._read, [0, 1, 2, 3, 4])):
        at = theta[rows]
        values, slopes = read(at)
        for i in range(len(at)):
            step = np.zeros_like(at)
            step[i] = 1e-6 * np.abs(at[i])
            difference = (read(at + step)[0] - read(at - step)[0]) / (2 * step[i])
            np.testing.assert_allclose(slopes[:, i], difference, rtol=1e-5, atol=1e-6 * np.abs(values).max())
