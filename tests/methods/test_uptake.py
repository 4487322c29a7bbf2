"""SUV and SUVR against sums by hand."""

from __future__ import annotations

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.fitting import Choices, Given, ReferenceCurve, Status
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.methods import find_method

FRAMES = FrameSchedule(np.array([0.0, 10.0, 30.0, 40.0, 60.0]), np.array([10.0, 30.0, 40.0, 60.0, 90.0]))
REFERENCE = np.array([5.0, 4.0, 3.0, 2.0, 1.0])
CURVES = np.array([[6.0, 6.0, 6.0, 5.0, 4.0], [5.0, 4.0, 3.0, 2.0, 1.0], [0.0, 0.0, 0.0, 0.0, 0.0]])
GIVEN = Given(
    FrameObservation(FRAMES, 0.03),
    np.array([1.0, 2.0, 2.0, 1.0, 0.5]),
    reference=ReferenceCurve("cerebellum", REFERENCE),
    suv=70e3 / 350e3,
)


def test_suv_is_activity_over_dose_per_gram():
    result = find_method("SUV").fit(CURVES, GIVEN, Choices(window=(30.0, 90.0)), False)
    mean = (10 * 6.0 + 20 * 5.0 + 30 * 4.0) / 60
    np.testing.assert_allclose(result["SUV"][0], mean * 70_000 / 350_000)
    assert result.estimates[0].unit == "g mL^-1"
    assert result.settings["window"] == [30.0, 90.0]


def test_suvr_is_a_ratio_of_means_with_the_error_of_a_constant_ratio():
    result = find_method("SUVR").fit(CURVES, GIVEN, Choices(window=(30.0, 90.0)), False)
    d, w, y, g = np.array([10.0, 20.0, 30.0]), np.array([2.0, 1.0, 0.5]), CURVES[0, 2:], REFERENCE[2:]
    theta = (d @ y) / (d @ g)
    left = np.eye(3) - np.outer(g, d) / (d @ g)
    s2 = (w * (y - theta * g) ** 2).sum() / np.trace(np.diag(w) @ left @ np.diag(1 / w) @ left.T)
    error = np.sqrt(s2 * (d**2 / w).sum()) / (d @ g)
    np.testing.assert_allclose(result["SUVR"][0], theta)
    np.testing.assert_allclose(result.percent_se("SUVR")[0], 100 * error / theta)
    np.testing.assert_allclose(result["SUVR"][1], 1.0)
    assert result.percent_se("SUVR")[1] == 0.0
    assert result.status[2] == Status.NO_SIGNAL
    np.testing.assert_allclose(result.predicted[0, 2:], theta * g)


def test_the_error_of_suvr_is_that_of_repeated_noise():
    rng, truth = np.random.default_rng(5), 1.7
    sd = 0.05 / np.sqrt(GIVEN.weights)
    curves = truth * REFERENCE + sd * rng.standard_normal((4000, 5))
    result = find_method("SUVR").fit(curves, GIVEN, Choices(window=(0.0, 90.0)), True)
    error = result.percent_se("SUVR") / 100 * result["SUVR"]
    np.testing.assert_allclose(np.sqrt((error**2).mean()), result["SUVR"].std(), rtol=0.05)


def test_without_a_window_it_runs_from_t_star_to_the_end():
    chosen = find_method("SUVR").fit(CURVES, GIVEN, Choices(t_star=40.0), False)
    assert chosen.settings["window"] == [40.0, 90.0]
    automatic = find_method("SUVR").fit(CURVES, GIVEN, Choices(t_star=None), False)
    assert automatic.settings["window"] == [30.0, 90.0]


def test_a_window_without_a_frame_is_refused():
    with pytest.raises(InputError, match="no frame's middle lies from 91 to 95 min; the frames cover 0 to 90 min"):
        find_method("SUVR").fit(CURVES, GIVEN, Choices(window=(91.0, 95.0)), False)


@pytest.mark.parametrize(("label", "what"), [("SUV", "the injected dose"), ("SUVR", "a reference region")])
def test_what_is_missing_is_named(label, what):
    with pytest.raises(InputError, match=what):
        find_method(label).fit(CURVES, Given(GIVEN.observation, GIVEN.weights), Choices(), False)
