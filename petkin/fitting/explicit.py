"""Projected Levenberg-Marquardt in a box, on residuals themselves: past the rounding of inner products, and slower.

Besides those of the curve there is one residual a rate, for how far it leaves its interval. See `box` for the method.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.box import ON_BOUND, BoxTask
from petkin.fitting.sensitivity import derivatives, model_jacobian, model_values

Array = NDArray[np.float64]

Fitted = tuple[Array, Array, NDArray[np.bool_]]
#: Of parameters (n, P) of the curves numbered (n,).
Values = Callable[[Array, NDArray[np.intp]], Array]
Jacobian = Callable[[Array, NDArray[np.intp]], tuple[Array, Array]]

_MAX_STEPS = 200


def polish_explicit(task: BoxTask, z: Array, sizes: Array, start: Array, penalty: float) -> Fitted:
    """Fit curves from given starts; arguments and answer as for `box.polish_in_box`."""

    def values(theta: Array, rows: NDArray[np.intp]) -> Array:
        curves = model_values(task.model, task.packed, theta)
        return np.concatenate([curves, _excess(task, sizes[rows], theta, penalty)[0]], axis=1)

    def jacobian(theta: Array, rows: NDArray[np.intp]) -> tuple[Array, Array]:
        parts = model_jacobian(task.model, task.packed, theta), _excess(task, sizes[rows], theta, penalty)
        return np.concatenate([p[0] for p in parts], axis=1), np.concatenate([p[1] for p in parts], axis=1)

    extended = np.concatenate([z, np.zeros((task.model.free_rates + task.model.trapping, z.shape[1]))])
    theta, cost, converged = polish(values, jacobian, extended, sizes, start, task.lower, task.upper, task.tolerance)
    return theta, cost - (_excess(task, sizes, theta, penalty)[0] ** 2).sum(axis=1), converged


def best_polish(
    values: Callable[[Array], Array],
    jacobian: Callable[[Array], tuple[Array, Array]],
    z: Array,
    sizes: Array,
    starts: Sequence[Array],
    lower: Array,
    upper: Array,
    tolerance: float,
) -> Fitted:
    """The best end of the polishes from several starts.

    Args:
        values: compressed curves (n, R) of parameters (n, P).
        jacobian: the same with their derivatives (n, R, P).
        z: compressed curves (R, N).
        sizes: weighted sums of squares (N,).
        starts: parameters (N, P) to start from, inside the box.
        lower, upper: the box (P,), or one a curve (N, P).
        tolerance: a fit ends when its expected relative gain in cost falls below this.

    Returns:
        parameters (N, P), costs (N,), converged (N,).
    """
    functions: tuple[Values, Jacobian] = (lambda theta, _: values(theta), lambda theta, _: jacobian(theta))
    best = polish(*functions, z, sizes, starts[0], lower, upper, tolerance)
    for start in starts[1:]:
        best = better_of(best, polish(*functions, z, sizes, start, lower, upper, tolerance))
    return best


def better_of(best: Fitted, trial: Fitted) -> Fitted:
    """Curve by curve."""
    better = trial[1] < best[1]
    theta, cost, converged = best
    return (
        np.where(better[:, None], trial[0], theta),
        np.where(better, trial[1], cost),
        np.where(better, trial[2], converged),
    )


def polish(
    values_of: Values,
    jacobian_of: Jacobian,
    z: Array,
    sizes: Array,
    start: Array,
    lower: Array,
    upper: Array,
    tolerance: float,
) -> Fitted:
    """Projected Levenberg-Marquardt from one start a curve.

    Args:
        values_of: parameters (n, P) and which curves they are for (n,) -> model (n, R).
        jacobian_of: the same -> model (n, R) and its Jacobian (n, R, P).
        z, sizes, lower, upper, tolerance: as in `best_polish`.
        start: parameters (N, P), inside the box.

    Returns:
        parameters (N, P), costs (N,), converged (N,).
    """
    theta, curves = start.copy(), np.ascontiguousarray(z.T)  # sums must not depend on how many curves there are
    outside = sizes - (curves * curves).sum(axis=1)
    lower, upper = np.broadcast_to(lower, theta.shape), np.broadcast_to(upper, theta.shape)
    span = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
    every = np.arange(len(theta))
    cost = ((curves - values_of(theta, every)) ** 2).sum(axis=1)
    damping = np.full(len(theta), 1e-3)
    active = np.ones(len(theta), bool)
    for _ in range(_MAX_STEPS):
        rows = np.flatnonzero(active)
        if rows.size == 0:
            break
        here = theta[rows]
        values, jacobian = jacobian_of(here, rows)
        residual = np.ascontiguousarray(curves[rows] - values)
        gradient = np.einsum("nrp,nr->np", jacobian, residual)
        low, high, wide = lower[rows], upper[rows], span[rows]
        held = ((here <= low + ON_BOUND * wide) & (gradient <= 0)) | (
            (here >= high - ON_BOUND * wide) & (gradient >= 0)
        )
        jacobian *= ~held[:, None, :]
        gradient *= ~held
        normal = np.einsum("nrp,nrq->npq", jacobian, jacobian)
        scale = np.einsum("npp->np", normal)
        safe = np.where(scale > 0, scale, 1.0)
        damped = (
            normal
            + np.eye(here.shape[1]) * (damping[rows, None] * scale + np.where(scale > 0, 1e-14 * safe, 1.0))[:, :, None]
        )
        step = np.clip(here + np.linalg.solve(damped, gradient[..., None])[..., 0], low, high) - here
        expected = 2.0 * (gradient * step).sum(axis=1) - np.einsum("np,npq,nq->n", step, normal, step)
        trial_cost = ((curves[rows] - values_of(here + step, rows)) ** 2).sum(axis=1)
        better = trial_cost < cost[rows]
        gain = cost[rows] - trial_cost
        theta[rows[better]] = (here + step)[better]
        cost[rows[better]] = trial_cost[better]
        # Steps that gain much less than expected overshoot: less damping would make them bounce from side to side.
        factor = np.where(gain > 0.75 * expected, 0.1, np.where(gain > 0.25 * expected, 1.0, 4.0))
        damping[rows] = np.maximum(damping[rows] * np.where(better, factor, 10.0), np.where(better, 1e-12, 1e-4))
        small = np.abs(expected) <= tolerance * (cost[rows] + np.maximum(outside[rows], 0.0)) + 1e-24 * sizes[rows]
        active[rows[small | (damping[rows] > 1e10)]] = False
    return theta, cost + outside, ~active


def _excess(task: BoxTask, sizes: Array, theta: Array, penalty: float) -> tuple[Array, Array]:
    """How far every rate leaves its interval, weighted, (N, m), and its derivatives (N, m, P)."""
    count, (slow, fast) = task.model.rates, task.rates
    found, chain = derivatives(lambda *k: tuple(a for _, a in task.model.impulse(*k)), theta[:, :count])
    below, above = np.minimum(found - slow, 0.0), np.maximum(found - fast, 0.0)
    weight = np.sqrt(penalty * sizes)[:, None] * np.where(below < 0, 1.0 / max(slow, 1e-6), 1.0 / fast)
    jacobian = np.zeros((*found.shape, theta.shape[1]))
    jacobian[:, :, :count] = np.where((below + above != 0)[..., None], weight[..., None] * chain, 0.0)
    return np.ascontiguousarray(weight * (below + above)), jacobian
