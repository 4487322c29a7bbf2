"""Patlak and Logan: lines fitted curve by curve with numpy, their known biases, and another program on real scans."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t as student

from petkin.errors import InputError
from petkin.fitting import GraphicalSettings, Status, fit_logan, fit_patlak
from petkin.imaging import FrameObservation

from .fitting_problems import (
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
from .real_scans import read_scans

K = len(FRAMES)
WEIGHTS = FRAMES.duration * np.exp(-C11 * FRAMES.mid)
LATE = FRAMES.mid >= 30.0
BOTH = pytest.mark.parametrize("method", [fit_patlak, fit_logan])


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
        result = fit_patlak(np.outer(Ki, exposure) + np.outer(V, plasma), ARTERIAL, PLAIN, WEIGHTS, GraphicalSettings())
        np.testing.assert_allclose(result["Ki"], Ki, rtol=1e-9)
        np.testing.assert_allclose(result["V0"], V, rtol=1e-6, atol=1e-8)
        assert (result.status == Status.OK).all()

    def test_the_line_is_numpy_s_curve_by_curve(self):
        curves = noisy_curves("2TCM3k", 20, 0.05)
        result = fit_patlak(curves, ARTERIAL, PLAIN, WEIGHTS, GraphicalSettings(vB=0.04))
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
        raw = fit_patlak(curves, ARTERIAL, PLAIN, WEIGHTS, GraphicalSettings())["Ki"]
        error = 100 * (raw / macro("2TCM3k", "Ki", truth) - 1)
        assert -7.0 < np.median(error) < -4.0
        np.testing.assert_allclose(error, -100 * truth[:, -1], atol=2.5)
        known = np.array(
            [
                fit_patlak(c[None], ARTERIAL, PLAIN, WEIGHTS, GraphicalSettings(vB=float(v)))["Ki"][0]
                for c, v in zip(curves, truth[:, -1])
            ]
        )
        error = 100 * np.abs(known / macro("2TCM3k", "Ki", truth) - 1)
        assert np.median(error) < 1.0
        assert error.max() < 3.0

    def test_bias_shrinks_as_the_fast_pool_follows_the_plasma(self):
        truth = uniform_truth("2TCM3k", 30)
        truth[:, -1] = 0.0
        curves = frame_averages("2TCM3k", truth)
        errors = [
            np.median(
                np.abs(
                    fit_patlak(curves, ARTERIAL, PLAIN, WEIGHTS, GraphicalSettings(t_star=t))["Ki"]
                    / macro("2TCM3k", "Ki", truth)
                    - 1
                )
            )
            for t in (10.0, 30.0, 60.0)
        ]
        assert errors[0] > errors[1] > errors[2]
        assert errors[2] < 1.5e-3

    def test_errors_cover(self):
        """2000 noisy curves with true weights: nine in ten intervals hold the noise-free line's Ki."""
        clean = frame_averages("2TCM3k", np.array([[0.1, 0.15, 0.05, 0.0]]))
        sd = counting_sd(clean, 0.05)
        curves = clean + sd * np.random.default_rng(2).standard_normal((2000, K))
        result = fit_patlak(curves, ARTERIAL, PLAIN, 1.0 / sd[0] ** 2, GraphicalSettings())
        line = fit_patlak(clean, ARTERIAL, PLAIN, 1.0 / sd[0] ** 2, GraphicalSettings())["Ki"][0]
        half = student.ppf(0.95, LATE.sum() - 2) * result.percent_se("Ki") * np.abs(result["Ki"]) / 100
        assert 0.87 < (np.abs(result["Ki"] - line) <= half).mean() < 0.93


class TestLogan:
    def test_the_line_is_numpy_s_curve_by_curve(self):
        curves = noisy_curves("2TCM", 20, 0.03)
        result = fit_logan(curves, ARTERIAL, PLAIN, WEIGHTS, GraphicalSettings(vB=0.04))
        widths = np.diff(EDGES)
        for n, curve in enumerate(curves):
            tissue = (curve - 0.04 * blood_averages()) / 0.96
            area = np.cumsum(tissue * widths) - 0.5 * tissue * widths
            x, y = (plasma_area(FRAMES.mid) / tissue)[LATE], (area / tissue)[LATE]
            (slope, intercept), covariance = np.polyfit(x, y, 1, w=np.sqrt(WEIGHTS[LATE]) * tissue[LATE], cov=True)
            assert result["VT"][n] == pytest.approx(slope, rel=1e-7)
            assert result["intercept"][n] == pytest.approx(intercept, rel=1e-6)
            error = 100 * np.sqrt(covariance[0, 0]) / abs(slope)
            assert result.percent_se("VT")[n] == pytest.approx(error, rel=1e-6)

    def test_bias_on_noise_free_curves(self):
        """One tissue: right within a percent once blood is off. Two tissues, t* 30 min: low by 5 percent (median)."""
        truth = uniform_truth("1TCM", 100)
        truth[:, -1] = 0.0
        single = fit_logan(frame_averages("1TCM", truth), ARTERIAL, PLAIN, WEIGHTS, GraphicalSettings())
        np.testing.assert_allclose(single["VT"], macro("1TCM", "VT", truth), rtol=1e-3)
        truth = uniform_truth("2TCM", 200)
        curves = frame_averages("2TCM", truth)
        error = 100 * (
            fit_logan(curves, ARTERIAL, PLAIN, WEIGHTS, GraphicalSettings())["VT"] / macro("2TCM", "VT", truth) - 1
        )
        assert -10.0 < np.median(error) < -6.0
        assert (error < 1.0).mean() > 0.95
        off = fit_logan(curves, ARTERIAL, PLAIN, WEIGHTS, GraphicalSettings(vB=0.05))["VT"]
        assert -6.0 < np.median(100 * (off / macro("2TCM", "VT", truth) - 1)) < -3.0

    def test_a_frame_at_or_below_zero_drops_out(self):
        """A voxel with one empty late frame had no VT at all."""
        curves = np.repeat(noisy_curves("2TCM", 1, 0.02), 3, axis=0)
        frame = int(np.flatnonzero(LATE)[3])
        curves[1, frame] = 0.0
        curves[2, frame] = -1.0
        result = fit_logan(curves, ARTERIAL, PLAIN, WEIGHTS, GraphicalSettings())
        assert (result.status == Status.OK).all()
        np.testing.assert_allclose(result["VT"], result["VT"][0], rtol=0.15)
        without = np.where(np.arange(K) == frame, 0.0, WEIGHTS)
        again = fit_logan(curves[1:2], ARTERIAL, PLAIN, without, GraphicalSettings())
        assert result["VT"][1] == pytest.approx(again["VT"][0], rel=1e-12)
        assert result.percent_se("VT")[1] == pytest.approx(again.percent_se("VT")[0], rel=1e-9)


