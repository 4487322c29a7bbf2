"""Compartment models solved without petkin's formulas: only a model's differential equation is asked for.

All take the linear system dx/dt = A x + b u(t), x = 0 before the input, and return sum(x).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from petkin.kinetics import CompartmentModel

Array = NDArray[np.float64]


def linear_form(model: CompartmentModel, rates: Array) -> tuple[Array, Array]:
    """A and b of one model, read off its field at unit states and at a unit plasma."""
    d = len(model.states)
    k = torch.tensor(rates)

    def field(state: Array, plasma: float) -> Array:
        return model.field(torch.tensor(state), torch.tensor(plasma, dtype=torch.float64), k).numpy()

    A = np.stack([field(unit, 0.0) for unit in np.eye(d)], axis=1)
    return A, field(np.zeros(d), 1.0)


def by_ode(A: Array, b: Array, plasma: Callable[[float], float], knots: Array, times: Array) -> Array:
    """Runge-Kutta of order 8 with tolerance 1e-13 between the knots of the input."""
    state, before, found = np.zeros(len(b)), float(knots[0]), {}
    for stop in np.unique(np.concatenate([knots, times])):
        if stop > before:
            inside = np.nextafter(before, stop), np.nextafter(stop, before)
            slope = lambda t, x: A @ x + b * plasma(t)  # noqa: E731
            state = solve_ivp(slope, inside, state, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
            before = stop
        found[stop] = state.sum()
    return np.array([found[t] for t in times])


def by_matrix_exponential(A: Array, b: Array, knots: Array, values: Array, times: Array) -> Array:
    """Input linear between knots: the state beside (u, u') is one linear system; one exponential an interval."""
    d = len(b)
    M = np.zeros((d + 2, d + 2))
    M[:d, :d], M[:d, d], M[d, d + 1] = A, b, 1.0
    state, before, found = np.zeros(d), float(knots[0]), {}
    for stop in np.unique(np.concatenate([knots, times])):
        if stop > before:
            u = _level_and_slope(knots, values, 0.5 * (before + stop), before)
            state = (expm(M * (stop - before)) @ np.concatenate([state, u]))[:d]
            before = stop
        found[stop] = state.sum()
    return np.array([found[t] for t in times])


def by_modes(A: Array, b: Array, terms: list[tuple[float, float, int]], onset: float, times: Array) -> Array:
    """Input sum of c s^n e^{l s} (n = 0 or 1), s = t - onset: each term is a mode of one larger linear system."""
    d = len(b)
    size = d + sum(n + 1 for _, _, n in terms)
    M, start = np.zeros((size, size)), np.zeros(size)
    M[:d, :d] = A
    at = d
    for c, rate, n in terms:
        M[:d, at] = b * c
        for i in range(n + 1):
            M[at + i, at + i] = rate
        if n:
            M[at, at + 1] = 1.0
        start[at + n] = 1.0
        at += n + 1
    return np.array([(expm(M * max(t - onset, 0.0)) @ start)[:d].sum() for t in times])


def by_recursion(phi: Array, a: Array, knots: Array, values: Array, times: Array, decay: float) -> tuple[Array, Array]:
    """Input linear between knots, response sum_i phi_i e^{-a_i t}; y <- y e^{-x} + p D psi1 + m D^2 psi2 an interval.

    Returns:
        The curve and int_0^t e^{-decay s} of it: (a + decay) int e^{-decay s} y = int e^{-decay s} u - e^{-decay t} y.
    """
    curve, area = np.zeros(len(times)), np.zeros(len(times))
    for amplitude, rate in zip(phi, a):
        y, supplied, before, found = 0.0, 0.0, float(knots[0]), {}
        for stop in np.unique(np.concatenate([knots, times])):
            if stop > before:
                p, m = _level_and_slope(knots, values, 0.5 * (before + stop), before)
                span = stop - before
                supplied += math.exp(-decay * before) * _step(0.0, p + m * span, -m, decay, span)
                y = _step(y, p, m, rate, span)
                before = stop
            found[stop] = (y, (supplied - math.exp(-decay * stop) * y) / (rate + decay))
        curve += amplitude * np.array([found[t][0] for t in times])
        area += amplitude * np.array([found[t][1] for t in times])
    return curve, area


def _step(y: float, p: float, m: float, rate: float, span: float) -> float:
    psi1, psi2 = _psi(rate * span)
    return y * math.exp(-rate * span) + p * span * psi1 + m * span**2 * psi2


def _psi(x: float) -> tuple[float, float]:
    """(1 - e^-x)/x and (1 - psi1)/x, by their series where they cancel."""
    if abs(x) < 0.3:
        terms = [(-x) ** n for n in range(20)]
        return (
            math.fsum(v / math.factorial(n + 1) for n, v in enumerate(terms)),
            math.fsum(v / math.factorial(n + 2) for n, v in enumerate(terms)),
        )
    psi1 = -math.expm1(-x) / x
    return psi1, (1.0 - psi1) / x


def _level_and_slope(knots: Array, values: Array, inside: float, at: float) -> tuple[float, float]:
    """u(at) seen from the interval that holds `inside`, and its slope there; held after the last knot."""
    i = int(np.searchsorted(knots, inside, side="right")) - 1
    if i + 1 >= len(knots):
        return float(values[-1]), 0.0
    slope = (values[i + 1] - values[i]) / (knots[i + 1] - knots[i])
    return float(values[i] + slope * (at - knots[i])), float(slope)
