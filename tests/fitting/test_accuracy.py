"""Does the fit find the truth: the common benchmark, and a twin of it that needs no outside data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from petkin.fitting import REGIONS, VOXELS, NonlinearSettings, Status, counting_weights, fit_curves
from petkin.kinetics import compartment_model

from .fitting_problems import ARTERIAL, C11, FRAMES, PLAIN, counting_sd, frame_averages, macro, uniform_truth

SETS = {"2TCM": ("rev2tcm", "VT"), "2TCM3k": ("irr2tcm", "Ki"), "1TCM": ("1tcm", "VT")}
EFFORTS = pytest.mark.parametrize("effort", [REGIONS, VOXELS], ids=["regions", "voxels"])
EVERY_SET = pytest.mark.parametrize("label", SETS)

#: Best peer on the noisy two-tissue curves (median error of VT, percent); a clean fit on any set.
BEST_PEER_NOISY_VT = 4.2
CLEAN_MEDIAN, CLEAN_90 = 0.005, 0.02


def fit(label: str, curves: np.ndarray, weights: np.ndarray, effort=REGIONS):
    return fit_curves(curves, ARTERIAL, PLAIN, weights, NonlinearSettings(compartment_model(label), effort=effort))


def percent_error(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return 100.0 * np.abs(found / truth - 1.0)


def bench(folder: Path, name: str, what: str) -> np.ndarray:
    return np.loadtxt(folder / "bench" / f"{name}_{what}.tsv", skiprows=1 if what == "true" else 0)


def assert_recovered(result, columns: list[str], truth: np.ndarray) -> None:
    assert (result.status == Status.OK).all()
    for symbol, values in zip(columns, truth.T):
        error = percent_error(result[symbol], values)
        assert np.median(error) <= CLEAN_MEDIAN, symbol
        assert np.percentile(error, 90) <= CLEAN_90, symbol


@EFFORTS
@EVERY_SET
def test_noise_free_benchmark_is_recovered(shared_data, label, effort):
    name, _ = SETS[label]
    columns = (shared_data / "bench" / f"{name}_true.tsv").read_text().split("\n")[0].split("\t")
    result = fit(label, bench(shared_data, name, "clean"), FRAMES.duration, effort)
    assert_recovered(result, columns, bench(shared_data, name, "true"))


@EFFORTS
@EVERY_SET
def test_noise_free_twin_is_recovered(label, effort):
    truth = uniform_truth(label, 200)
    outcome = SETS[label][1]
    columns = [*compartment_model(label).parameters.symbols, outcome]
    result = fit(label, frame_averages(label, truth), FRAMES.duration, effort)
    assert_recovered(result, columns, np.column_stack([truth, macro(label, outcome, truth)]))


def test_the_twin_and_the_benchmark_agree(shared_data):
    for label, (name, _) in SETS.items():
        truth, clean = bench(shared_data, name, "true")[:20, :-1], bench(shared_data, name, "clean")[:20]
        np.testing.assert_allclose(frame_averages(label, truth), clean, rtol=2e-4, atol=2e-3)


@EFFORTS
@pytest.mark.parametrize(("label", "bar"), [("2TCM", BEST_PEER_NOISY_VT), ("2TCM3k", 1.9), ("1TCM", 0.75)])
def test_noisy_benchmark_with_default_weights(shared_data, label, bar, effort):
    """No curve may fail, though a third of the early frames are negative; no worse than the best peer."""
    name, outcome = SETS[label]
    noisy = bench(shared_data, name, "noisy")
    assert (noisy < 0).sum() > 500
    result = fit(label, noisy, counting_weights(noisy.mean(axis=0), FRAMES, C11), effort)
    error = percent_error(result[outcome], bench(shared_data, name, "true")[:, -1])
    assert np.median(np.where(np.isfinite(error), error, np.inf)) <= bar
    assert np.isin(result.status, (Status.OK, Status.AT_BOUND, Status.NOT_IDENTIFIABLE)).all()


def test_noisy_benchmark_with_every_curve_s_own_weights(shared_data):
    """True variances of each curve: 4.3 % here, no better than the shared default (4.1 %); K1 gains a little."""
    sd = bench(shared_data, "rev2tcm", "sd")
    own = 1.0 / np.maximum(sd, 1e-2 * sd.max(axis=1, keepdims=True)) ** 2
    result = fit("2TCM", bench(shared_data, "rev2tcm", "noisy"), own)
    truth = bench(shared_data, "rev2tcm", "true")
    assert np.median(percent_error(result["VT"], truth[:, -1])) <= 4.4
    assert np.median(percent_error(result["K1"], truth[:, 0])) <= 5.5


@EFFORTS
@EVERY_SET
def test_noisy_twin_does_not_fail(label, effort):
    truth = uniform_truth(label, 100)
    clean = frame_averages(label, truth)
    noisy = clean + counting_sd(clean, 0.05) * np.random.default_rng(3).standard_normal(clean.shape)
    assert (noisy < 0).any()
    result = fit(label, noisy, counting_weights(noisy.mean(axis=0), FRAMES, C11), effort)
    outcome = SETS[label][1]
    error = percent_error(result[outcome], macro(label, outcome, truth))
    assert np.median(error) <= {"2TCM": 6.0, "2TCM3k": 2.5, "1TCM": 1.0}[label]
