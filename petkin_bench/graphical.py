"""Patlak and Logan plots of the test problem's voxels, against a loop over voxels and against bare numpy products.

The bare products return a slope and an intercept and nothing else: no errors, no status, no check of the curves.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import GraphicalSettings, fit_logan, fit_patlak
from petkin_bench.problems import FitProblem, fit_problem
from petkin_bench.speed import as_read
from petkin_bench.timing import measure

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_T_STAR = 20.0
_POLYFITS = 300


def measure_graphical(label: str, *, voxels: int) -> dict[str, object]:
    """One row: Patlak or Logan with errors and status; by hand is np.polyfit voxel by voxel."""
    problem = fit_problem(voxels=voxels, frames=26, percent=5.0)
    plot, axes, product = _PLOTS[label]
    curves, settings = as_read(problem), GraphicalSettings(_T_STAR, keep_predicted=False)
    late, area = problem.observation.frames.mid >= _T_STAR, problem.closed_form.basis(0.0)
    loop = measure(lambda: _polyfit(problem, late, area, axes), 1)
    bare = measure(lambda: product(problem, curves, late, area))
    ours = measure(lambda: plot(curves, problem.arterial, problem.observation, problem.weights, settings))
    return {
        "fit": label,
        "frames": 26,
        "noise_percent": 5.0,
        "voxels": voxels,
        "voxels_per_s": voxels / ours.wall,
        "cpu_us_per_voxel": 1e6 * ours.cpu / voxels,
        "by_hand_cpu_us": 1e6 * loop.cpu / _POLYFITS,
        "ratio_cpu": loop.cpu / _POLYFITS * voxels / ours.cpu,
        "product_cpu_us": 1e6 * bare.cpu / voxels,
        "baseline": "np.polyfit a voxel, values only",
    }


def _polyfit(problem: FitProblem, late: Flags, area: Array, axes: Callable[..., tuple[Array, Array]]) -> list[Array]:
    weights = np.sqrt(problem.weights[late])
    lines = []
    for n in range(_POLYFITS):
        x, y = axes(problem, area, problem.curves[n])
        lines.append(np.polyfit(x[late], y[late], 1, w=weights))
    return lines


def _patlak_axes(problem: FitProblem, area: Array, curve: Array) -> tuple[Array, Array]:
    blood = problem.closed_form.blood
    return area / blood, curve / blood


def _logan_axes(problem: FitProblem, area: Array, curve: Array) -> tuple[Array, Array]:
    whole = curve * problem.closed_form.duration
    return area / curve, (np.cumsum(whole) - 0.5 * whole) / curve


def _patlak_product(problem: FitProblem, curves: NDArray[np.float32], late: Flags, area: Array) -> NDArray[np.floating]:
    """One product with the pseudo-inverse (2, frames)."""
    design = np.stack([area, problem.closed_form.blood], axis=1)[late]
    weights = problem.weights[late]
    solve = np.linalg.solve((design.T * weights) @ design, design.T * weights)
    return solve.astype(np.float32) @ curves.T[late]


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


_PLOTS = {
    "Patlak": (fit_patlak, _patlak_axes, _patlak_product),
    "Logan": (fit_logan, _logan_axes, _logan_product),
}
