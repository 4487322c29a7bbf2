"""Compartment models fitted scan by scan: what learned models have to compete with."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from petkin.fitting import NonlinearSettings, fit_curves
from petkin.hybrid import Dataset
from petkin.inputs import InputFunction, paper_plasma
from petkin.kinetics import compartment_model
from petkin.learning import Population, curve_errors

#: A1 (activity/min) of amount one, see `petkin.learning.population`.
_RISE = 100.0


def fit_errors(
    label: str, population: Population, truth: Dataset, told: Dataset, scans: int, k: int
) -> dict[str, float]:
    """Errors of curves predicted by fits.

    Args:
        label: of the model.
        population: frames and inputs.
        truth, told: true and measured states.
        scans: of every subject that are predicted, the first ones.
        k: fit the mean of the k scans that follow in a circle, under their mean input (the model is linear in its
            input), and predict the scan under its own; 0 fits the scan itself.
    """
    predicted = truth.states[:, :scans].clone()
    for first in range(0, truth.dynamics, population.regions):
        rows = slice(first, first + population.regions)
        for scan in range(scans):
            used = [(scan + shift) % told.series for shift in range(1, k + 1)] or [scan]
            mean = told.states[rows][:, used].mean(dim=1)
            rates = _fit(label, population, mean[:, :, 1], float(mean[0, 0, 3]))
            predicted[rows, scan, :, :2] = _curves(label, population, rates, float(told.states[first, scan, 0, 3]))
    return curve_errors(predicted, truth.states[:, :scans])


def _input(amount: float) -> InputFunction:
    plasma = paper_plasma(_RISE * amount)
    return InputFunction(plasma, plasma)


def _fit(label: str, population: Population, curves: Tensor, amount: float) -> Tensor:
    """Parameters (R, P) of curves (R, K); weights are inverse variances of counting noise where there is noise."""
    model, values = compartment_model(label), curves.double().numpy()
    mean = values.mean(axis=0)
    duration = population.observation.frames.duration
    weights = duration / np.maximum(mean, 0.05 * mean.max()) if population.noise else np.ones_like(mean)
    settings = NonlinearSettings(model, parameters=model.parameters.with_fixed({"vB": 0.0}), standard_errors=False)
    found = fit_curves(values, _input(amount), population.observation, weights / weights.mean(), settings)
    return torch.tensor(np.stack([found[symbol] for symbol in model.parameters.symbols], axis=-1))


def _curves(label: str, population: Population, rates: Tensor, amount: float) -> Tensor:
    """C_T at frame ends, and frame values."""
    model, arterial, seen = compartment_model(label), _input(amount), population.observation
    ends = torch.tensor(seen.frames.end)
    return torch.stack(
        [model.tissue(rates, arterial.plasma, ends), model.frame_values(rates, arterial, seen)], -1
    ).float()
