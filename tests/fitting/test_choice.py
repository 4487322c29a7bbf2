"""Model choice by AICc: weights by hand, how often it is right, averages and their errors."""

from __future__ import annotations

import numpy as np
import pytest

from petkin.fitting import Estimate, FitResult, NonlinearSettings, Status, agreement, compare_models, fit_curves
from petkin.fitting.choice import akaike
from petkin.kinetics import ONE_TISSUE, TWO_TISSUE

from .fitting_problems import ARTERIAL, FRAMES, PLAIN, counting_sd, frame_averages


def made(label: str, aicc: list[float], VT: list[float], percent: list[float], *extra: Estimate) -> FitResult:
    count = len(aicc)
    estimates = (Estimate("VT", "mL cm^-3", np.array(VT), np.array(percent), "volume"), *extra)
    return FitResult(
        label, estimates, np.full(count, float(count)), np.array(aicc), np.zeros(count, np.uint8), np.ones(20)
    )


def test_weights_and_averages_are_those_of_the_text_book():
    """Differences 0 and 2 give weights 1 / (1 + e^-1); the unconditional error is Burnham & Anderson's."""
    one = made("A", [10.0, 5.0], [2.0, 4.0], [10.0, 5.0], Estimate("K1", "1", np.ones(2), np.ones(2)))
    two = made("B", [12.0, 5.0], [3.0, 4.0], [20.0, 5.0])
    both = compare_models((one, two))
    w = 1.0 / (1.0 + np.exp(-1.0))
    mean = w * 2.0 + (1 - w) * 3.0
    error = w * np.hypot(0.2, 2.0 - mean) + (1 - w) * np.hypot(0.6, 3.0 - mean)
    assert both.model == "AICc"
    assert [e.symbol for e in both.estimates] == ["VT"]  # what both have
    np.testing.assert_allclose(both["VT"], [mean, 4.0])
    np.testing.assert_allclose(both.percent_se("VT"), [100 * error / mean, 5.0])
    np.testing.assert_allclose(both.column("weight-A"), [w, 0.5])
    np.testing.assert_allclose(both.column("delta-B"), [2.0, 0.0])
    np.testing.assert_allclose(both.column("VT-spread"), [100 / mean, 0.0])
    assert list(both.column("choice")) == [1, 1]
    assert list(both.columns[0].cells) == ["A", "A"]


def test_models_without_a_fit_do_not_count_and_curves_without_any_have_no_choice():
    nan = float("nan")
    one, two = made("A", [nan, nan], [nan, nan], [nan, nan]), made("B", [3.0, nan], [1.5, nan], [8.0, nan])
    both = compare_models((one, two))
    assert both["VT"][0] == 1.5
    assert np.isnan(both["VT"][1])
    assert list(both.column("choice")) == [2, 0]
    above, weights = akaike(np.array([[nan, nan], [3.0, nan]]))
    assert np.isnan(above[:, 1]).all()
    assert (weights[:, 1] == 0).all()


def test_there_is_no_average_where_the_likely_model_has_no_finite_value():
    one, two = made("A", [10.0, 10.0], [2.0, 2.0], [5.0, 5.0]), made("B", [5.0, 30.0], [np.inf, np.inf], [np.nan] * 2)
    both = compare_models((one, two))
    assert np.isnan(both["VT"][0])
    assert both["VT"][1] == pytest.approx(2.0, rel=1e-3)


def share_right(label: str, truth: list[float], noise: float) -> tuple[float, FitResult, FitResult]:
    clean = frame_averages(label, np.array([truth]))
    sd = counting_sd(clean, noise)
    curves = clean + sd * np.random.default_rng(9).standard_normal((400, len(FRAMES)))
    fits = [
        fit_curves(curves, ARTERIAL, PLAIN, 1.0 / sd[0] ** 2, NonlinearSettings(m)) for m in (ONE_TISSUE, TWO_TISSUE)
    ]
    both = compare_models(fits)
    right = 1 if label == "1TCM" else 2
    return float(np.mean(both.column("choice") == right)), both, fits[1]


@pytest.mark.parametrize(("noise", "least"), [(0.02, 0.93), (0.10, 0.93)])
def test_one_tissue_is_recognised_whatever_the_noise(noise, least):
    """AICc errs towards two tissues now and then by construction, as a test with a level of a few percent would."""
    right, _, _ = share_right("1TCM", [0.1, 0.08, 0.05], noise)
    assert least <= right < 1.0


def test_two_tissues_are_recognised_until_noise_hides_them():
    shares = [share_right("2TCM", [0.12, 0.12, 0.06, 0.03, 0.05], noise)[0] for noise in (0.02, 0.05, 0.10, 0.20)]
    assert shares[0] == 1.0
    assert shares == sorted(shares, reverse=True)
    assert shares[1] > 0.9
    assert shares[3] < 0.6


def test_the_average_steadies_VT_where_the_choice_is_open():
    _, both, two = share_right("2TCM", [0.12, 0.12, 0.06, 0.03, 0.05], 0.10)
    assert np.nanstd(both["VT"]) < np.nanstd(two["VT"])
    assert (both.status[both.column("choice") == 1] <= Status.AT_BOUND).all()


def test_agreement_counts_winners_and_what_they_agree_on():
    one, two = made("A", [1.0, 9.0], [2.0, 2.0], [10.0, 1.0]), made("B", [2.0, 3.0], [2.1, 3.0], [10.0, 1.0])
    text = agreement((one, two))
    assert (
        text == "Least AICc: A in 1, B in 1 of 2 regions. The models agree within two standard errors on VT in 1 of 2."
    )
