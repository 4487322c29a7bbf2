"""Projected Levenberg-Marquardt in a box, on residuals themselves: past the rounding of inner products, and slower.

Besides those of the curve there are two residuals a rate, walls at the ends of its interval. See `box` for the method.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.box import BoxTask
from petkin.fitting.sensitivity import derivatives, model_jacobian, model_values
from petkin.levenberg_marquardt import Fitted, Jacobian, Values, better_of, polish

Array = NDArray[np.float64]

#: 1/min; stands for a rate without an end.
_FASTEST = 1e6


def polish_explicit(task: BoxTask, z: Array, sizes: Array, start: Array, penalty: float) -> Fitted:
    """Fit curves from given starts; arguments and answer as for `box.polish_in_box`."""

    def values(theta: Array, rows: NDArray[np.intp]) -> Array:
        curves = model_values(task.model, task.packed, theta)
        return np.concatenate([curves, _excess(task, sizes[rows], theta, penalty)[0]], axis=1)

    def jacobian(theta: Array, rows: NDArray[np.intp]) -> tuple[Array, Array]:
        parts = model_jacobian(task.model, task.packed, theta), _excess(task, sizes[rows], theta, penalty)
        return np.concatenate([p[0] for p in parts], axis=1), np.concatenate([p[1] for p in parts], axis=1)

    walls = 2 * (task.model.free_rates + task.model.trapping)
    extended = np.concatenate([z, np.zeros((walls, z.shape[1]))])
    lower, upper = task.lower, task.upper
    theta, cost, converged = polish(values, jacobian, extended, sizes, start, lower, upper, task.tolerance, walls)
    return theta, cost - (np.maximum(_excess(task, sizes, theta, penalty)[0], 0.0) ** 2).sum(axis=1), converged


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


def _excess(task: BoxTask, sizes: Array, theta: Array, penalty: float) -> tuple[Array, Array]:
    """How far every rate lies below and above its interval, weighted, (N, 2m), and its derivatives (N, 2m, P)."""
    count, (slow, fast) = task.model.rates, task.rates
    found, chain = derivatives(lambda *k: tuple(a for _, a in task.model.impulse(*k)), theta[:, :count])
    firm = np.sqrt(penalty * sizes)[:, None]
    ends = ((-firm / max(slow, 1e-6), slow), (firm / fast, min(fast, _FASTEST)))
    jacobian = np.zeros((len(theta), 2 * found.shape[1], theta.shape[1]))
    jacobian[:, :, :count] = np.concatenate([weight[..., None] * chain for weight, _ in ends], axis=1)
    return np.concatenate([weight * (found - end) for weight, end in ends], axis=1), jacobian
