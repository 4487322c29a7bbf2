"""Patlak and Logan: lines fitted curve by curve with numpy, and their known biases."""

from __future__ import annotations

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.fitting import Choices, FitResult, Given, Status
from petkin.methods import find_method

from ..fitting.fitting_problems import (
    ARTERIAL,
    C11,
    EDGES,
    FENG,
    FRAMES,
    PLAIN,
    basis_averages,
    blood_averages,
    counting_sd,
    frame_averages,
    macro,
    uniform_truth,
)

K = len(FRAMES)
WEIGHTS = FRAMES.duration * np.exp(-C11 * FRAMES.mid)
LATE = FRAMES.mid >= 30.0
BOTH = pytest.mark.parametrize("label", ["Patlak", "Logan"])


def fit(label: str, curves: np.ndarray, weights: np.ndarray = WEIGHTS, *, vB: float = 0.0, t_star=30.0) -> FitResult:
    given = Given(PLAIN, weights, ARTERIAL)
    return find_method(label).fit(curves, given, Choices(fixed={"vB": vB}, t_star=t_star), False)


def plasma_area(times: np.ndarray) -> np.ndarray:
    """int_0^t C_P by the terms' antiderivatives."""
    s = np.maximum(times - 0.735, 0.0)
    area = np.zeros_like(s)
    for c, rate, n in FENG:
        area += c * (np.exp(rate * s) - 1) / rate if n == 0 else c * ((rate * s - 1) * np.exp(rate * s) + 1) / rate**2
    return area


def noisy_curves(label: str, count: int, share: float) -> np.ndarray:
    clean = frame_averages(label, uniform_truth(label, count))
    return clean + counting_sd(clean, share) * np.random.default_rng(1).standard_normal(clean.shape)


class TestPatlak:
    def test_a_curve_that_obeys_the_equation_is_recovered_exactly(self):
        exposure, plasma = basis_averages(np.array([0.0]))[0], blood_averages()
        Ki, V = np.array([0.01, 0.05, 0.002]), np.array([0.3, 1.0, 0.0])
        result = fit("Patlak", np.outer(Ki, exposure) + np.outer(V, plasma))
        np.testing.assert_allclose(result["Ki"], Ki, rtol=1e-9)
        np.testing.assert_allclose(result["V0"], V, rtol=1e-6, atol=1e-8)
        assert (result.status == Status.OK).all()

    def test_the_line_is_numpy_s_curve_by_curve(self):
        curves = noisy_curves("2TCM3k", 20, 0.05)
        result = fit("Patlak", curves, vB=0.04)
        design = np.stack([basis_averages(np.array([0.0]))[0], blood_averages()], axis=1)[LATE]
        root = np.sqrt(WEIGHTS[LATE])
        for n, curve in enumerate(curves):
            tissue = (curve - 0.04 * blood_averages())[LATE] / 0.96
            solved, wrss, *_ = np.linalg.lstsq(design * root[:, None], tissue * root)
            covariance = wrss[0] / (LATE.sum() - 2) * np.linalg.inv((design.T * root**2) @ design)
            assert result["Ki"][n] == pytest.approx(solved[0], rel=1e-7)
            assert result["V0"][n] == pytest.approx(solved[1], rel=1e-6)
            assert result.percent_se("Ki")[n] == pytest.approx(
                100 * np.sqrt(covariance[0, 0]) / abs(solved[0]), rel=1e-6
            )
            assert result.chi2[n] == pytest.approx(wrss[0] / (LATE.sum() - 2), rel=1e-6)
            assert result.predicted is not None
            back = 0.96 * design @ solved + 0.04 * blood_averages()[LATE]
            np.testing.assert_allclose(result.predicted[n, LATE], back, rtol=1e-9)
            assert np.isnan(result.predicted[n, ~LATE]).all()

    def test_bias_on_noise_free_trapping_curves(self):
        """With blood left in, Ki is low by vB itself, 5 percent here; with blood taken off, within 1 percent."""
        truth = uniform_truth("2TCM3k", 100)
        curves = frame_averages("2TCM3k", truth)
        raw = fit("Patlak", curves)["Ki"]
        error = 100 * (raw / macro("2TCM3k", "Ki", truth) - 1)
        assert -7.0 < np.median(error) < -4.0
        np.testing.assert_allclose(error, -100 * truth[:, -1], atol=2.5)
        known = np.array([fit("Patlak", c[None], vB=float(v))["Ki"][0] for c, v in zip(curves, truth[:, -1])])
        error = 100 * np.abs(known / macro("2TCM3k", "Ki", truth) - 1)
        assert np.median(error) < 1.0
        assert error.max() < 3.0

    def test_bias_shrinks_as_the_fast_pool_follows_the_plasma(self):
        truth = uniform_truth("2TCM3k", 30)
        truth[:, -1] = 0.0
        curves = frame_averages("2TCM3k", truth)
        errors = [
            np.median(np.abs(fit("Patlak", curves, t_star=t)["Ki"] / macro("2TCM3k", "Ki", truth) - 1))
            for t in (10.0, 30.0, 60.0)
        ]
        assert errors[0] > errors[1] > errors[2]
        assert errors[2] < 1.5e-3


