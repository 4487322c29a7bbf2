"""Standard errors: do intervals cover, and is the covariance the inverse of a Jacobian taken by finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student

from petkin.fitting import REGIONS, VOXELS, FitResult, NonlinearSettings, Status, fit_curves
from petkin.fitting.covariance import Limits, model_errors
from petkin.fitting.dense import dense_errors
from petkin.fitting.table import build_table, compress
from petkin.kinetics import TWO_TISSUE, compartment_model

from .fitting_problems import ARTERIAL, FRAMES, PLAIN, counting_sd, frame_averages, macro, uniform_truth

TRUTHS = {
    "1TCM": [0.1, 0.08, 0.05],
    "2TCM3k": [0.1, 0.15, 0.05, 0.05],
    "2TCM": [0.12, 0.12, 0.06, 0.03, 0.05],
}
#: Noise after 10 min: 5 percent, and 2 percent where four rates share one curve.
NOISE = {"1TCM": 0.05, "2TCM3k": 0.05, "2TCM": 0.02}


def simulated(label: str, count: int, share: float, effort=REGIONS) -> tuple[FitResult, dict[str, float]]:
    """Fits of many noisy copies of one curve with their true weights, and the truth."""
    truth = np.array([TRUTHS[label]])
    clean = frame_averages(label, truth)
    sd = counting_sd(clean, share)
    curves = clean + sd * np.random.default_rng(5).standard_normal((count, len(FRAMES)))
    settings = NonlinearSettings(compartment_model(label), effort=effort)
    result = fit_curves(curves, ARTERIAL, PLAIN, 1.0 / sd[0] ** 2, settings)
    outcome = "Ki" if label == "2TCM3k" else "VT"
    known = dict(zip(compartment_model(label).parameters.symbols, TRUTHS[label]))
    return result, known | {outcome: float(macro(label, outcome, truth)[0])}


def coverage(result: FitResult, symbol: str, known: float, freedom: int, level: float = 0.9) -> float:
    """Share of curves whose interval holds the truth, percent; intervals from percent standard errors."""
    half = student.ppf(0.5 + 0.5 * level, freedom) * result.percent_se(symbol) * np.abs(result[symbol]) / 100.0
    return 100.0 * float(np.mean(np.abs(result[symbol] - known) <= half))


@pytest.mark.parametrize("effort", [REGIONS, VOXELS], ids=["regions", "voxels"])
@pytest.mark.parametrize("label", TRUTHS)
def test_nine_in_ten_intervals_hold_the_truth(label, effort):
    """2000 curves: the share itself has a standard error of 0.7 percent."""
    result, known = simulated(label, 2000, NOISE[label], effort)
    assert (result.status == Status.OK).all()
    freedom = len(FRAMES) - len(TRUTHS[label])
    for symbol, value in known.items():
        assert 87.0 < coverage(result, symbol, value, freedom) < 93.0, symbol
    assert result.chi2.mean() == pytest.approx(1.0, abs=0.02)


def test_two_tissue_outcomes_still_cover_at_high_noise_while_k3_no_longer_does():
    """At 10 percent noise the linear error of k3 is too small (79 of 90 percent); K1 and VT keep theirs."""
    result, known = simulated("2TCM", 2000, 0.10)
    freedom = len(FRAMES) - 5
    assert 87.0 < coverage(result, "K1", known["K1"], freedom) < 93.0
    assert 85.0 < coverage(result, "VT", known["VT"], freedom) < 93.0
    assert coverage(result, "k3", known["k3"], freedom) < 85.0
    unsure = result.status == Status.NOT_IDENTIFIABLE
    assert 0.08 < unsure.mean() < 0.18
    assert (result.percent_se("VT")[unsure] > 100).all()


@pytest.mark.parametrize("label", TRUTHS)
def test_errors_are_those_of_a_finite_difference_jacobian(label):
    """Own forward model, central differences, numpy's inverse; macros by the same differences."""
    truth = uniform_truth(label, 20)
    clean = frame_averages(label, truth)
    sd = counting_sd(clean, 0.02)
    weights = 1.0 / (sd**2).mean(axis=0)
    curves = clean + 0.1 * sd * np.random.default_rng(1).standard_normal(clean.shape)
    model = compartment_model(label)
    result = fit_curves(curves, ARTERIAL, PLAIN, weights, NonlinearSettings(model))
    symbols = list(model.parameters.symbols)
    outcome = "Ki" if label == "2TCM3k" else "VT"
    at = np.stack([result[s] for s in symbols], axis=1)
    for n, p in enumerate(at):
        steps = 1e-5 * np.diag(p)
        ahead, behind = frame_averages(label, p + steps), frame_averages(label, p - steps)
        jacobian = ((ahead - behind) / (2e-5 * p[:, None])).T
        s2 = (weights * (curves[n] - frame_averages(label, p[None])[0]) ** 2).sum() / (len(FRAMES) - len(p))
        covariance = s2 * np.linalg.inv(jacobian.T @ (weights[:, None] * jacobian))
        found = [result.percent_se(s)[n] * p[i] / 100.0 for i, s in enumerate(symbols)]
        np.testing.assert_allclose(found, np.sqrt(np.diag(covariance)), rtol=1e-3)
        slope = (macro(label, outcome, p + steps) - macro(label, outcome, p - steps)) / (2e-5 * p)
        expected = np.sqrt(slope @ covariance @ slope)
        assert result.percent_se(outcome)[n] * result[outcome][n] / 100.0 == pytest.approx(expected, rel=1e-3)


