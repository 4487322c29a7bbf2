"""How fast a fit is against `scipy.optimize.curve_fit` by hand in the same run, and how good both are."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import VOXELS, Choices, FitResult, NonlinearSettings, find_method, fit_curves
from petkin.kinetics import compartment_model
from petkin_bench.by_hand import FASTEST_RATE, best_costs, costs_of, fit_by_hand
from petkin_bench.problems import DRAWN, FitProblem, fit_problem

Array = NDArray[np.float64]
_REPEATS = 3


@dataclass(frozen=True)
class Timing:
    """Wall and processor time of one run, s; medians over repeats."""

    wall: float
    cpu: float


def timed(work: Callable[[], object], repeats: int = _REPEATS) -> Timing:
    """Median times of `work` after one run to warm up."""
    work()
    walls, cpus = [], []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        work()
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    return Timing(float(np.median(walls)), float(np.median(cpus)))


def measure_model(
    model: str, *, frames: int, percent: float, voxels: int, by_hand: int, judged: int
) -> dict[str, object]:
    """One row: speed of petkin's voxel fit with standard errors, ratio to by hand, quality of both.

    Args:
        model: 2TCM, 2TCM3k or 1TCM.
        frames, percent, voxels: the problem, see `fit_problem`.
        by_hand: curves fitted with curve_fit.
        judged: curves whose best known cost is worked out.
    """
    problem = fit_problem(voxels=voxels, frames=frames, percent=percent, model=model)
    settings = NonlinearSettings(
        compartment_model(model), rate_bounds=(0.0, FASTEST_RATE), effort=VOXELS, keep_predicted=False
    )

    def fit() -> FitResult:
        return fit_curves(problem.curves, problem.arterial, problem.observation, problem.weights, settings)

    ours = timed(fit)
    result = fit()
    start = time.process_time()
    hand = fit_by_hand(problem, DRAWN[model], by_hand)
    hand_cpu = (time.process_time() - start) / by_hand
    best = best_costs(problem, judged, trapped=model == "2TCM3k", single=model == "1TCM")
    fitted = np.stack([result[s][:judged].astype(np.float64) for s in DRAWN[model]], axis=1)
    mine = costs_of(problem, fitted)
    theirs = costs_of(problem, hand.parameters[:judged])
    outcome = "VT" if model == "1TCM" else "Ki"
    error = result[outcome] / _outcome(model, problem) - 1.0
    return {
        "fit": model,
        "frames": frames,
        "noise_percent": percent,
        "voxels": voxels,
        "voxels_per_s": voxels / ours.wall,
        "cpu_us_per_voxel": 1e6 * ours.cpu / voxels,
        "by_hand_cpu_us": 1e6 * hand_cpu,
        "ratio_cpu": hand_cpu * voxels / ours.cpu,
        "within_0.1_percent": _share(mine, best, 1e-3),
        "within_1_percent": _share(mine, best, 1e-2),
        "by_hand_within_0.1_percent": _share(theirs, best[: len(theirs)], 1e-3),
        "by_hand_within_1_percent": _share(theirs, best[: len(theirs)], 1e-2),
        "outcome": outcome,
        "bias_percent": 100.0 * float(np.nanmedian(error)),
        "spread_percent": 100.0 * 1.4826 * float(np.nanmedian(np.abs(error - np.nanmedian(error)))),
        "baseline": "scipy curve_fit, closed form, one process",
    }


def measure_graphical(label: str, *, voxels: int) -> dict[str, object]:
    """One row: Patlak or Logan with errors and status, against a numpy product of the curves with a (K, 2) matrix."""
    problem = fit_problem(voxels=voxels, frames=26, percent=5.0)
    method, choices = find_method(label), Choices(t_star=20.0)

    def fit() -> FitResult:
        return method.fit(problem.curves, problem.arterial, problem.observation, problem.weights, choices, True)

    ours = timed(fit)
    matrix = np.random.default_rng(0).standard_normal((problem.curves.shape[1], 2))
    product = timed(lambda: problem.curves @ matrix)
    return {
        "fit": label,
        "frames": 26,
        "noise_percent": 5.0,
        "voxels": voxels,
        "voxels_per_s": voxels / ours.wall,
        "cpu_us_per_voxel": 1e6 * ours.cpu / voxels,
        "by_hand_cpu_us": 1e6 * product.cpu / voxels,
        "ratio_cpu": product.cpu / ours.cpu,
        "baseline": "one numpy matrix product, no errors, no status",
    }


def _outcome(model: str, problem: FitProblem) -> Array:
    """True VT (1TCM) or Ki of every voxel."""
    values = dict(zip(DRAWN[model], problem.truth.T))
    if model == "1TCM":
        return values["K1"] / values["k2"]
    return values["K1"] * values["k3"] / (values["k2"] + values["k3"])


def _share(costs: Array, best: Array, slack: float) -> float:
    """Percent of curves whose cost lies within `slack` of the lowest that any method here reached."""
    least = np.minimum(best, costs)
    return 100.0 * float(np.mean(costs <= least * (1.0 + slack)))
