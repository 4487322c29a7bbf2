"""The time between the arrival of blood where it was sampled and in the brain, from one curve of the whole brain."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from petkin.dynamics import Shifted
from petkin.errors import InputError
from petkin.fitting.search import REGIONS, search_exponentials
from petkin.fitting.table import BasisTable, build_table, compress
from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction
from petkin.kinetics import CompartmentModel

Array = NDArray[np.float64]

#: Delays looked at, min: arteries at the wrist run late against the brain, sampling lines later still.
SPAN = (-1.0, 1.5)
_GRIDS = ((SPAN[1] - SPAN[0]) / 2, 0.1), (0.1, 0.02), (0.02, 0.004), (0.004, 0.001)
#: Cheap and exact enough to rank delays.
_EFFORT = replace(REGIONS, nodes=48, coarse=24, tolerance=1e-9, refine=False)


@dataclass(frozen=True)
class Delay:
    """An estimated delay.

    Args:
        minutes: input arrives this much later in the tissue than the samples say (negative: earlier), min.
        se: its standard error from the curvature of the cost, min; NaN at an end of the span.
        at_end: whether it ran into an end of the span and is not to be trusted.
        profile: delays tried (min) and their weighted sums of squares, ascending in delay.
    """

    minutes: float
    se: float
    at_end: bool
    profile: tuple[Array, Array]


def estimate_delay(
    curve: Array,
    arterial: InputFunction,
    observation: FrameObservation,
    weights: Array,
    model: CompartmentModel,
    *,
    rate_bounds: tuple[float, float],
) -> Delay:
    """The delay at which `model` with free blood volume fits one curve best; all else is refitted at every delay.

    Args:
        curve: frame values of the whole brain (K,), kBq/mL.
        arterial: input function as sampled.
        observation: what frames report.
        weights: frame weights (K,).
        model: compartment model.
        rate_bounds: interval of the rates, 1/min.

    Raises:
        InputError: the curve holds a value that is not a number, or too few frames have weight.

    Reference: Meyer E. J Nucl Med 1989;30:1069-1078 (simultaneous correction for tracer arrival delay and dispersion).
    """
    freedom = int(np.count_nonzero(weights)) - len(model.parameters) - 1
    if not np.isfinite(curve).all() or freedom < 1:
        raise InputError(
            "The whole-brain curve must hold numbers in all frames, and "
            f"{len(model.parameters) + 2} of them with weight, for its delay: check the mask, or give the delay."
        )
    centre = 0.5 * (SPAN[0] + SPAN[1])
    tried, costs = np.empty(0), np.empty(0)
    for reach, step in _GRIDS:
        grid = centre + step * np.arange(-round(reach / step), round(reach / step) + 1)
        grid = np.asarray(np.clip(grid, *SPAN), np.float64)
        tried = np.concatenate([tried, grid])
        costs = np.concatenate([costs, _costs(grid, curve, arterial, observation, weights, model, rate_bounds)])
        centre = tried[np.argmin(costs)]
    tried, first = np.unique(tried, return_index=True)
    costs = costs[first]
    best = int(np.argmin(costs))
    at_end = best in (0, len(tried) - 1)
    return Delay(float(tried[best]), _error(tried, costs, best, freedom), at_end, (tried, costs))


def _error(tried: Array, costs: Array, best: int, freedom: int) -> float:
    """Half width of the cost at s^2 above its minimum, from the nearest points that lie higher, by a parabola."""
    s2 = costs[best] / max(freedom, 1)
    reached = np.flatnonzero(costs - costs[best] >= s2)
    left, right = reached[reached < best], reached[reached > best]
    if best in (0, len(tried) - 1) or left.size == 0 or right.size == 0:
        return float("nan")
    widths = [abs(tried[i] - tried[best]) / np.sqrt((costs[i] - costs[best]) / s2) for i in (left[-1], right[0])]
    return float(np.mean(widths))


def _costs(
    delays: Array,
    curve: Array,
    arterial: InputFunction,
    observation: FrameObservation,
    weights: Array,
    model: CompartmentModel,
    rate_bounds: tuple[float, float],
) -> Array:
    batch = torch.tensor(delays)
    late = replace(arterial, plasma=Shifted(arterial.plasma, batch), whole_blood=Shifted(arterial.whole_blood, batch))
    slow = 0.0 if model.trapping else rate_bounds[0]
    tables = build_table(late, observation, rate_bounds=(slow, rate_bounds[1]), nodes=_EFFORT.nodes)
    size = np.array([np.sum(weights * curve**2)])
    costs = np.empty(len(delays))
    for i in range(len(delays)):
        one = BasisTable(tables.u, tables.basis[:, i], tables.slope[:, i], tables.blood[i])
        packed = compress(one, weights, tolerance=1e-7)
        costs[i] = search_exponentials(model, packed, packed.project @ curve[:, None], size, _EFFORT, blood=True).cost[
            0
        ]
    return costs
