"""Patlak, Logan and MA1 of the test problem's voxels, against a loop over voxels and against two kinds of numpy.

The bare products return two unknowns and nothing else: no errors, no status, no check of the curves. For Patlak there
is also numpy that delivers the same answers, whole arrays at a time: estimates, residuals, standard errors, and which
curves are finite.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, Given
from petkin.methods import find_method
from petkin_bench.problems import FitProblem, fit_problem
from petkin_bench.product import beside_product
from petkin_bench.speed import as_read

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_T_STAR = 20.0
_BY_HAND = 300


def measure_graphical(label: str, *, voxels: int) -> dict[str, object]:
    """One row: a method with errors and status; by hand is a least-squares call voxel by voxel."""
    problem = fit_problem(voxels=voxels, frames=26, percent=5.0)
    by_hand, product = _BASELINES[label]
    method, curves = find_method(label), as_read(problem)
    given = Given(problem.observation, problem.weights, problem.arterial)
    late, area = problem.observation.frames.mid >= _T_STAR, problem.closed_form.basis(0.0)
    same = {"numpy_cpu_us": lambda: patlak_in_numpy(problem, curves, late, area)} if label == "Patlak" else {}
    return beside_product(
        label,
        voxels,
        lambda: method.fit(curves, given, Choices(t_star=_T_STAR), True),
        lambda: [by_hand(problem, late, area, curve) for curve in problem.curves[:_BY_HAND]],
        _BY_HAND,
        lambda: product(problem, curves, late, area),
        baseline="np.polyfit or lstsq a voxel, values only",
        **same,
    )


def _patlak_by_hand(problem: FitProblem, late: Flags, area: Array, curve: Array) -> NDArray[np.floating]:
    blood = problem.closed_form.blood[late]
    return np.polyfit(area[late] / blood, curve[late] / blood, 1, w=np.sqrt(problem.weights[late]))


def _logan_by_hand(problem: FitProblem, late: Flags, area: Array, curve: Array) -> NDArray[np.floating]:
    whole = curve * problem.closed_form.duration
    y = (np.cumsum(whole) - 0.5 * whole)[late] / curve[late]
    return np.polyfit(area[late] / curve[late], y, 1, w=np.sqrt(problem.weights[late]))


def _ma1_by_hand(problem: FitProblem, late: Flags, area: Array, curve: Array) -> NDArray[np.floating]:
    whole = curve * problem.closed_form.duration
    columns = np.stack([area, np.cumsum(whole) - 0.5 * whole], axis=1)[late]
    root = np.sqrt(problem.weights[late])
    return np.linalg.lstsq(columns * root[:, None], curve[late] * root)[0]


def _patlak_product(problem: FitProblem, curves: NDArray[np.float32], late: Flags, area: Array) -> NDArray[np.floating]:
    """One product with the pseudo-inverse (2, frames)."""
    design = np.stack([area, problem.closed_form.blood], axis=1)[late]
    weights = problem.weights[late]
    solve = np.linalg.solve((design.T * weights) @ design, design.T * weights)
    return solve.astype(np.float32) @ curves.T[late]


def patlak_in_numpy(
    problem: FitProblem, curves: NDArray[np.float32], late: Flags, area: Array
) -> tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating], Flags]:
    """Estimates (2, N), percent standard errors (2, N), chi-square (N,) and finite curves (N,), by matrix products."""
    design = np.stack([area, problem.closed_form.blood], axis=1)[late]
    weights = problem.weights[late]
    inverse = np.linalg.inv((design.T * weights) @ design)
    frames = curves.T[late]
    values = (inverse @ (design.T * weights)).astype(np.float32) @ frames
    residual = frames - design.astype(np.float32) @ values
    chi2 = weights.astype(np.float32) @ (residual * residual) / (len(weights) - 2)
    percent = 100.0 * np.sqrt(np.diag(inverse).astype(np.float32)[:, None] * chi2) / np.abs(values)
    return values, percent, chi2, np.isfinite(np.ones(curves.shape[1], np.float32) @ curves.T)


def _logan_product(problem: FitProblem, curves: NDArray[np.float32], late: Flags, area: Array) -> NDArray[np.floating]:
    """Unweighted lines from sums of x, y, x x and x y over frames."""
    frames = curves.T
    whole = frames * problem.closed_form.duration[:, None].astype(np.float32)
    inverse = 1.0 / frames[late]
    y = (np.cumsum(whole, axis=0) - 0.5 * whole)[late] * inverse
    x = area[late, None].astype(np.float32) * inverse
    mx, my = x.mean(axis=0), y.mean(axis=0)
    slope = ((x - mx) * (y - my)).sum(axis=0) / ((x - mx) ** 2).sum(axis=0)
    return np.stack([slope, my - slope * mx])


def _ma1_product(problem: FitProblem, curves: NDArray[np.float32], late: Flags, area: Array) -> NDArray[np.floating]:
    """Normal equations of two columns from sums over frames."""
    frames = curves.T
    whole = frames * problem.closed_form.duration[:, None].astype(np.float32)
    z, y = (np.cumsum(whole, axis=0) - 0.5 * whole)[late], frames[late]
    w, x = problem.weights[late].astype(np.float32), area[late].astype(np.float32)
    xx, xz, zz, xy, zy = (w * x) @ x, (w * x) @ z, w @ (z * z), (w * x) @ y, w @ (z * y)
    determinant = xx * zz - xz * xz
    return np.stack([xy * zz - zy * xz, zy * xx - xy * xz]) / determinant


_BASELINES = {
    "Patlak": (_patlak_by_hand, _patlak_product),
    "Logan": (_logan_by_hand, _logan_product),
    "MA1": (_ma1_by_hand, _ma1_product),
}
