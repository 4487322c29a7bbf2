"""Bounded least squares from many starts, for the small curves that describe blood data."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Starts that are polished, out of the grid; step of difference quotients, as a share of the parameter, or of 1 where
#: that is more.
_POLISHED, _STEP = 4, float(np.sqrt(np.finfo(float).eps))

Curve = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


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
        curve: function of times (samples,) and parameters (parameters,), or of many at once (parameters, n, 1).
        times: (samples,).
        values: (samples,).
        bounds: lower and upper bound of each parameter.
        starts: values to try for each parameter; their product is the grid.

    Returns:
        The best of the polished fits.
    """
    from scipy.optimize import least_squares

    lower, upper = (np.array(side, dtype=float) for side in zip(*bounds, strict=True))

    def left(p: NDArray[np.float64]) -> NDArray[np.float64]:
        return curve(times, p) - values

    def slopes(p: NDArray[np.float64]) -> NDArray[np.float64]:
        step = _STEP * np.maximum(1.0, np.abs(p))
        step = np.where(p + step > upper, -step, step)
        moved = p[:, None] + np.diag(step)
        return ((curve(times, moved[:, :, None]) - curve(times, p)) / step[:, None]).T

    grid = np.clip(np.array(list(itertools.product(*starts))), lower, upper)
    grid = grid[np.argsort(np.square(left(grid.T[:, :, None])).sum(axis=-1), kind="stable")]
    scale = np.maximum(np.abs(grid[0]), 1e-3)
    how: dict[str, Any] = {"jac": slopes, "bounds": (lower, upper), "x_scale": scale, "xtol": 1e-12, "ftol": 1e-12}
    results = [least_squares(left, start, **how) for start in grid[:_POLISHED]]
    best = min(results, key=lambda result: result.cost)
    rss = float(2 * best.cost)
    errors = _standard_errors(best.jac, rss, best.active_mask)
    return CurveFit(best.x, errors, rss, aicc(rss, times.size, best.x.size))


def _standard_errors(jacobian: NDArray[np.float64], rss: float, active: NDArray[np.int_]) -> NDArray[np.float64]:
    """Linearised standard errors of the parameters that rest on no bound."""
    errors = np.full(active.size, np.nan)
    free = active == 0
    degrees = jacobian.shape[0] - int(free.sum())
    if degrees <= 0 or not free.any():
        return errors
    information = jacobian[:, free].T @ jacobian[:, free]
    if np.linalg.cond(information) > 1e14:
        return errors
    errors[free] = np.sqrt(np.diag(np.linalg.inv(information)) * rss / degrees)
    return errors
