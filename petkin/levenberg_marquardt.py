"""Projected Levenberg-Marquardt in a box, on residuals themselves, of many small curves at once.

Parameters on a bound that the gradient pushes outwards are held, the rest take the damped Gauss-Newton step, clipped to
the box.

References: Kanzow C, Yamashita N, Fukushima M. J Comput Appl Math 2004;172:375-397. doi:10.1016/j.cam.2004.02.013.
Damping: Nielsen HB. Report IMM-REP-1999-05, Technical University of Denmark 1999.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Parameters (N, P), costs (N,), converged (N,).
Fitted = tuple[Array, Array, NDArray[np.bool_]]
#: Of parameters (n, P) of the curves numbered (n,).
Values = Callable[[Array, NDArray[np.intp]], Array]
Jacobian = Callable[[Array, NDArray[np.intp]], tuple[Array, Array]]

#: Below this share of a parameter's range (or its own size) a value counts as on its bound.
ON_BOUND = 1e-7
_MAX_STEPS = 200


def polish(
    values_of: Values,
    jacobian_of: Jacobian,
    z: Array,
    sizes: Array,
    start: Array,
    lower: Array,
    upper: Array,
    tolerance: float,
    walls: int = 0,
) -> Fitted:
    """Projected Levenberg-Marquardt from one start a curve.

    Args:
        values_of: parameters (n, P) and which curves they are for (n,) -> model (n, R).
        jacobian_of: the same -> model (n, R) and its Jacobian (n, R, P).
        z: curves (R, N), as they are or compressed.
        sizes: sums of squares of the curves as they were (N,).
        start: parameters (N, P), inside the box.
        lower, upper: the box (P,), or one a curve (N, P).
        tolerance: a fit ends when its expected relative gain in cost falls below this.
        walls: how many of the last values are distances beyond a wall, which count where they are positive. A step that
            would pass a wall is taken along it.

    Returns:
        parameters (N, P), costs (N,), converged (N,).
    """
    theta, curves = start.copy(), np.ascontiguousarray(z.T)  # sums must not depend on how many curves there are
    outside = sizes - (curves * curves).sum(axis=1)
    lower, upper = np.broadcast_to(lower, theta.shape), np.broadcast_to(upper, theta.shape)
    span = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
    every = np.arange(len(theta))
    cost = _cost(curves, values_of(theta, every), walls)
    damping, growth = np.full(len(theta), 1e-3), np.full(len(theta), 2.0)
    active = np.ones(len(theta), bool)
    for _ in range(_MAX_STEPS):
        rows = np.flatnonzero(active)
        if rows.size == 0:
            break
        here = theta[rows]
        values, jacobian = jacobian_of(here, rows)
        residual = np.ascontiguousarray(curves[rows] - values)
        counts = np.ones(residual.shape, bool)
        if walls:
            counts[:, -walls:] = values[:, -walls:] > 0.0
        gradient = np.einsum("nrp,nr->np", jacobian, residual * counts)
        low, high, wide = lower[rows], upper[rows], span[rows]
        held = ((here <= low + ON_BOUND * wide) & (gradient <= 0)) | (
            (here >= high - ON_BOUND * wide) & (gradient >= 0)
        )
        jacobian *= ~held[:, None, :]
        step, expected = _step(residual * counts, jacobian * counts[..., None], damping[rows], here, low, high)
        if walls:
            ahead = np.einsum("nrp,np->nr", jacobian[:, -walls:], step) > residual[:, -walls:]
            met = ahead & ~counts[:, -walls:]
            if met.any():
                counts[:, -walls:] |= met
                step, expected = _step(residual * counts, jacobian * counts[..., None], damping[rows], here, low, high)
                expected -= ((met * residual[:, -walls:]) ** 2).sum(axis=1)
        trial_cost = _cost(curves[rows], values_of(here + step, rows), walls)
        better = trial_cost < cost[rows]
        gain = cost[rows] - trial_cost
        theta[rows[better]] = (here + step)[better]
        cost[rows[better]] = trial_cost[better]
        # Nielsen's rule: less damping the more of the expected gain a step brings, more and more where steps fail.
        share = np.clip(gain, 0.0, 2.0 * np.maximum(expected, 0.0)) / np.where(expected > 0.0, expected, 1.0)
        factor = np.where(better, np.maximum(1.0 / 3.0, 1.0 - (2.0 * share - 1.0) ** 3), growth[rows])
        damping[rows] = np.maximum(damping[rows] * factor, np.where(better, 1e-12, 1e-6))
        growth[rows] = np.where(better, 2.0, 2.0 * growth[rows])
        small = np.abs(expected) <= tolerance * (cost[rows] + np.maximum(outside[rows], 0.0)) + 1e-24 * sizes[rows]
        active[rows[small | (damping[rows] > 1e10)]] = False
    return theta, cost + outside, ~active


def better_of(best: Fitted, trial: Fitted) -> Fitted:
    """Curve by curve."""
    better = trial[1] < best[1]
    theta, cost, converged = best
    return (
        np.where(better[:, None], trial[0], theta),
        np.where(better, trial[1], cost),
        np.where(better, trial[2], converged),
    )


def _cost(curves: Array, values: Array, walls: int) -> Array:
    """Sums of squares (n,)."""
    left = curves - values
    if walls:
        left[:, -walls:] = np.minimum(left[:, -walls:], 0.0)
    return np.asarray((left**2).sum(axis=1))


def _step(
    residual: Array, jacobian: Array, damping: Array, here: Array, low: Array, high: Array
) -> tuple[Array, Array]:
    """A damped Gauss-Newton step, clipped to the box (n, P), and what it is expected to gain (n,)."""
    gradient = np.einsum("nrp,nr->np", jacobian, residual)
    normal = np.einsum("nrp,nrq->npq", jacobian, jacobian)
    scale = np.einsum("npp->np", normal)
    safe = np.where(scale > 0, scale, 1.0)
    damped = (
        normal + np.eye(here.shape[1]) * (damping[:, None] * scale + np.where(scale > 0, 1e-14 * safe, 1.0))[:, :, None]
    )
    step = np.clip(here + np.linalg.solve(damped, gradient[..., None])[..., 0], low, high) - here
    return step, 2.0 * (gradient * step).sum(axis=1) - np.einsum("np,npq,nq->n", step, normal, step)
