"""Profile likelihood against closed forms, other optimisers and simulated coverage."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq, minimize
from scipy.stats import f as fisher

from petkin.fitting import NonlinearSettings, fit_curves, tabulate
from petkin.fitting.profile import profile, with_profiles
from petkin.kinetics import ONE_TISSUE, TWO_TISSUE

from .fitting_problems import ARTERIAL, FRAMES, PLAIN, counting_sd, frame_averages

WEIGHTS = FRAMES.duration / FRAMES.duration.mean()


def noisy(label: str, truth: list[float], share: float, count: int = 1, seed: int = 5):
    clean = frame_averages(label, np.array([truth]))
    sd = counting_sd(clean, share)
    return clean + sd * np.random.default_rng(seed).standard_normal((count, len(FRAMES))), 1.0 / sd[0] ** 2


def test_limits_are_where_an_independent_constrained_fit_reaches_the_limit():
    """One tissue: for each K1, and each VT, scipy minimises over the other two parameters by Nelder-Mead."""
    curves, weights = noisy("1TCM", [0.1, 0.08, 0.05], 0.1)
    settings = NonlinearSettings(ONE_TISSUE)
    result = fit_curves(curves, ARTERIAL, PLAIN, weights, settings)
    found = {p.symbol: p for p in profile(curves[0], result, 0, tabulate(ARTERIAL, PLAIN, settings), settings)}
    assert list(found) == ["K1", "k2", "vB", "VT"]
    freedom = len(FRAMES) - 3
    limit = fisher.ppf(0.95, 1, freedom)

    def cost(K1: float, k2: float, vB: float) -> float:
        return float((weights * (curves[0] - frame_averages("1TCM", np.array([[K1, k2, vB]]))[0]) ** 2).sum())

    best = [result[s][0] for s in ("K1", "k2", "vB")]
    least = cost(*best)
    assert least == pytest.approx(result.chi2[0] * freedom, rel=1e-6)

    def over(symbol: str, value: float) -> float:
        def inner(p: np.ndarray) -> float:
            k2, vB = np.abs(p)
            return cost(value if symbol == "K1" else value * k2, k2, vB)

        end = minimize(inner, best[1:], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-9, "maxiter": 4000})
        return (end.fun - least) / (least / freedom) - limit

    for symbol in ("K1", "VT"):
        here = result[symbol][0]
        assert found[symbol].low == pytest.approx(brentq(lambda c, s=symbol: over(s, c), 0.5 * here, here), rel=2e-4)
        assert found[symbol].high == pytest.approx(brentq(lambda c, s=symbol: over(s, c), here, 2 * here), rel=2e-4)


def test_with_little_noise_the_interval_is_that_of_the_standard_error():
    curves, weights = noisy("2TCM", [0.12, 0.12, 0.06, 0.03, 0.05], 0.001)
    settings = NonlinearSettings(TWO_TISSUE)
    result = fit_curves(curves, ARTERIAL, PLAIN, weights, settings)
    half = np.sqrt(fisher.ppf(0.95, 1, len(FRAMES) - 5))
    for one in profile(curves[0], result, 0, tabulate(ARTERIAL, PLAIN, settings), settings):
        error = result.percent_se(one.symbol)[0] * one.estimate / 100.0
        assert one.estimate - one.low == pytest.approx(half * error, rel=0.04), one.symbol
        assert one.high - one.estimate == pytest.approx(half * error, rel=0.04), one.symbol
        assert one.ratio.min() == 0.0
        assert (np.diff(one.value) > 0).all()


def test_profile_intervals_of_k3_and_VND_hold_where_standard_errors_do_not():
    """10 percent noise, nominal 95 percent; by standard errors k3 and VND cover 79 to 86 of 90 percent."""
    curves, weights = noisy("2TCM", [0.12, 0.12, 0.06, 0.03, 0.05], 0.10, 40)
    settings = NonlinearSettings(TWO_TISSUE)
    result, table = fit_curves(curves, ARTERIAL, PLAIN, weights, settings), tabulate(ARTERIAL, PLAIN, settings)
    held = {"k3": 0, "VND": 0}
    known = {"k3": 0.06, "VND": 1.0}
    for n, curve in enumerate(curves):
        for one in profile(curve, result, n, table, settings, list(held)):
            above = np.isnan(one.low) or known[one.symbol] >= one.low
            held[one.symbol] += above and (np.isnan(one.high) or known[one.symbol] <= one.high)
    assert all(count >= 35 for count in held.values()), held  # 38 expected, standard error 1.4


def test_an_interval_without_an_end_says_so():
    """FDG-like for an hour: nothing tells how slowly the tracer returns."""
    curves, weights = noisy("2TCM3k", [0.1, 0.15, 0.05, 0.05], 0.05)
    settings = NonlinearSettings(TWO_TISSUE)
    result = fit_curves(curves, ARTERIAL, PLAIN, weights, settings)
    k4, VT = profile(curves[0], result, 0, tabulate(ARTERIAL, PLAIN, settings), settings, ["k4", "VT"])
    assert np.isnan(VT.high)
    assert "no upper limit" in VT.words
    assert k4.high < 0.05
    named = with_profiles(result, ["cortex"], {0: (k4, VT)})
    assert np.isnan(named.column("VT-high")[0])
    assert named.column("k4-high")[0] == k4.high
    assert any(text.startswith("2TCM, cortex: VT has no upper limit") for text in named.remarks)
    assert [plot.title for plot in named.plots] == [f"Profile likelihood, cortex: {s}" for s in ("k4", "VT")]
    assert [name for name, _, _ in named.plots[1].lines] == ["profile", "95 % limit"]


def test_fixed_parameters_and_missing_fits_have_no_profile():
    curves, weights = noisy("1TCM", [0.1, 0.08, 0.05], 0.05)
    settings = NonlinearSettings(ONE_TISSUE, ONE_TISSUE.parameters.with_fixed({"vB": 0.05}))
    curves = np.vstack([curves, np.zeros_like(curves)])
    result, table = fit_curves(curves, ARTERIAL, PLAIN, weights, settings), tabulate(ARTERIAL, PLAIN, settings)
    assert [p.symbol for p in profile(curves[0], result, 0, table, settings)] == ["K1", "k2", "VT"]
    assert profile(curves[1], result, 1, table, settings) == ()
    assert profile(curves[0], result, 0, table, settings, ["vB"]) == ()
