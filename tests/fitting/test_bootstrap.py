"""Bootstrap intervals against known distributions; seeds, failures, shared parameters."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.fitting import REGIONS, VOXELS, Estimate, FitResult, NonlinearSettings, Resampling, fit_curves
from petkin.fitting.bootstrap import bootstrap
from petkin.kinetics import ONE_TISSUE, TWO_TISSUE

from .fitting_problems import ARTERIAL, FRAMES, PLAIN, counting_sd, frame_averages, uniform_truth


def silent(done: float) -> None:
    """Tells nobody."""


def problem(label: str, share: float, count: int, model):
    clean = frame_averages(label, uniform_truth(label, count))
    curves = clean + counting_sd(clean, share) * np.random.default_rng(1).standard_normal(clean.shape)
    weights = 1.0 / (counting_sd(clean, share) ** 2).mean(axis=0)

    def refit(made: np.ndarray, voxels: bool) -> FitResult:
        settings = NonlinearSettings(model, effort=VOXELS if voxels else REGIONS, keep_predicted=not voxels)
        return fit_curves(made, ARTERIAL, PLAIN, weights, settings)

    return curves, refit, refit(curves, False)


def test_intervals_of_well_determined_values_are_those_of_the_standard_errors():
    curves, refit, result = problem("1TCM", 0.03, 4, ONE_TISSUE)
    booted = bootstrap(refit, result, curves, Resampling(2000, 3), silent)
    for symbol in ("K1", "k2", "VT"):
        half = 0.5 * (booted.column(f"{symbol}-boothigh") - booted.column(f"{symbol}-bootlow"))
        np.testing.assert_allclose(half, 1.96 * result.percent_se(symbol) * result[symbol] / 100.0, rtol=0.08)
        assert (np.abs(booted.column(f"{symbol}-bias")) < 0.5 * result.percent_se(symbol)).all()
    assert (booted.column("bootfailed") == 0).all()
    assert booted.settings["bootstrap"] == 2000
    assert booted.estimates == result.estimates


def test_a_seed_gives_the_same_numbers_whatever_the_neighbours():
    curves, refit, result = problem("2TCM", 0.03, 3, TWO_TISSUE)
    first = bootstrap(refit, result, curves, Resampling(120, 1), silent)
    again = bootstrap(refit, result, curves, Resampling(120, 1), silent)
    other = bootstrap(refit, result, curves, Resampling(120, 2), silent)
    alone = bootstrap(refit, refit(curves[:1], False), curves[:1], Resampling(120, 1), silent)
    for symbol in ("K1-bootlow", "VT-boothigh", "k3-bias"):
        np.testing.assert_array_equal(first.column(symbol), again.column(symbol))
        assert first.column(symbol)[0] == alone.column(symbol)[0]
        assert (first.column(symbol) != other.column(symbol)).all()


def test_five_hundred_resamples_of_a_hundred_regions_take_seconds():
    curves, refit, result = problem("2TCM", 0.03, 100, TWO_TISSUE)
    refit(curves, True)  # compile
    told: list[float] = []
    before = time.process_time()
    bootstrap(refit, result, curves, Resampling(500), told.append)
    assert time.process_time() - before < 10.0
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_curves_without_a_fit_and_frames_without_weight_pass():
    curves, refit, result = problem("1TCM", 0.03, 3, ONE_TISSUE)
    curves[1] = 0.0
    result = refit(curves, False)
    booted = bootstrap(refit, result, curves, Resampling(100), silent)
    assert np.isnan(booted.column("K1-bootlow")[1])
    assert np.isfinite(booted.column("K1-bootlow")[[0, 2]]).all()
    weights = np.asarray(result.weights).copy()
    weights[3] = 0.0

    def lighter(made: np.ndarray, voxels: bool) -> FitResult:
        assert (made.reshape(-1, len(FRAMES))[:, 3] == 7.0).all()  # nothing is made up for a frame that does not count
        return fit_curves(made, ARTERIAL, PLAIN, weights, NonlinearSettings(ONE_TISSUE))

    curves[:, 3] = 7.0
    booted = bootstrap(lighter, lighter(curves, False), curves, Resampling(100), silent)
    assert np.isfinite(booted.column("K1-bootlow")[0])


def test_failed_resamples_are_counted_and_left_out():
    curves, refit, result = problem("1TCM", 0.03, 2, ONE_TISSUE)

    def failing(made: np.ndarray, voxels: bool) -> FitResult:
        made = made.copy()
        made[::4] = np.nan
        return refit(made, voxels)

    booted = bootstrap(failing, result, curves, Resampling(200), silent)
    assert list(booted.column("bootfailed")) == [25.0, 25.0]
    assert np.isfinite(booted.column("VT-boothigh")).all()
    assert "bootstrap of 200 resamples" in booted.remarks[-1]


def test_what_all_curves_share_is_refitted_for_all_at_once():
    """Each set of resampled curves is handed over whole, in its order, as regions."""
    seen = []

    def refit(made: np.ndarray, voxels: bool) -> FitResult:
        seen.append((made.shape, voxels))
        mean = made.mean(axis=1)
        return replace(result, estimates=(Estimate("VT", "1", mean, mean * 0.0),))

    values = np.full((3, 10), 5.0)
    result = FitResult(
        "shared",
        (Estimate("VT", "1", np.full(3, 5.0), np.zeros(3)),),
        np.ones(3),
        np.zeros(3),
        np.zeros(3, np.uint8),
        np.ones(10),
        predicted=values,
        shared={"k2'": (0.1, 5.0)},
    )
    booted = bootstrap(refit, result, values, Resampling(400), silent)
    assert set(seen) == {((3, 10), False)}
    assert len(seen) == 400
    half = 0.5 * (booted.column("VT-boothigh") - booted.column("VT-bootlow"))
    np.testing.assert_allclose(half, 1.96 / np.sqrt(10), rtol=0.15)


def test_a_method_that_predicts_only_late_frames_is_left_alone():
    curves, refit, result = problem("1TCM", 0.03, 2, ONE_TISSUE)
    partial = np.array(result.predicted)
    partial[:, :5] = np.nan
    left = bootstrap(refit, replace(result, predicted=partial), curves, Resampling(100), silent)
    assert "no bootstrap" in left.remarks[-1]
    assert left.columns == result.columns


def test_too_few_resamples_are_refused():
    with pytest.raises(InputError, match="--bootstrap is 50; percentile intervals need at least 100"):
        Resampling(50)
    with pytest.raises(InputError, match="--seed is -1"):
        Resampling(100, -1)
