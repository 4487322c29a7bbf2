"""Inputs and an independent quadrature for the tests of this room."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numba
import numpy as np
import pytest
import torch

from petkin.dynamics import ExponentialSum, Forcing, PiecewiseLinear, Shifted

NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)

#: A bolus with a jump, a flat stretch and a second jump; what a sampled curve with all its kinks looks like.
KNOTS = [0.0, 0.4, 0.7, 0.7, 1.5, 4.0, 9.0, 9.0, 25.0, 60.0]
LEVELS = [0.0, 3.0, 90.0, 40.0, 22.0, 12.0, 9.0, 14.0, 6.0, 2.0]

#: A fast rise and three decays (Feng 1993, after division by 10), in time since the onset.
COEFFICIENTS = [85.11, -4.2, 2.2, 2.0]
EXPONENTS = [-4.1339, -4.1339, -0.1191, -0.0104]
POWERS = (1, 0, 0, 0)
ONSET = 0.45

INPUTS = ("straight lines", "exponentials", "late", "early")


@pytest.fixture(scope="session", autouse=True)
def one_compiled_thread() -> None:
    """Threads that wait for each other over a handful of numbers cost minutes on a busy machine."""
    numba.set_num_threads(1)


def straight_lines(t: np.ndarray, side: str = "right") -> np.ndarray:
    at = np.clip(np.searchsorted(KNOTS, t, side=side) - 1, 0, len(KNOTS) - 2)
    left, right = np.asarray(KNOTS)[at], np.asarray(KNOTS)[at + 1]
    share = np.clip((t - left) / (right - left), 0.0, 1.0)
    values = np.asarray(LEVELS)[at] * (1 - share) + np.asarray(LEVELS)[at + 1] * share
    return np.where(t < KNOTS[0], 0.0, values)


def exponentials(t: np.ndarray) -> np.ndarray:
    s = t - ONSET
    terms = zip(COEFFICIENTS, EXPONENTS, POWERS)
    return np.where(s >= 0, sum(c * np.maximum(s, 0) ** n * np.exp(e * np.maximum(s, 0)) for c, e, n in terms), 0.0)


def forcing_named(name: str) -> tuple[Forcing, Callable[[np.ndarray], np.ndarray], list[float]]:
    """A forcing, the same function in numpy, and its kinks."""

    def double(values: list[float]) -> torch.Tensor:
        return torch.tensor(values, dtype=torch.float64)

    lines = PiecewiseLinear(double(KNOTS), double(LEVELS))
    bolus = ExponentialSum(double(COEFFICIENTS), double(EXPONENTS), POWERS, onset=ONSET)
    if name == "straight lines":
        return lines, straight_lines, KNOTS
    if name == "exponentials":
        return bolus, exponentials, [ONSET]
    if name == "late":
        return Shifted(lines, 2.3), lambda t: straight_lines(t - 2.3), [k + 2.3 for k in KNOTS]
    return Shifted(bolus, -0.3), lambda t: exponentials(t + 0.3), [ONSET - 0.3]


@pytest.fixture(params=INPUTS)
def known_input(request: pytest.FixtureRequest) -> tuple[Forcing, Callable[[np.ndarray], np.ndarray], list[float]]:
    return forcing_named(request.param)


def integrate(curve: Callable[[np.ndarray], np.ndarray], end: float, kinks: list[float], longest: float = 1.0) -> float:
    """Gauss-Legendre from 0, piece by piece between the kinks."""
    edges = np.unique([0.0, end, *[k for k in kinks if 0 < k < end]])
    total = 0.0
    for low, high in pairwise(edges):
        for a, b in pairwise(np.linspace(low, high, 1 + int(np.ceil((high - low) / longest)))):
            total += 0.5 * (b - a) * float(np.sum(WEIGHTS * curve(0.5 * (a + b) + 0.5 * (b - a) * NODES)))
    return total
