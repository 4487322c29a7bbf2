"""Spectral analysis: exact curves, another program's optimum, errors that cover, and what a short scan cannot tell."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from petkin.errors import InputError
from petkin.fitting import Choices, Given, Status
from petkin.fitting.non_negative import solve_non_negative
from petkin.fitting.spectrum import SpectrumSettings, fit_spectrum
from petkin.fitting.table import build_table
from petkin.methods import find_method

from .fitting_problems import ARTERIAL, FRAMES, PLAIN, counting_sd, frame_averages, macro, uniform_truth
from .test_standard_errors import coverage

RATES = (1e-3, 5.0)
METHOD = find_method("SpectralAnalysis")


def test_noise_free_curves_give_back_what_a_grid_of_rates_can_tell():
    """Rates lie between those of the grid: a few in ten thousand."""
    truth = uniform_truth("2TCM", 40, 3)
    result = fit_spectrum(frame_averages("2TCM", truth), ARTERIAL, PLAIN, FRAMES.duration, SpectrumSettings(RATES, 4))
    assert np.median(np.abs(result["VT"] / macro("2TCM", "VT", truth) - 1)) < 5e-4
    assert np.abs(result["VT"] / macro("2TCM", "VT", truth) - 1).max() < 0.01
    np.testing.assert_allclose(result["K1"], truth[:, 0], rtol=1e-3)
    np.testing.assert_allclose(result["vB"], truth[:, 4], rtol=5e-3)
    assert (result.status == Status.OK).all()
    assert np.median(result.columns[0].values) == 2


def test_trapping_gathers_at_the_slowest_rate_and_says_so():
    truth = uniform_truth("2TCM3k", 20)
    result = fit_spectrum(frame_averages("2TCM3k", truth), ARTERIAL, PLAIN, FRAMES.duration, SpectrumSettings(RATES, 4))
    np.testing.assert_allclose(result["Ki"], macro("2TCM3k", "Ki", truth), rtol=0.08)  # 1e-3 per min is 9 % in 90 min
    np.testing.assert_allclose(result["K1"], truth[:, 0], rtol=0.08)
    assert (result.status == Status.AT_BOUND).all()


def test_costs_are_those_of_another_program_s_non_negative_least_squares():
    truth = uniform_truth("2TCM", 10, 5)
    clean = frame_averages("2TCM", truth)
    sd = counting_sd(clean, 0.1)
    curves = clean + sd * np.random.default_rng(0).standard_normal(clean.shape)
    weights = 1.0 / (sd**2).mean(axis=0)
    result = fit_spectrum(curves, ARTERIAL, PLAIN, weights, SpectrumSettings(RATES, 4))
    table = build_table(ARTERIAL, PLAIN, rate_bounds=RATES, nodes=100)
    columns = np.vstack([table.blood, table.basis]).T * np.sqrt(weights)[:, None]
    assert result.predicted is not None
    for n, curve in enumerate(curves):
        expected = nnls(columns, curve * np.sqrt(weights))[1] ** 2
        assert (weights * (curve - result.predicted[n]) ** 2).sum() == pytest.approx(expected, rel=1e-6)


def test_the_solver_meets_the_conditions_of_an_optimum():
    """No amplitude is negative, no column outside helps, none inside leans on the residual."""
    rng = np.random.default_rng(1)
    columns = np.abs(rng.standard_normal((30, 12)))
    columns /= np.linalg.norm(columns, axis=1, keepdims=True)
    z = rng.standard_normal((12, 200)) + 1.0
    x = np.empty((30, 200))
    solve_non_negative(columns, z, x)
    lean = columns @ (z - columns.T @ x)
    size = np.linalg.norm(z, axis=0)
    assert (x >= 0).all()
    few = np.count_nonzero(x, axis=0) < 12
    assert (lean[:, few] <= 1e-9 * size[few]).all()
    assert (np.abs(lean) * (x > 0) <= 1e-9 * size).all()


@pytest.mark.parametrize(("draws", "most", "ratio"), [(200, 97.0, (0.75, 1.4)), (16, 99.0, (0.6, 2.0))])
def test_intervals_hold_the_truth(draws, most, ratio):
    """One tissue, 2 percent noise, 600 curves: 90 percent intervals hold it in 87 to 97 percent.

    The error is that of a normal distribution with as wide a 90 percent interval as the estimates have. All curves have
    the same draws, and 16 of them know it to a third.
    """
    truth = np.array([[0.15, 0.1, 0.05]])
    clean = frame_averages("1TCM", truth)
    sd = counting_sd(clean, 0.02)[0]
    curves = clean + sd * np.random.default_rng(2).standard_normal((600, len(FRAMES)))
    result = fit_spectrum(curves, ARTERIAL, PLAIN, 1.0 / sd**2, SpectrumSettings(RATES, draws))
    for symbol, known in (("K1", 0.15), ("VT", 1.5), ("vB", 0.05)):
        assert 87.0 < coverage(result, symbol, known, 42) < most
        away = np.quantile(np.abs(result[symbol] / known - 1.0), 0.9)
        assert ratio[0] < np.median(result.percent_se(symbol)) / (100.0 * away / 1.645) < ratio[1]
    assert np.median(result["VT"]) == pytest.approx(1.5, rel=0.02)


def test_voxels_follow_regions_and_do_not_depend_on_their_neighbours():
    truth = uniform_truth("1TCM", 50)
    clean = frame_averages("1TCM", truth)
    curves = clean + counting_sd(clean, 0.05) * np.random.default_rng(3).standard_normal(clean.shape)
    given = Given(PLAIN, FRAMES.duration, ARTERIAL)
    region, voxel = (METHOD.fit(curves, given, Choices(), voxels) for voxels in (False, True))
    np.testing.assert_allclose(np.median(voxel["VT"] / region["VT"]), 1.0, rtol=1e-3)
    assert voxel.predicted is None
    alone = METHOD.fit(curves[3:5], given, Choices(), True)
    for symbol in ("VT", "K1", "Ki", "vB"):
        np.testing.assert_array_equal(voxel[symbol][3:5], alone[symbol])
        np.testing.assert_array_equal(voxel.percent_se(symbol)[3:5], alone.percent_se(symbol))


def test_odd_curves_get_a_status():
    clean = frame_averages("1TCM", np.array([[0.15, 0.1, 0.05]]))
    curves = np.vstack([clean, np.full_like(clean, np.nan), np.zeros_like(clean), -clean])
    result = fit_spectrum(curves, ARTERIAL, PLAIN, FRAMES.duration, SpectrumSettings(RATES, 4))
    assert list(result.status) == [Status.OK, Status.NOT_FINITE, Status.NO_SIGNAL, Status.NO_SIGNAL]
    assert np.isnan(result["VT"][1:]).all()


def test_what_makes_no_sense_is_refused():
    curves = frame_averages("1TCM", np.array([[0.15, 0.1, 0.05]]))
    with pytest.raises(InputError, match="a slowest rate above 0, or VT has no end"):
        fit_spectrum(curves, ARTERIAL, PLAIN, FRAMES.duration, SpectrumSettings((0.0, 5.0)))
    with pytest.raises(InputError, match="one weight a frame"):
        fit_spectrum(curves, ARTERIAL, PLAIN, FRAMES.duration[None], SpectrumSettings(RATES))