def test_errors_do_not_depend_on_the_scale_of_weights_or_activity():
    truth = uniform_truth("2TCM", 5)
    clean = frame_averages("2TCM", truth)
    curves = clean + counting_sd(clean, 0.02) * np.random.default_rng(2).standard_normal(clean.shape)
    settings = NonlinearSettings(TWO_TISSUE)
    plain = fit_curves(curves, ARTERIAL, PLAIN, FRAMES.duration, settings)
    heavy = fit_curves(curves, ARTERIAL, PLAIN, 1e6 * FRAMES.duration, settings)
    for symbol in ("K1", "k3", "VT"):
        np.testing.assert_allclose(heavy[symbol], plain[symbol], rtol=1e-5)
        np.testing.assert_allclose(heavy.percent_se(symbol), plain.percent_se(symbol), rtol=1e-4)
    np.testing.assert_allclose(heavy.chi2, 1e6 * plain.chi2, rtol=1e-8)


def test_what_the_curve_does_not_feel_has_no_finite_error():
    """k4 where k3 ended on 0: it was reported with an error of 0 percent."""
    bounds = TWO_TISSUE.parameters.with_bounds({"k3": (0.0, 1e-9), "k4": (0.01, 0.1)})
    curves = frame_averages("1TCM", np.array([[0.1, 0.08, 0.05]]))
    settings = NonlinearSettings(TWO_TISSUE, parameters=bounds.with_fixed({"k3": 0.0}))
    result = fit_curves(curves, ARTERIAL, PLAIN, FRAMES.duration, settings)
    assert result["k3"][0] == 0.0
    k4 = result.percent_se("k4")[0]
    assert np.isnan(k4) or k4 > 100.0
    assert result.percent_se("VT")[0] < 1e-2  # K1/k2 does not need k4


@pytest.mark.parametrize("fill_in", [model_errors, dense_errors])
def test_an_infinite_value_has_an_infinite_error(fill_in):
    """VND and VT of tracer that stays: k2 = 0 is a bound, K1 / k2 is not known, and counts as such."""
    model, weights = compartment_model("1TCM"), FRAMES.duration
    packed = compress(build_table(ARTERIAL, PLAIN, rate_bounds=(0.0, 5.0), nodes=80), weights, size=16)
    limits = Limits(np.zeros(3, bool), np.zeros(3), np.full(3, np.inf), -np.inf, np.inf)
    values = np.array([[0.1, 0.1], [0.0, 0.2], [0.05, 0.05], [0.0, 0.0]])
    percent = np.empty_like(values)
    fill_in(model, packed, limits, values, percent, np.ones(2), wanted=True)
    assert np.isposinf(values[3, 0])
    assert np.isposinf(percent[3, 0])
    assert np.isnan(percent[1, 0])  # k2 is on its bound
    assert np.isfinite(percent[:, 1]).all()
