"""The named baseline, `scipy.optimize.curve_fit` a voxel at a time, and the best cost that anyone knows of.

`best_costs` works in float64 and in the space of frames, by formula, and shares nothing with petkin's search: every
pair of rates on a log grid by non-negative least squares, the four best local minima polished by
`scipy.optimize.least_squares`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit, least_squares, nnls

from petkin_bench.closed_form import ClosedForm
from petkin_bench.problems import FitProblem

Array = NDArray[np.float64]

#: Upper bounds and start of K1, k2, k3, k4, vB, as a careful user sets them; lower bounds are 0.
UPPER = {"K1": 2.0, "k2": 3.0, "k3": 1.0, "k4": 0.5, "vB": 1.0}
START = {"K1": 0.1, "k2": 0.15, "k3": 0.05, "k4": 0.01, "vB": 0.05}

#: Feasible set of the best known cost: rates in [0, this] 1/min, amplitudes not negative.
FASTEST_RATE = 5.0
_NODES = 96
_POLISHED = 4
_OFFSET = 1e-3


@dataclass(frozen=True)
class HandFit:
    """Fits by hand: parameters (M, P) with NaN where curve_fit raised, percent standard errors likewise."""

    parameters: Array
    percent_se: Array


def fit_by_hand(problem: FitProblem, symbols: tuple[str, ...], curves: int | slice) -> HandFit:
    """curve_fit with bounds (method trf, 2-point Jacobian) on the first so many curves, or on a slice of them."""
    start = [START[s] for s in symbols]
    bounds = ([0.0] * len(symbols), [UPPER[s] for s in symbols])
    sigma = 1.0 / np.sqrt(problem.weights)
    chosen = problem.curves[curves if isinstance(curves, slice) else slice(0, curves)]
    values, errors = np.full((len(chosen), len(symbols)), np.nan), np.full((len(chosen), len(symbols)), np.nan)
    for n, curve in enumerate(chosen):
        try:
            values[n], covariance = curve_fit(
                lambda _, *p: problem.model_curve(*p), sigma, curve, p0=start, sigma=sigma, bounds=bounds
            )
        except RuntimeError:  # curve_fit's own word for "no convergence"
            continue
        errors[n] = 100.0 * np.sqrt(np.diag(covariance)) / np.maximum(np.abs(values[n]), 1e-300)
    return HandFit(values, errors)


def costs_of(problem: FitProblem, parameters: Array) -> Array:
    """sum_k w_k (y_k - model_k)^2 by formula at parameters (M, P) of the first M curves; infinite where not finite."""
    costs = np.full(len(parameters), np.inf)
    for n in np.flatnonzero(np.isfinite(parameters).all(axis=1)):
        # the formula has a removable pole at k = 0
        model = problem.model_curve(*np.maximum(parameters[n], 1e-12))
        costs[n] = problem.weights @ (problem.curves[n] - model) ** 2
    return np.where(np.isfinite(costs), costs, np.inf)


def best_costs(problem: FitProblem, count: int, *, trapped: bool = False, single: bool = False) -> Array:
    """Least cost of the first `count` curves: vB >= 0 and one exponential, or two, the slower at 0 if `trapped`."""
    root = np.sqrt(problem.weights)
    grid = np.geomspace(_OFFSET, FASTEST_RATE + _OFFSET, _NODES) - _OFFSET
    grid[0] = 0.0
    atoms = np.stack([problem.closed_form.basis(float(a)) for a in grid]) * root
    blood = problem.closed_form.blood * root
    data = problem.curves[:count] * root
    if single:
        pairs: list[tuple[int, int | None]] = [(i, None) for i in range(_NODES)]
    else:
        slower = [0] if trapped else range(_NODES)
        pairs = [(i, j) for j in slower for i in range(j + 1, _NODES)]
    costs = np.stack([_non_negative(data, [blood, atoms[i], *([] if j is None else [atoms[j]])]) for i, j in pairs])
    return np.array(
        [
            min(
                _polish(
                    problem.closed_form, root, data[n], [grid[k] for k in pairs[p] if k is not None], trapped=trapped
                )
                for p in _local_minima(pairs, costs[:, n])
            )
            for n in range(count)
        ]
    )


def _non_negative(data: Array, columns: list[Array]) -> Array:
    """min |y - X x|^2 over x >= 0 for every row of `data` (N, K), by trying every support."""
    best = (data**2).sum(axis=1)
    whole = best.copy()
    for size in range(1, len(columns) + 1):
        for support in itertools.combinations(columns, size):
            design = np.stack(support, axis=1)
            x = np.linalg.lstsq(design, data.T, rcond=None)[0]
            cost = whole - ((design @ x) * data.T).sum(axis=0)
            best = np.where((x >= 0).all(axis=0) & (cost < best), cost, best)
    return best


def _local_minima(pairs: list[tuple[int, int | None]], costs: Array) -> list[int]:
    """The best few pairs that no neighbour on the grid undercuts."""
    place = {pair: p for p, pair in enumerate(pairs)}

    def lowest_around(i: int, j: int | None) -> float:
        near = [(i + s, j if j is None else j + t) for s in (-1, 0, 1) for t in (-1, 0, 1)]
        return min(costs[place[pair]] for pair in near if pair in place)

    order = np.argsort(costs, kind="stable")[:400]
    found = [int(p) for p in order if costs[p] <= lowest_around(*pairs[p])]
    return found[:_POLISHED]


def _polish(closed_form: ClosedForm, root: Array, y: Array, rates: list[float], *, trapped: bool) -> float:
    """Cost after `least_squares` over the free rates and all amplitudes, from the amplitudes that fit best."""
    free = len(rates) - trapped

    def design(u: Array) -> Array:
        every = [*(np.exp(u) - _OFFSET), *([0.0] if trapped else [])]
        return np.stack([closed_form.blood * root, *(closed_form.basis(max(a, 0.0)) * root for a in every)], axis=1)

    def residual(x: Array) -> Array:
        return design(x[:free]) @ x[free:] - y

    u = np.log(np.array(rates[:free]) + _OFFSET)
    amplitudes = nnls(design(u), y)[0]
    lower = np.concatenate([np.full(free, np.log(_OFFSET)), np.zeros(len(amplitudes))])
    upper = np.concatenate([np.full(free, np.log(FASTEST_RATE + _OFFSET)), np.full(len(amplitudes), np.inf)])
    start = np.clip(np.concatenate([u, amplitudes]), lower, upper)
    ended = least_squares(residual, start, bounds=(lower, upper), x_scale="jac", ftol=1e-12, xtol=1e-12, gtol=1e-12)
    return min(2.0 * ended.cost, float(residual(start) @ residual(start)))
