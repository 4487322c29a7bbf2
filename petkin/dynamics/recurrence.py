"""y_0 = 0, y_{i+1} = f_i y_i + v_i along the last axis: how an exact solution walks from knot to knot."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from petkin.dynamics.arrays import library
from petkin.jit import njit

if TYPE_CHECKING:
    from jaxtyping import Float
    from torch import Tensor


def linear_recurrence(factors: Float[Tensor, "*b n"] | Any, values: Float[Tensor, "*b n"] | Any) -> Any:
    """All n + 1 states of y_{i+1} = f_i y_i + v_i from y_0 = 0, (*b, n + 1); of tensors differentiable.

    Args:
        factors: f_i, |f_i| <= 1 for stability.
        values: v_i, of the same shape.
    """
    if library(factors, values) is not np:
        from petkin.dynamics.on_tensors import recurrence

        return recurrence(factors, values)
    factors, values = np.broadcast_arrays(factors, values)
    n, batch = values.shape[-1], values.shape[:-1]
    rows = int(np.prod(batch))  # no -1: one knot has no steps, n = 0
    return walk(*(np.ascontiguousarray(x.reshape(rows, n)) for x in (factors, values))).reshape(*batch, n + 1)


@njit(nogil=True)
def walk(factors, values):
    """The states (rows, n + 1) of factors and values (rows, n)."""
    rows, n = values.shape
    answer = np.empty((rows, n + 1))
    for row in range(rows):
        state = 0.0
        answer[row, 0] = 0.0
        for i in range(n):
            state = factors[row, i] * state + values[row, i]
            answer[row, i + 1] = state
    return answer


@njit()
def step(a, d):
    """What a step of length d keeps of y, and what it adds per first and last value of a straight input:

    e^{-a d},   int_0^d e^{-a (d - s)} (1 - s / d) ds,   int_0^d e^{-a (d - s)} s / d ds
    """
    x = a * d
    if x < 1e-3:
        first = 0.5 - x / 3.0 + x * x / 8.0 - x * x * x / 30.0
        last = 0.5 - x / 6.0 + x * x / 24.0 - x * x * x / 120.0
        return np.exp(-x), d * first, d * last
    gone = -np.expm1(-x)
    ramp = (x - gone) / (x * x)
    return 1.0 - gone, d * (gone / x - ramp), d * ramp


@njit(nogil=True)
def at_knots(times, values, rates):
    """e^{-a t} * u at the knots of one u of straight pieces, for every rate a (rates, knots)."""
    found = np.zeros((rates.size, times.size))
    for row in range(rates.size):
        for i in range(times.size - 1):
            kept, first, last = step(rates[row], times[i + 1] - times[i])
            found[row, i + 1] = kept * found[row, i] + first * values[i] + last * values[i + 1]
    return found
