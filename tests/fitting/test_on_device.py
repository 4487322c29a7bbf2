"""The search as tensor operations against the compiled one: 2,000 voxels a model, at the effort of images."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from petkin.errors import InputError
from petkin.fitting import VOXELS, FitResult, NonlinearSettings, Status, find_device, fit_curves
from petkin.fitting import on_device as module
from petkin.kinetics import MODELS
from petkin_bench.problems import fit_problem

LABELS = ("1TCM", "2TCM3k", "2TCM")
NO_GPU = "torch sees no CUDA device here"
MODEL = pytest.mark.parametrize("label", LABELS)
DEVICE = pytest.mark.parametrize(
    "device", ["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason=NO_GPU))]
)


@cache
def fitted(
    label: str, device: str | None, voxels: int = 2000, percent: float = 5.0, fixed: float | None = None
) -> FitResult:
    problem = fit_problem(voxels=2000, model=label, percent=percent)
    model = next(model for model in MODELS if model.label == label)
    box = model.parameters if fixed is None else model.parameters.with_fixed({"vB": fixed})
    settings = NonlinearSettings(model, parameters=box, effort=VOXELS, keep_predicted=False, device=device)
    return fit_curves(problem.curves[:voxels], problem.arterial, problem.observation, problem.weights, settings)


def well_determined(result: FitResult) -> np.ndarray:
    """Estimates with a standard error below 10 % (E, N)."""
    return np.stack([(e.percent_se < 10.0) & (e.percent_se > 0.0) for e in result.estimates])


def values(result: FitResult) -> np.ndarray:
    return np.stack([e.value for e in result.estimates])


@DEVICE
@MODEL
@pytest.mark.parametrize("percent", [5.0, 15.0])
def test_costs_are_those_of_the_compiled_search(label: str, device: str, percent: float) -> None:
    compiled, found = fitted(label, None, percent=percent), fitted(label, device, percent=percent)
    assert (np.abs(found.chi2 / compiled.chi2 - 1.0) < 1e-4).mean() >= 0.99
    assert (found.status == compiled.status).mean() >= 0.99
    assert not (found.status == Status.NOT_CONVERGED).any()


@DEVICE
@MODEL
def test_well_determined_values_are_those_of_the_compiled_search(label: str, device: str) -> None:
    compiled, found = fitted(label, None), fitted(label, device)
    told = well_determined(compiled)
    assert told.sum() > 300
    assert (np.abs(values(found)[told] / values(compiled)[told] - 1.0) < 1e-4).mean() >= 0.99


@DEVICE
@MODEL
def test_fixed_blood_volume(label: str, device: str) -> None:
    compiled, found = fitted(label, None, fixed=0.05), fitted(label, device, fixed=0.05)
    assert (np.abs(found.chi2 / compiled.chi2 - 1.0) < 1e-4).mean() >= 0.99


@DEVICE
@MODEL
def test_the_same_bytes_twice(label: str, device: str) -> None:
    first = fitted(label, device)
    fitted.cache_clear()
    assert values(fitted(label, device)).tobytes() == values(first).tobytes()


def test_chunks_change_no_more_than_rounding(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = fitted("2TCM", "cpu")
    monkeypatch.setattr(module, "CHUNK", 300)
    problem = fit_problem(voxels=2000, model="2TCM")
    settings = NonlinearSettings(
        next(m for m in MODELS if m.label == "2TCM"), effort=VOXELS, keep_predicted=False, device="cpu"
    )
    parts = fit_curves(problem.curves, problem.arterial, problem.observation, problem.weights, settings)
    assert (np.abs(parts.chi2 / whole.chi2 - 1.0) < 1e-9).mean() >= 0.998


def test_curves_without_signal_keep_their_status() -> None:
    problem = fit_problem(voxels=2000, model="2TCM")
    curves = problem.curves[:4].copy()
    curves[0], curves[1], curves[2, 3] = 0.0, -curves[1], np.nan
    settings = NonlinearSettings(next(m for m in MODELS if m.label == "2TCM"), effort=VOXELS)
    both = [
        fit_curves(curves, problem.arterial, problem.observation, problem.weights, chosen)
        for chosen in (settings, replace(settings, device="cpu"))
    ]
    np.testing.assert_array_equal(both[1].status, both[0].status)
    assert list(both[1].status[:3]) == [Status.NO_SIGNAL, Status.NO_SIGNAL, Status.NOT_FINITE]


@pytest.mark.parametrize("name", ["nonsense", "cuda:99", "meta"])
def test_a_device_that_is_not_there_is_named(name: str) -> None:
    with pytest.raises(InputError, match=f"--device {name}: torch sees no such device"):
        find_device(name)
