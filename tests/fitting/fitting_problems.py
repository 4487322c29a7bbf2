"""Curves with known truth for the tests of fitting, made without petkin: input, solution and frame averages its own."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray

from petkin.dynamics import ExponentialSum
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs.input_function import InputFunction
from petkin.kinetics import compartment_model

Array = NDArray[np.float64]

C11, F18 = math.log(2.0) / 20.364, math.log(2.0) / 109.77

#: Feng D et al. Int J Biomed Comput 1993;32:95-110: (coefficient, exponent in 1/min, power), from the arrival on.
FENG = [(851.1225, -4.133859, 1), (-42.6911, -4.133859, 0), (21.8798, -0.1190996, 0), (20.8113, -0.01043449, 0)]
ARRIVAL = 0.735
DURATIONS_S = [10] * 12 + [20] * 6 + [30] * 6 + [60] * 3 + [120] * 5 + [300] * 14
EDGES = np.concatenate([[0.0], np.cumsum(DURATIONS_S)]) / 60.0
FRAMES = FrameSchedule(EDGES[:-1], EDGES[1:])
PLAIN = FrameObservation(FRAMES)


def bolus(arrival: float = ARRIVAL) -> ExponentialSum:
    """The input as petkin knows it, for plasma and whole blood alike."""
    coefficients, exponents = (torch.tensor([term[i] for term in FENG], dtype=torch.float64) for i in (0, 1))
    return ExponentialSum(coefficients, exponents, tuple(n for _, _, n in FENG), arrival)


ARTERIAL = InputFunction(bolus(), bolus())


def frame_averages(label: str, parameters: Array, *, arrival: float = ARRIVAL, edges: Array = EDGES) -> Array:
    """Time averages between edges of (1 - vB) C_T + vB C_P, (N, K), by text-book formulas.

    Each exponential against each term of the input has the closed form of a first course: e^{-a s} * e^{-l s} =
    (e^{-l s} - e^{-a s}) / (a - l), integrated once more; rates at a pole would divide by zero and are not asked for.
    """
    K1, vB = parameters[:, 0], parameters[:, -1]
    if label == "1TCM":
        pairs = [(K1, parameters[:, 1])]
    elif label == "2TCM3k":
        k2, k3 = parameters[:, 1], parameters[:, 2]
        pairs = [(K1 * k2 / (k2 + k3), k2 + k3), (K1 * k3 / (k2 + k3), 0.0 * k2)]
    else:
        k2, k3, k4 = parameters[:, 1:4].T
        root = np.sqrt((k2 + k3 + k4) ** 2 - 4 * k2 * k4)
        a1, a2 = 0.5 * (k2 + k3 + k4 + root), 0.5 * (k2 + k3 + k4 - root)
        pairs = [(K1 * (a1 - k3 - k4) / root, a1), (K1 * (k3 + k4 - a2) / root, a2)]
    curves = vB[:, None] * blood_averages(arrival, edges)
    for phi, a in pairs:
        curves = curves + ((1 - vB) * phi)[:, None] * basis_averages(a, arrival, edges)
    return curves


def blood_averages(arrival: float = ARRIVAL, edges: Array = EDGES) -> Array:
    """Time averages of C_P between edges, (K,)."""
    s = np.maximum(edges - arrival, 0.0)
    return np.diff(sum(c * _power_area(n, -e, s) for c, e, n in FENG)) / np.diff(edges)


def basis_averages(rates: Array, arrival: float = ARRIVAL, edges: Array = EDGES) -> Array:
    """Time averages of e^{-a t} * C_P between edges, (rates, K)."""
    s = np.maximum(edges - arrival, 0.0)
    area = sum(c * _response_area(n, -e, np.asarray(rates)[:, None], s) for c, e, n in FENG)
    return np.diff(area, axis=1) / np.diff(edges)


def _power_area(n: int, rate: float, s: Array) -> Array:
    """int_0^s x^n e^{-rate x} dx, n = 0 or 1."""
    if n == 0:
        return -np.expm1(-rate * s) / rate
    return (1.0 - (1.0 + rate * s) * np.exp(-rate * s)) / rate**2


def _response_area(n: int, rate: float, a: Array, s: Array) -> Array:
    """int_0^s of (e^{-a x} * x^n e^{-rate x}), n = 0 or 1, a != rate."""
    slow = np.where(a > 0, -np.expm1(-a * s) / np.where(a > 0, a, 1.0), s)
    if n == 0:
        return (_power_area(0, rate, s) - slow) / (a - rate)
    return (_power_area(1, rate, s) - (_power_area(0, rate, s) - slow) / (a - rate)) / (a - rate)


def uniform_truth(label: str, count: int, seed: int = 20261121) -> Array:
    """Parameters drawn as the common benchmark draws them."""
    ranges = {
        "1TCM": [(0.05, 0.5), (0.05, 0.3), (0.02, 0.08)],
        "2TCM": [(0.05, 0.3), (0.05, 0.25), (0.02, 0.12), (0.01, 0.06), (0.02, 0.08)],
        "2TCM3k": [(0.05, 0.15), (0.1, 0.3), (0.02, 0.08), (0.02, 0.08)],
    }[label]
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(low, high, count) for low, high in ranges], axis=1)


def counting_sd(curves: Array, share: float, half_life_rate: float = C11) -> Array:
    """sd ~ sqrt(C e^{lam t} / duration), `share` of C on average after 10 min, and a little in empty frames."""
    level = np.maximum(curves, 0.01 * curves.max(axis=1, keepdims=True))
    sd = np.sqrt(level * np.exp(half_life_rate * FRAMES.mid) / FRAMES.duration)
    late = FRAMES.mid > 10.0
    return sd * share / (sd / level)[:, late].mean(axis=1, keepdims=True)


def macro(label: str, symbol: str, parameters: Array) -> Array:
    """A macro-parameter by its definition."""
    p = dict(zip(compartment_model(label).parameters.symbols, parameters.T))
    if symbol == "Ki":
        return p["K1"] * p["k3"] / (p["k2"] + p["k3"])
    if label == "1TCM":
        return p["K1"] / p["k2"]
    return p["K1"] / p["k2"] * (1 + p["k3"] / p["k4"])