class TestLogan:
    def test_the_line_is_numpy_s_curve_by_curve(self):
        """Areas by constants over frames here, by a spline there: a part in a thousand of VT."""
        curves = noisy_curves("2TCM", 20, 0.03)
        result = fit("Logan", curves, vB=0.04)
        widths = np.diff(EDGES)
        for n, curve in enumerate(curves):
            tissue = (curve - 0.04 * blood_averages()) / 0.96
            area = np.cumsum(tissue * widths) - 0.5 * tissue * widths
            x, y = (plasma_area(FRAMES.mid) / tissue)[LATE], (area / tissue)[LATE]
            slope, intercept = np.polyfit(x, y, 1, w=np.sqrt(WEIGHTS[LATE]) * tissue[LATE])
            assert result["VT"][n] == pytest.approx(slope, rel=2e-3)
            assert result["intercept"][n] == pytest.approx(intercept, rel=5e-3)

    def test_bias_on_noise_free_curves(self):
        """One tissue: right within a percent once blood is off. Two tissues, t* 30 min: low by 5 percent (median)."""
        truth = uniform_truth("1TCM", 100)
        truth[:, -1] = 0.0
        single = fit("Logan", frame_averages("1TCM", truth))
        np.testing.assert_allclose(single["VT"], macro("1TCM", "VT", truth), rtol=1e-3)
        truth = uniform_truth("2TCM", 200)
        curves = frame_averages("2TCM", truth)
        error = 100 * (fit("Logan", curves)["VT"] / macro("2TCM", "VT", truth) - 1)
        assert -10.0 < np.median(error) < -6.0
        assert (error < 1.0).mean() > 0.95
        off = fit("Logan", curves, vB=0.05)["VT"]
        assert -6.0 < np.median(100 * (off / macro("2TCM", "VT", truth) - 1)) < -3.0

    def test_a_frame_at_or_below_zero_is_a_frame_like_others(self):
        """A voxel with one empty late frame had no VT at all, then lost the frame; the equation needs no ratio."""
        curves = np.repeat(noisy_curves("2TCM", 1, 0.02), 4, axis=0)
        frame = int(np.flatnonzero(LATE)[3])
        curves[:, frame] = [1e-9, 0.0, -1e-9, -1.0]
        result = fit("Logan", curves)
        assert (result.status == Status.OK).all()
        np.testing.assert_allclose(result["VT"][:3], result["VT"][0], rtol=1e-8)
        np.testing.assert_allclose(result["VT"][3], result["VT"][0], rtol=0.1)


@BOTH
class TestBoth:
    def test_odd_curves_end_in_a_code(self, label):
        good = noisy_curves("2TCM", 1, 0.02)[0]
        infinite = np.where(np.arange(K) == 3, np.inf, good)
        odd = np.stack([good, np.full(K, np.nan), infinite, np.zeros(K), -good, np.full(K, 1e300)])
        result = fit(label, odd)
        assert result.status.tolist() == [
            Status.OK,
            *[Status.NOT_FINITE] * 2,
            *[Status.NO_SIGNAL] * 2,
            Status.NOT_FINITE,
        ]
        assert np.isnan(result.estimates[0].value[1:]).all()
        assert result.estimates[0].value[0] == pytest.approx(fit(label, good[None]).estimates[0].value[0], rel=1e-12)
        assert fit(label, odd[:0]).status.shape == (0,)

    @pytest.mark.parametrize(
        ("curves", "weights", "settings", "message"),
        [
            (np.ones(K), WEIGHTS, {}, "Curves of shape .46,. do not match"),
            (np.ones((2, K - 1)), WEIGHTS, {}, "Curves of shape .2, 45. do not match"),
            (np.ones((2, K)), WEIGHTS[1:], {}, "Weights of shape .45,. match neither"),
            (np.ones((2, K)), np.ones((2, K)), {}, "one weight a frame"),
            (np.ones((2, K)), np.nan * WEIGHTS, {}, "finite and not negative"),
            (np.ones((2, K)), 0 * WEIGHTS, {}, "only 0 frames with weight lie after"),
            (np.ones((2, K)), WEIGHTS, {"t_star": 85.0}, "only 1 frames with weight lie after t. = 85 min"),
            (np.ones((2, K)), WEIGHTS, {"vB": 1.0}, "blood volume fraction of 1 cannot be taken off"),
        ],
    )
    def test_what_does_not_fit_together_is_refused(self, label, curves, weights, settings, message):
        with pytest.raises(InputError, match=message):
            fit(label, curves, weights, **settings)
