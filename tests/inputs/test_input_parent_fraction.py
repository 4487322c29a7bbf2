"""Parent fraction curves: recovery, limits, choice, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from petkin.errors import InputError
from petkin.inputs import PARENT_FRACTION_MODELS, fit_parent_fraction

TIMES = np.array([1, 3, 5, 8, 12, 20, 30, 45, 60, 90.0])
TRUTH = {
    "hill": (0.08, 2.2, 9.0),
    "power": (0.12, 2.1, 0.8),
    "exponential": (0.3, 0.004, 0.12),
    "sigmoid": (6.0, 0.5, 0.06),
}


@pytest.mark.parametrize("name", TRUTH)
@pytest.mark.parametrize("f0", [1.0, 0.95])
def test_recovers_noise_free_parameters(name, f0):
    values = f0 * PARENT_FRACTION_MODELS[name].shape(TIMES, *TRUTH[name])
    fit = fit_parent_fraction(TIMES, values, model=name, start=f0)
    recovered = [fit.parameters[symbol] for symbol in "abc"]
    np.testing.assert_allclose(recovered, TRUTH[name], rtol=2e-4)
    np.testing.assert_allclose(fit(TIMES), values, atol=1e-6)
    np.testing.assert_allclose(fit.fitted, values, atol=1e-6)
    assert fit.rss < 1e-10


@pytest.mark.parametrize("name", TRUTH)
def test_recovers_f0_where_nothing_fixes_it(name):
    values = 0.93 * PARENT_FRACTION_MODELS[name].shape(TIMES, *TRUTH[name])
    fit = fit_parent_fraction(TIMES, values, model=name)
    assert fit.parameters["f0"] == pytest.approx(0.93, abs=2e-3)
    assert "0.93" in fit.remarks[0]


@pytest.mark.parametrize("name", TRUTH)
def test_auto_takes_the_model_behind_the_data(name):
    values = PARENT_FRACTION_MODELS[name].shape(TIMES, *TRUTH[name])
    fit = fit_parent_fraction(TIMES, values, model="auto", start=1.0)
    assert (
        np.abs(
            fit(np.linspace(0, 90, 500)) - PARENT_FRACTION_MODELS[name].shape(np.linspace(0, 90, 500), *TRUTH[name])
        ).max()
        < 2e-3
    )
    assert fit.rss < 1e-8


@pytest.mark.parametrize("name", TRUTH)
def test_shapes_against_numbers_worked_by_hand(name):
    by_hand = {  # at t = 9 min with the parameters of TRUTH
        "hill": 0.08 + 0.92 / 2,
        "power": (1 + 1.08**2.1) ** -0.8,
        "exponential": 0.3 * np.exp(-0.036) + 0.7 * np.exp(-1.08),
        "sigmoid": ((216 / (729 + 216)) ** 0.5 + 0.06) / 1.06,
    }
    shape = PARENT_FRACTION_MODELS[name].shape
    assert float(shape(np.array([9.0]), *TRUTH[name])[0]) == pytest.approx(by_hand[name], rel=1e-12)
    assert float(shape(np.array([0.0]), *TRUTH[name])[0]) == 1.0


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(sorted(TRUTH)), st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3))
def test_every_shape_falls_within_zero_and_one(name, shares):
    model = PARENT_FRACTION_MODELS[name]
    parameters = [low + share * (high - low) for share, (low, high) in zip(shares, model.bounds, strict=True)]
    values = model.shape(np.linspace(0, 120, 200), *parameters)
    assert values[0] == 1.0
    assert values.min() >= 0.0
    assert np.diff(values).max() <= 1e-12


def test_a_sample_at_injection_fixes_f0():
    values = np.append(0.97, 0.97 * PARENT_FRACTION_MODELS["hill"].shape(TIMES, *TRUTH["hill"]))
    fit = fit_parent_fraction(np.append(0.0, TIMES), values)
    assert fit.parameters["f0"] == 0.97
    assert float(fit(np.array([0.0]))[0]) == 0.97
    assert float(fit(np.array([-5.0]))[0]) == 0.97


def test_standard_errors_match_the_scatter_of_repeated_fits():
    rng = np.random.default_rng(5)
    clean = PARENT_FRACTION_MODELS["hill"].shape(TIMES, *TRUTH["hill"])
    fits = [
        fit_parent_fraction(TIMES, clean + 0.004 * rng.standard_normal(TIMES.size), model="hill", start=1.0)
        for _ in range(60)
    ]
    scatter = np.std([fit.parameters["c"] for fit in fits])
    stated = np.mean([fit.standard_errors["c"] for fit in fits])
    assert stated == pytest.approx(scatter, rel=0.3)


def test_interpolation_passes_every_sample_and_holds_the_last():
    values = np.array([0.99, 0.9, 0.8, 0.62, 0.5, 0.33, 0.25, 0.2, 0.16, 0.12])
    fit = fit_parent_fraction(TIMES, values, model="interpolated")
    np.testing.assert_allclose(fit(TIMES), values, rtol=1e-12)
    assert float(fit(np.array([0.0]))[0]) == 1.0
    assert float(fit(np.array([500.0]))[0]) == pytest.approx(0.12)
    assert np.diff(fit(np.linspace(0, 90, 900))).max() <= 1e-12
    with_zero = fit_parent_fraction(TIMES, np.where(TIMES > 50, 0.0, values), model="interpolated")
    assert float(with_zero(np.array([90.0]))[0]) == 0.0


def test_too_few_samples_are_interpolated_with_a_remark():
    fit = fit_parent_fraction(np.array([5.0, 30.0]), np.array([0.8, 0.3]))
    assert fit.name == "interpolated"
    assert "too few" in fit.remarks[0]
    single = fit_parent_fraction(np.array([0.0]), np.array([1.0]))
    assert float(single(np.array([40.0]))[0]) == 1.0


def test_too_few_samples_for_a_chosen_model_are_refused():
    with pytest.raises(InputError, match="2 parent fraction samples: too few"):
        fit_parent_fraction(np.array([5.0, 30.0]), np.array([0.8, 0.3]), model="hill")


def test_unknown_model_is_refused():
    with pytest.raises(InputError, match="'weibull'; use one of auto, hill"):
        fit_parent_fraction(TIMES, np.ones_like(TIMES), model="weibull")
