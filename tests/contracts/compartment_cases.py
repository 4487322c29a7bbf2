"""Inputs, frames and parameters that the contract tests of compartment models share."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from petkin.dynamics import ExponentialSum, PiecewiseLinear
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs.input_function import InputFunction
from petkin.kinetics import MODELS, CompartmentModel

Array = NDArray[np.float64]

EVERY_MODEL = pytest.mark.parametrize("model", MODELS, ids=lambda m: m.label)
C11 = math.log(2.0) / 20.364

# A bolus as Feng et al. (1993) write it, arriving at 0.735 min: (coefficient, exponent in 1/min, power).
TERMS = [(851.1225, -4.133859, 1), (-42.6911, -4.133859, 0), (21.8798, -0.1190996, 0), (20.8113, -0.01043449, 0)]
BOLUS = ExponentialSum(
    torch.tensor([c for c, _, _ in TERMS], dtype=torch.float64),
    torch.tensor([e for _, e, _ in TERMS], dtype=torch.float64),
    tuple(n for _, _, n in TERMS),
    0.735,
)
KNOTS = np.array([0.0, 0.4, 0.9, 1.0, 1.3, 2.0, 3.5, 8.0, 20.0, 45.0, 70.0])
VALUES = np.array([0.0, 0.0, 60.0, 95.0, 41.0, 22.0, 16.0, 11.0, 6.5, 4.0, 2.2])
SAMPLES = PiecewiseLinear(torch.tensor(KNOTS), torch.tensor(VALUES))
BLOOD = PiecewiseLinear(torch.tensor(KNOTS), torch.tensor(0.8 * VALUES))
TIMES = np.array([0.6, 1.0, 1.7, 5.0, 17.0, 45.0, 90.0])
SCHEDULE = FrameSchedule(
    np.array([0.0, 0.5, 1.0, 2.0, 5.0, 20.0, 60.0]), np.array([0.5, 1.0, 2.0, 5.0, 15.0, 60.0, 90.0])
)
ARTERIAL = InputFunction(SAMPLES, BLOOD)


def draw(model: CompartmentModel, count: int, seed: int = 1, *, slowest: float = 1e-3, fastest: float = 3.0) -> Array:
    """Parameters (count, P), rates log-uniform, K1 and vB in their usual ranges."""
    rng = np.random.default_rng(seed)
    rates = np.exp(rng.uniform(np.log(slowest), np.log(fastest), (count, len(model.parameters) - 2)))
    return np.column_stack([rng.uniform(0.01, 1.0, count), rates, rng.uniform(0.0, 0.3, count)])


def nearly_equal(model: CompartmentModel, seed: int = 2) -> Array:
    """All rates the same but for a part in 10^3 ... 10^15, and exactly the same."""
    apart = np.array([1e-3, 1e-6, 1e-9, 1e-12, 1e-15, 0.0])[:, None]
    wiggle = np.random.default_rng(seed).uniform(-1.0, 1.0, (len(apart), len(model.parameters) - 2))
    return np.hstack([np.full_like(apart, 0.2), 0.13 * (1.0 + apart * wiggle), np.full_like(apart, 0.05)])


def at_poles(model: CompartmentModel) -> Array:
    """Every rate at an exponent of the bolus, or a hair from it."""
    rows = [
        [0.2, *[-pole * (1.0 + off)] * (len(model.parameters) - 2), 0.05]
        for pole in (-4.133859, -0.1190996, -0.01043449)
        for off in (0.0, 1e-12, -1e-7)
    ]
    return np.array(rows)


def all_draws(model: CompartmentModel) -> Array:
    return np.vstack([draw(model, 12), nearly_equal(model), at_poles(model)])


def rates_of(model: CompartmentModel, parameters: Array) -> Array:
    """The rate constants of the tissue alone."""
    return parameters[..., : model.rates]


def tissue(model: CompartmentModel, parameters: Array, forcing, times: Array = TIMES) -> Array:
    return model.tissue(torch.tensor(parameters), forcing, torch.tensor(times)).numpy()


def frames(model: CompartmentModel, parameters: Array, arterial: InputFunction, observation: FrameObservation) -> Array:
    return model.frame_values(torch.tensor(parameters), arterial, observation).numpy()
