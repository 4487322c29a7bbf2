"""Least squares inside a box of rate constants, for curves whose free optimum leaves it or with values held fixed.

Projected Levenberg-Marquardt on all curves at once: parameters on a bound that the gradient pushes outwards are held,
the rest take the damped Gauss-Newton step, clipped to the box (Kanzow, Yamashita & Fukushima 2004,
doi:10.1016/j.cam.2004.02.013). Started from the free optimum moved into the box and from the best points of a grid.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import ParameterSet
from petkin.fitting.box import BoxTask, polish_in_box
from petkin.fitting.explicit import polish_explicit
from petkin.fitting.sensitivity import blood_values, model_values
from petkin.fitting.table import Compression, project_rows
from petkin.kinetics import CompartmentModel
from petkin.levenberg_marquardt import Fitted, better_of

Array = NDArray[np.float64]

#: Penalties of a rate that leaves its interval by its own size, over the curve's sum of squares.
_PENALTIES = 1.0, 1e2, 1e4
#: Along the end of an interval steps are short; below this relative gain they are not worth while.
_CRAWL = 1e-6
_GRID_LEVELS, _WALL_LEVELS = 6, 3


def fit_in_box(
    model: CompartmentModel,
    packed: Compression,
    z: Array,
    sizes: Array,
    start: Array,
    box: ParameterSet,
    rates: tuple[float, float],
    *,
    starts: int,
    tolerance: float,
    explicit: bool,
) -> Fitted:
    """Fit curves inside a box.

    Args:
        model: compartment model.
        packed: compressed table; must cover every rate that the box allows.
        z: compressed curves (R, N).
        sizes: weighted sums of squares (N,).
        start: free optimum (N, P), moved into the box here.
        box: bounds and fixed values.
        rates: interval of the exponentials' rates, 1/min; an end that no point of the box respects does not count.
        starts: grid points to start from as well.
        tolerance: a fit ends when its expected relative gain in cost falls below this.
        explicit: work on residuals themselves, past the rounding of inner products; a hundred times slower.

    Returns:
        parameters (N, P), costs (N,), converged (N,).
    """
    lower, upper = box.lower, box.upper
    task = BoxTask(model, packed, lower, upper, _within_reach(model, box, rates), tolerance)
    polish = polish_explicit if explicit or model.wall else polish_in_box
    middle = np.broadcast_to(box.start, start.shape)
    candidates = [np.clip(np.where(np.isfinite(start), start, middle), lower, upper)]
    if starts:
        candidates += [np.clip(one, lower, upper) for one in _grid_starts(model, packed, z, box, starts)]
    best = _keep_rates(polish, task, z, sizes, candidates[0])
    for candidate in candidates[1:]:
        best = better_of(best, _keep_rates(polish, task, z, sizes, candidate))
    return best


def _keep_rates(polish: Callable[..., Fitted], task: BoxTask, z: Array, sizes: Array, start: Array) -> Fitted:
    """First as if rates were free; those that leave their interval are then drawn back, harder and harder."""
    theta, cost, converged = polish(task, z, sizes, start, 0.0)
    task = replace(task, tolerance=max(task.tolerance, _CRAWL))
    for penalty in _PENALTIES:
        found = np.stack([a for _, a in task.model.impulse(*theta[:, : task.model.rates].T)])
        left = np.flatnonzero(((found < task.rates[0]) | (found > task.rates[1])).any(axis=0))
        if left.size == 0:
            break
        theta[left], cost[left], converged[left] = polish(task, z[:, left], sizes[left], theta[left], penalty)
    return theta, cost, converged


def _within_reach(model: CompartmentModel, box: ParameterSet, rates: tuple[float, float]) -> tuple[float, float]:
    """The interval of rates without an end that no corner of the box respects."""
    slow, fast = 0.0 if model.trapping else rates[0], rates[1]
    ends = np.clip(np.stack([box.lower, box.upper], axis=1)[: model.rates], 1e-12, 1e6)
    found = np.array([[a for _, a in model.impulse(*corner)] for corner in itertools.product(*ends)])
    slowest = found[:, model.free_rates - 1]
    return (slow if slowest.max() > slow else 0.0), (fast if found[:, 0].min() < fast else np.inf)


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
