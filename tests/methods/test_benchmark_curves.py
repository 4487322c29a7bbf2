"""The common benchmark's curves: how far linear methods are off without noise, and that none fails with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from petkin.fitting import Choices, FitResult, Given, Status, counting_weights
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.methods import find_method

from ..fitting.fitting_problems import ARTERIAL, C11


@pytest.fixture(scope="module")
def bench(shared_data) -> Path:
    return shared_data / "bench"


def fit(bench: Path, label: str, curves: str, fixed: dict[str, float]) -> tuple[FitResult, dict[str, np.ndarray]]:
    """A method on a file of curves, and the truth behind them."""
    values = np.loadtxt(bench / f"{curves}.tsv")
    edges = np.loadtxt(bench / "frames.tsv", skiprows=1)
    frames = FrameSchedule(edges[:, 0], edges[:, 1])
    given = Given(FrameObservation(frames), counting_weights(values.mean(axis=0), frames, C11), ARTERIAL)
    table = bench / f"{curves.split('_')[0]}_true.tsv"
    truth = dict(zip(table.read_text().split("\n", 1)[0].split("\t"), np.loadtxt(table, skiprows=1).T))
    return find_method(label).fit(values, given, Choices(fixed=fixed), True), truth


@pytest.mark.parametrize(
    ("curves", "symbol", "middle", "most"),
    [
        ("rev2tcm", "VT", 0.002, 0.005),
        ("rev2tcm", "K1", 0.006, 0.03),
        ("rev2tcm", "vB", 0.05, 0.08),
        ("1tcm", "VT", 0.001, 0.003),
        ("1tcm", "K1", 0.002, 0.005),
    ],
)
def test_the_linear_two_tissue_model_finds_what_made_the_curves(bench, curves, symbol, middle, most):
    """Absolute errors in percent: the median, and nine in ten below."""
    result, truth = fit(bench, "LS2TCM", f"{curves}_clean", {})
    error = 100.0 * np.abs(result[symbol] / truth[symbol] - 1.0)
    assert np.median(error) < middle
    assert np.quantile(error, 0.9) < most


@pytest.mark.parametrize(
    ("label", "curves", "symbol", "vB", "bias"),
    [
        ("Logan", "rev2tcm", "VT", 0.0, (-8.4, -8.0)),
        ("Logan", "rev2tcm", "VT", 0.05, (-4.7, -4.4)),
        ("MA1", "rev2tcm", "VT", 0.0, (-8.4, -8.0)),
        ("MA1", "rev2tcm", "VT", 0.05, (-4.7, -4.4)),
        ("Logan", "1tcm", "VT", 0.05, (-0.1, 0.1)),
        ("MA2", "rev2tcm", "VT", 0.05, (-0.1, 0.1)),
        ("Patlak", "irr2tcm", "Ki", 0.0, (-5.7, -5.4)),
        ("Patlak", "irr2tcm", "Ki", 0.05, (-0.7, -0.5)),
    ],
)
def test_bias_without_noise(bench, label, curves, symbol, vB, bias):
    """Median errors in percent, t* = 30 min; vB between 0.02 and 0.08, so that 0.05 takes off the mean blood."""
    result, truth = fit(bench, label, f"{curves}_clean", {"vB": vB})
    low, high = bias
    assert low < np.median(100.0 * (result[symbol] / truth[symbol] - 1.0)) < high


@pytest.mark.parametrize(
    ("label", "curves"),
    [("Patlak", "irr2tcm"), ("Logan", "rev2tcm"), ("MA1", "rev2tcm"), ("MA2", "rev2tcm"), ("LS2TCM", "rev2tcm")],
)
def test_no_noisy_curve_fails(bench, label, curves):
    result, _ = fit(bench, label, f"{curves}_noisy", {"vB": 0.05})
    assert np.isin(result.status, (Status.OK, Status.NOT_IDENTIFIABLE)).all()
    assert np.isfinite(result[find_method(label).outcome]).all()
