"""The time between the arrival of blood where it was sampled and in the brain: of one curve, or of many at once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import Shifted
from petkin.errors import InputError
from petkin.fitting.search import REGIONS, search_exponentials
from petkin.fitting.table import BasisTable, build_table, compress, project_rows
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
        profile: delays tried (min) and their weighted sums of squares over the noise variance, summed over the curves,
            ascending in delay.
        costs: weighted sum of squares of every curve at the best delay (N,).
    """

    minutes: float
    se: float
    at_end: bool
    profile: tuple[Array, Array]
    costs: Array


def estimate_delay(
    curves: Array,
    arterial: InputFunction,
    observation: FrameObservation,
    weights: Array,
    model: CompartmentModel,
    *,
    rate_bounds: tuple[float, float],
) -> Delay:
    """The delay at which `model` with free blood volume fits best; all else is refitted at every delay.

    Each of several curves counts by its own noise, taken from its best fit at any delay.

    Args:
        curves: frame values of the whole brain (K,), or of regions (N, K), kBq/mL.
        arterial: input function as sampled.
        observation: what frames report.
        weights: frame weights (K,).
        model: compartment model.
        rate_bounds: interval of the rates, 1/min.

    Raises:
        InputError: a curve holds a value that is not a number, or too few frames have weight.

    Reference: Meyer E. J Nucl Med 1989;30:1069-1078 (simultaneous correction for tracer arrival delay and dispersion).
    """
    freedom = int(np.count_nonzero(weights)) - len(model.parameters) - 1
    curves = np.atleast_2d(curves)
    if not np.isfinite(curves).all() or freedom < 1:
        raise InputError(
            "The whole-brain curve must hold numbers in all frames, and "
            f"{len(model.parameters) + 2} of them with weight, for its delay: check the mask, or give the delay."
        )
    centre = 0.5 * (SPAN[0] + SPAN[1])
    tried, each = np.empty(0), np.empty((0, len(curves)))
    for reach, step in _GRIDS:
        grid = centre + step * np.arange(-round(reach / step), round(reach / step) + 1)
        grid = np.asarray(np.clip(grid, *SPAN), np.float64)
        tried = np.concatenate([tried, grid])
        each = np.concatenate([each, _costs(grid, curves, arterial, observation, weights, model, rate_bounds)])
        centre = tried[np.argmin(_over_noise(each, freedom))]
    tried, first = np.unique(tried, return_index=True)
    costs = _over_noise(each[first], freedom)
    best = int(np.argmin(costs))
    at_end = best in (0, len(tried) - 1)
    return Delay(float(tried[best]), parabola_error(tried, costs, best), at_end, (tried, costs), each[first][best])


def _over_noise(each: Array, freedom: int) -> Array:
    """Costs (D,) from those of every curve (D, N), each over its noise variance at its own best delay."""
    return (each * (freedom / np.maximum(each.min(axis=0), 1e-300))).sum(axis=1)


def parabola_error(tried: Array, costs: Array, best: int) -> float:
    """Half width of the cost at 1 above its minimum, from the nearest points that lie higher, by a parabola."""
    reached = np.flatnonzero(costs - costs[best] >= 1.0)
    left, right = reached[reached < best], reached[reached > best]
    if best in (0, len(tried) - 1) or left.size == 0 or right.size == 0:
        return float("nan")
    widths = [abs(tried[i] - tried[best]) / np.sqrt(costs[i] - costs[best]) for i in (left[-1], right[0])]
    return float(np.mean(widths))


def _costs(
    delays: Array,
    curves: Array,
    arterial: InputFunction,
    observation: FrameObservation,
    weights: Array,
    model: CompartmentModel,
    rate_bounds: tuple[float, float],
) -> Array:
    """Least weighted sums of squares of every delay and curve (D, N)."""
    late = replace(arterial, plasma=Shifted(arterial.plasma, delays), whole_blood=Shifted(arterial.whole_blood, delays))
    slow = 0.0 if model.trapping else rate_bounds[0]
    tables = build_table(late, observation, rate_bounds=(slow, rate_bounds[1]), nodes=_EFFORT.nodes)
    sizes = (weights * curves**2).sum(axis=1)
    costs = np.empty((len(delays), len(curves)))
    for i in range(len(delays)):
        one = BasisTable(tables.u, tables.basis[:, i], tables.slope[:, i], tables.blood[i])
        packed = compress(one, weights, tolerance=1e-7)
        z = project_rows(packed.project, curves)
        costs[i] = search_exponentials(model, packed, z, sizes, _EFFORT, blood=True).cost
    return costs
