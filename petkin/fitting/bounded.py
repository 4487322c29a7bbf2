"""Least squares inside a box of rate constants, for curves whose free optimum leaves it or with values held fixed.

Projected Levenberg-Marquardt on all curves at once: parameters on a bound that the gradient pushes outwards are held,
the rest take the damped Gauss-Newton step, clipped to the box (Kanzow, Yamashita & Fukushima 2004,
doi:10.1016/j.cam.2004.02.013). Started from the free optimum moved into the box and from the best points of a grid.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import ParameterSet
from petkin.fitting.sensitivity import blood_values, model_jacobian, model_values
from petkin.fitting.table import Compression, project_rows
from petkin.kinetics import CompartmentModel

Array = NDArray[np.float64]

_MAX_STEPS = 200
_GRID_LEVELS, _WALL_LEVELS = 6, 3
#: Below this share of a parameter's range (or its own size) a value counts as on its bound.
ON_BOUND = 1e-7


def fit_in_box(
    model: CompartmentModel,
    packed: Compression,
    z: Array,
    sizes: Array,
    start: Array,
    box: ParameterSet,
    *,
    starts: int,
    tolerance: float,
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Fit curves inside a box.

    Args:
        model: compartment model.
        packed: compressed table; must cover every rate that the box allows.
        z: compressed curves (R, N).
        sizes: weighted sums of squares (N,).
        start: free optimum (N, P), moved into the box here.
        box: bounds and fixed values.
        starts: grid points to start from as well.
        tolerance: a fit ends when its expected relative gain in cost falls below this.

    Returns:
        parameters (N, P), costs (N,), converged (N,).
    """
    lower, upper = box.lower, box.upper
    middle = np.broadcast_to(box.start, start.shape)
    candidates = [np.clip(np.where(np.isfinite(start), start, middle), lower, upper)]
    if starts:
        candidates += [np.clip(one, lower, upper) for one in _grid_starts(model, packed, z, box, starts)]
    values, jacobian = partial(model_values, model, packed), partial(model_jacobian, model, packed)
    return best_polish(values, jacobian, z, sizes, candidates, lower, upper, tolerance)


def best_polish(
    values: Callable[[Array], Array],
    jacobian: Callable[[Array], tuple[Array, Array]],
    z: Array,
    sizes: Array,
    starts: Sequence[Array],
    lower: Array,
    upper: Array,
    tolerance: float,
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The best end of the polishes from several starts.

    Args:
        values: compressed curves (N, R) of parameters (N, P).
        jacobian: the same with their derivatives (N, R, P).
        z, sizes, tolerance: as in `fit_in_box`.
        starts: parameters (N, P) to start from, inside the box.
        lower, upper: the box (P,), or one a curve (N, P).

    Returns:
        parameters (N, P), costs (N,), converged (N,).
    """

    def values_of(theta: Array, _: NDArray[np.intp]) -> Array:
        return values(theta)

    def jacobian_of(theta: Array, _: NDArray[np.intp]) -> tuple[Array, Array]:
        return jacobian(theta)

    best = polish(values_of, jacobian_of, z, sizes, starts[0], lower, upper, tolerance)
    for start in starts[1:]:
        trial = polish(values_of, jacobian_of, z, sizes, start, lower, upper, tolerance)
        better = trial[1] < best[1]
        best = tuple(np.where(better.reshape(-1, *[1] * (old.ndim - 1)), new, old) for new, old in zip(trial, best))
    return best  # type: ignore[return-value]


def _grid_starts(model: CompartmentModel, packed: Compression, z: Array, box: ParameterSet, starts: int) -> Array:
    """The best `starts` grid points a curve (starts, N, P): rates on log levels, K1 and vB by least squares."""
    levels = [_levels(lo, hi, n) for lo, hi, n in zip(box.lower[1:-1], box.upper[1:-1], _level_counts(model))]
    rates = np.array(list(itertools.product(*levels)))
    ones, zeros = np.ones((len(rates), 1)), np.zeros((len(rates), 1))
    unit = model_values(model, packed, np.hstack([ones, rates, zeros]))  # (G, R)
    vessel = blood_values(model, packed, np.hstack([ones, rates, zeros]))
    tissue, filled = ((v**2).sum(axis=1)[:, None] for v in (unit, vessel))
    both = (unit * vessel).sum(axis=1)[:, None]
    on_tissue, on_blood = (project_rows(np.ascontiguousarray(v), np.ascontiguousarray(z.T)) for v in (unit, vessel))
    apart = np.maximum(tissue * filled - both**2, 1e-300)
    amplitude = np.maximum((filled * on_tissue - both * on_blood) / apart, 0.0)  # (G, N)
    blood = (on_blood - amplitude * both) / np.maximum(filled, 1e-300)
    vB = np.clip(blood, box.lower[-1], min(box.upper[-1], 0.99))
    K1 = np.clip(amplitude / (1.0 - vB), box.lower[0], box.upper[0])
    held = K1 * (1.0 - vB)
    left = held * (held * tissue + 2.0 * (vB * both - on_tissue)) + vB * (vB * filled - 2.0 * on_blood)
    order = np.argsort(left, axis=0, kind="stable")[:starts]
    columns = np.arange(z.shape[1])
    return np.stack([np.column_stack([K1[row, columns], rates[row], vB[row, columns]]) for row in order])


def _level_counts(model: CompartmentModel) -> list[int]:
    """Levels of the tissue's rates, then of Kb."""
    return [_GRID_LEVELS] * (model.rates - 1) + [_WALL_LEVELS] * model.wall


def _levels(lower: float, upper: float, count: int) -> Array:
    if upper <= lower:
        return np.array([lower])
    return np.clip(np.geomspace(max(lower, 3e-3 * min(upper, 1.0)), min(upper, 1.0), count), lower, upper)


def polish(
    values_at: Callable[[Array, NDArray[np.intp]], Array],
    jacobian_at: Callable[[Array, NDArray[np.intp]], tuple[Array, Array]],
    z: Array,
    sizes: Array,
    start: Array,
    lower: Array,
    upper: Array,
    tolerance: float,
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Projected Levenberg-Marquardt from one start a curve.

    Args:
        values_at: parameters (n, P) and which curves they are for (n,) -> model (n, R).
        jacobian_at: the same -> model (n, R) and its Jacobian (n, R, P).
        z: what the model should be (R, N).
        sizes: sums of squares of the curves (N,), at least those of z.
        start: parameters (N, P), inside the box.
        lower, upper: the box (P,).
        tolerance: a fit ends when its expected relative gain in cost falls below this.

    Returns:
        parameters (N, P), costs (N,), converged (N,).
    """
    theta = start.copy()
    outside = sizes - (z * z).sum(axis=0)
    lower, upper = np.broadcast_to(lower, theta.shape), np.broadcast_to(upper, theta.shape)
    span = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
    cost = ((z.T - values_at(theta, np.arange(len(theta)))) ** 2).sum(axis=1)
    damping = np.full(len(theta), 1e-3)
    active = np.ones(len(theta), bool)
    for _ in range(_MAX_STEPS):
        rows = np.flatnonzero(active)
        if rows.size == 0:
            break
        here = theta[rows]
        values, jacobian = jacobian_at(here, rows)
        residual = z.T[rows] - values
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
        trial_cost = ((z.T[rows] - values_at(here + step, rows)) ** 2).sum(axis=1)
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