@BOTH
class TestBoth:
    def test_odd_curves_end_in_a_code(self, method):
        good = noisy_curves("2TCM", 1, 0.02)[0]
        infinite = np.where(np.arange(K) == 3, np.inf, good)
        odd = np.stack([good, np.full(K, np.nan), infinite, np.zeros(K), -good, np.full(K, 1e300)])
        result = method(odd, ARTERIAL, PLAIN, WEIGHTS, GraphicalSettings())
        assert result.status.tolist() == [
            Status.OK,
            *[Status.NOT_FINITE] * 2,
            *[Status.NO_SIGNAL] * 2,
            Status.NOT_FINITE,
        ]
        assert np.isnan(result.estimates[0].value[1:]).all()
        assert result.estimates[0].value[0] == pytest.approx(
            method(good[None], ARTERIAL, PLAIN, WEIGHTS, GraphicalSettings()).estimates[0].value[0], rel=1e-12
        )
        assert method(odd[:0], ARTERIAL, PLAIN, WEIGHTS, GraphicalSettings()).status.shape == (0,)

    @pytest.mark.parametrize(
        ("curves", "weights", "settings", "message"),
        [
            (np.ones(K), WEIGHTS, {}, "Curves of shape .46,. do not match"),
            (np.ones((2, K - 1)), WEIGHTS, {}, "Curves of shape .2, 45. do not match"),
            (np.ones((2, K)), WEIGHTS[1:], {}, "Weights of shape .45,. match neither"),
            (np.ones((2, K)), np.ones((2, K)), {}, "one weight a frame"),
            (np.ones((2, K)), np.nan * WEIGHTS, {}, "finite and not negative"),
            (np.ones((2, K)), 0 * WEIGHTS, {}, "Only 0 frames with weight lie after"),
            (np.ones((2, K)), WEIGHTS, {"t_star": 85.0}, "Only 1 frames with weight lie after t. = 85 min"),
            (np.ones((2, K)), WEIGHTS, {"vB": 1.0}, "blood volume fraction of 1 cannot be taken off"),
        ],
    )
    def test_what_does_not_fit_together_is_refused(self, method, curves, weights, settings, message):
        with pytest.raises(InputError, match=message):
            method(curves, ARTERIAL, PLAIN, weights, GraphicalSettings(**settings))


def test_kinfitr_s_graphical_results_on_real_scans(shared_data):
    """vB 0.05, last ten frames. Its Logan weights ratios as they are: C^2 less here. Differences: its trapezoids."""
    table = pd.read_csv(shared_data / "pbr28/derivatives/kinfitr/kinfitr_reference_fits.tsv", sep="\t")
    logan, patlak = [], []
    for scan in read_scans(shared_data / "pbr28"):
        arterial, observation = scan.arterial().delayed(scan.shift), FrameObservation(scan.frames)
        settings = GraphicalSettings(t_star=float(scan.frames.mid[-10]) - 1e-9, vB=0.05)
        blood = observation.of_forcing(arterial.whole_blood).numpy()
        for region in scan.best.region:
            curve = scan.curves[region].to_numpy()[None]
            rows = table[(scan.name == table.PET) & (table.region == region)].set_index(["model", "par"])
            tissue = np.maximum((curve[0] - 0.05 * blood) / 0.95, 1e-2)
            VT = fit_logan(curve, arterial, observation, scan.weights / tissue**2, settings)["VT"][0]
            logan.append(VT / rows.value["logan_t10", "Vt"] - 1)
            Ki = fit_patlak(curve, arterial, observation, scan.weights, settings)["Ki"][0]
            known, error = rows.value["patlak_t10", "Ki"], rows.se_pct["patlak_t10", "Ki"] / 100
            patlak.append((Ki / known - 1) / error)
    assert len(logan) == len(patlak) == 72
    assert np.median(np.abs(logan)) < 0.002
    assert np.abs(logan).max() < 0.01
    assert np.median(np.abs(patlak)) < 0.05  # in its standard errors; Ki is near zero for this reversible tracer
    assert np.abs(patlak).max() < 0.3
