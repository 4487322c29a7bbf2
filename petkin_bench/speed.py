"""How fast a fit is against `scipy.optimize.curve_fit` by hand in the same run, and how good both are.

Processor time a voxel is the figure to compare, since other work on the machine disturbs it least. A ratio is the
processor time of a voxel by hand over that of petkin, one thread each: what one core does against what one core does.
Voxels a second are by the clock, on all threads.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import VOXELS, FitResult, NonlinearSettings, fit_curves
from petkin.kinetics import compartment_model
from petkin_bench.by_hand import FASTEST_RATE, best_costs, costs_of, fit_by_hand
from petkin_bench.problems import DRAWN, FitProblem, fit_problem
from petkin_bench.timing import measure, side_by_side

Array = NDArray[np.float64]

#: (model, frames, noise percent) of every row.
PROBLEMS = (("2TCM", 26, 15.0), ("2TCM", 26, 5.0), ("2TCM", 80, 15.0), ("2TCM3k", 26, 5.0), ("1TCM", 26, 5.0))
#: Curves that a baseline is timed on at once, so that a median of repeats can be taken.
_BATCHES = 4


def measure_model(
    model: str, *, frames: int, percent: float, voxels: int, by_hand: int, judged: int
) -> dict[str, object]:
    """One row: speed of petkin's voxel fit with and without standard errors, ratio to by hand, quality of both.

    Args:
        model: 2TCM, 2TCM3k or 1TCM.
        frames, percent, voxels: the problem, see `fit_problem`.
        by_hand: curves fitted with curve_fit.
        judged: curves whose best known cost is worked out.
    """
    problem = fit_problem(voxels=voxels, frames=frames, percent=percent, model=model)
    curves = as_read(problem)
    ours, bare = side_by_side(lambda: petkin_fit(problem, curves), lambda: petkin_fit(problem, curves, errors=False))
    result = petkin_fit(problem, curves)
    fitted = np.stack([result[symbol] for symbol in DRAWN[model]], axis=1).astype(np.float64)
    hand, hand_cpu = _by_hand(problem, by_hand)
    best = best_costs(problem, judged, trapped=model == "2TCM3k", single=model == "1TCM")
    return {
        "fit": model,
        "frames": frames,
        "noise_percent": percent,
        "voxels": voxels,
        "voxels_per_s": voxels / measure(lambda: petkin_fit(problem, curves)).wall,
        "cpu_us_per_voxel": 1e6 * ours.cpu / voxels,
        "cpu_us_without_errors": 1e6 * bare.cpu / voxels,
        "by_hand_cpu_us": 1e6 * hand_cpu,
        "ratio_cpu": hand_cpu * voxels / ours.cpu,
        **_shares("", costs_of(problem, fitted[:judged]), best),
        **_shares("by_hand_", costs_of(problem, hand[:judged]), best[:by_hand]),
        "outcome": "VT" if model == "1TCM" else "Ki",
        **_errors("", model, fitted, problem.truth),
        **_errors("by_hand_", model, hand, problem.truth[:by_hand]),
        "baseline": "scipy curve_fit, closed form, one process",
    }


def petkin_fit(problem: FitProblem, curves: NDArray[np.floating], *, errors: bool = True) -> FitResult:
    """The public call as a study makes it for voxels, with the rates that the best known costs may use."""
    settings = NonlinearSettings(
        compartment_model(problem.model),
        rate_bounds=(0.0, FASTEST_RATE),
        effort=VOXELS,
        keep_predicted=False,
        standard_errors=errors,
    )
    return fit_curves(curves, problem.arterial, problem.observation, problem.weights, settings)


def as_read(problem: FitProblem) -> NDArray[np.float32]:
    """Curves (N, K) as they come out of an image: single precision, the voxels of a frame side by side."""
    return np.ascontiguousarray(problem.curves.T, np.float32).T


def _by_hand(problem: FitProblem, count: int) -> tuple[Array, float]:
    """Parameters (count, P) found by hand, and processor seconds a curve: the median over a few batches."""
    symbols = DRAWN[problem.model]
    fit_by_hand(problem, symbols, slice(0, 2))
    edges = np.linspace(0, count, min(_BATCHES, count) + 1).astype(int)
    found: list[Array] = []
    seconds = []
    for first, last in pairwise(edges):
        part = slice(int(first), int(last))
        timing = measure(
            lambda part=part: found.append(fit_by_hand(problem, symbols, part).parameters), 1, warm_up=False
        )
        seconds.append(timing.cpu / (last - first))
    return np.concatenate(found), float(np.median(seconds))


def _shares(prefix: str, costs: Array, best: Array) -> dict[str, float]:
    """Percent of curves whose cost lies within 0.1 and 1 % of the lowest that any method here reached."""
    best = best[: len(costs)]
    least = np.minimum(best, costs)
    return {
        f"{prefix}within_{name}_percent": 100.0 * float(np.mean(costs <= least * (1.0 + slack)))
        for name, slack in (("0.1", 1e-3), ("1", 1e-2))
    }


def _errors(prefix: str, model: str, found: Array, truth: Array) -> dict[str, float]:
    """Median and robust standard deviation (1.4826 median absolute deviation) of relative errors, percent."""
    answer = {}
    for name, quantity in (("K1_", _K1), ("", _total_volume if model == "1TCM" else _net_influx)):
        with np.errstate(all="ignore"):
            relative = 100.0 * (quantity(found) / quantity(truth) - 1.0)
        bias = float(np.nanmedian(relative))
        answer[f"{prefix}{name}bias_percent"] = bias
        answer[f"{prefix}{name}spread_percent"] = 1.4826 * float(np.nanmedian(np.abs(relative - bias)))
    return answer


def _K1(parameters: Array) -> Array:
    return parameters[:, 0]


def _total_volume(parameters: Array) -> Array:
    return parameters[:, 0] / parameters[:, 1]


def _net_influx(parameters: Array) -> Array:
    return parameters[:, 0] * parameters[:, 2] / (parameters[:, 1] + parameters[:, 2])
