"""Bounded least squares from many starts, for the small curves that describe blood data."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.levenberg_marquardt import polish

#: Starts that are polished, out of the grid; imaginary step that slopes are read from (Squire & Trapp 1998,
#: doi:10.1137/S003614459631241X); a fit ends where a step is expected to gain less than this share of the squares.
_POLISHED, _STEP, _TOLERANCE = 4, 1e-100, 1e-12

Curve = Callable[[NDArray[np.float64], NDArray[Any]], NDArray[Any]]


@dataclass(frozen=True)
class CurveFit:
    """Best parameters of a curve, their standard errors (nan where the data do not determine one), rss and AICc."""

    parameters: NDArray[np.float64]
    standard_errors: NDArray[np.float64]
    rss: float
    aicc: float


def aicc(rss: float, samples: int, parameters: int) -> float:
    """Akaike's criterion with the small-sample term, n ln(rss/n) + 2k + 2k(k+1)/(n-k-1), k counting the variance too.

    Infinite where there are too few samples for the model. Below 1e-12 a sample, rss counts as rounding.

    Reference: Hurvich CM, Tsai CL. Biometrika 1989;76:297-307. doi:10.1093/biomet/76.2.297
    """
    k = parameters + 1
    if samples - k - 1 <= 0:
        return math.inf
    return samples * math.log(max(rss / samples, 1e-12)) + 2 * k + 2 * k * (k + 1) / (samples - k - 1)


def fit_curve(
    curve: Curve,
    times: NDArray[np.float64],
    values: NDArray[np.float64],
    *,
    bounds: Sequence[tuple[float, float]],
    starts: Sequence[Sequence[float]],
) -> CurveFit:
    """Least squares of curve(times, parameters) - values within bounds: a grid of starts, the best few of it polished.

    Args:
        curve: analytic function of times (samples,) and parameters (parameters,), or of many at once (parameters, n,
            1), which may be complex.
        times: (samples,).
        values: (samples,).
        bounds: lower and upper bound of each parameter.
        starts: values to try for each parameter; their product is the grid.

    Returns:
        The best of the polished fits.
    """
    lower, upper = (np.array(side, dtype=float) for side in zip(*bounds, strict=True))

    def values_of(p: NDArray[np.float64], _: NDArray[np.intp]) -> NDArray[np.float64]:
        return np.broadcast_to(curve(times, p.T[:, :, None]), (len(p), times.size))

    def jacobian_of(p: NDArray[np.float64], _: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        moved = p[:, :, None] + 1j * _STEP * np.eye(p.shape[1])
        there = curve(times, moved.transpose(1, 0, 2)[..., None])
        return np.real(there[:, 0]), np.moveaxis(np.imag(there) / _STEP, 1, 2)

    grid = np.clip(np.array(list(itertools.product(*starts))), lower, upper)
    every = np.arange(len(grid))
    off = np.square(values_of(grid, every) - values).sum(axis=1)
    first = grid[np.argsort(off, kind="stable")[:_POLISHED]]
    given, sizes = np.tile(values[:, None], len(first)), np.full(len(first), values @ values)
    found, costs, _ = polish(values_of, jacobian_of, given, sizes, first, lower, upper, _TOLERANCE)
    best = found[[int(costs.argmin())]]
    at, jacobian = jacobian_of(best, every[:1])
    rss = float(np.square(at[0] - values).sum())
    on_bound = (best[0] <= lower) | (best[0] >= upper)
    errors = _standard_errors(jacobian[0], rss, on_bound)
    return CurveFit(best[0], errors, rss, aicc(rss, times.size, lower.size))


def _standard_errors(jacobian: NDArray[np.float64], rss: float, on_bound: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Linearised standard errors of the parameters that rest on no bound."""
    errors = np.full(on_bound.size, np.nan)
    free = ~on_bound
    degrees = jacobian.shape[0] - int(free.sum())
    if degrees <= 0 or not free.any():
        return errors
    information = jacobian[:, free].T @ jacobian[:, free]
    if np.linalg.cond(information) > 1e14:
        return errors
    errors[free] = np.sqrt(np.diag(np.linalg.inv(information)) * rss / degrees)
    return errors
