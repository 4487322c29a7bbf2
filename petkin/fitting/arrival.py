"""Delay and dispersion of the input at once: the time constant whose correction, with its best delay, fits best.

Both move the input's rise, so each alone carries some of the other. The profile over the time constant refits the delay
everywhere; how far the two trade is reported.

Reference: Meyer E. J Nucl Med 1989;30:1069-1078 (simultaneous correction for tracer arrival delay and dispersion).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.delay import Delay, estimate_delay, parabola_error
from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction
from petkin.kinetics import CompartmentModel

Array = NDArray[np.float64]

#: Time constants tried first, then steps around the best, min.
_COARSE = np.arange(0.0, 17.0, 4.0) / 60.0
_STEPS = 2.0 / 60.0, 1.0 / 60.0
#: Correlation from which on delay and dispersion are not told apart.
_ALIKE = 0.95


@dataclass(frozen=True)
class Arrival:
    """When and how smeared the input arrives.

    Args:
        dispersion: time constant that the input is freed from, min.
        se: its standard error with the delay free, min; NaN at an end of what was tried.
        delay: at that time constant, its error widened by the dispersion's.
        correlation: of both errors, -1 to 1; NaN where unknown.
        told: rise of the cost from the best to no dispersion, in units of the noise.
    """

    dispersion: float
    se: float
    delay: Delay
    correlation: float
    told: float

    @property
    def sentence(self) -> str:
        """What the curves tell of it."""
        error = f" (standard error {60 * self.se:.1g} s)" if np.isfinite(self.se) else ""
        text = f"Dispersion {60 * self.dispersion:.0f} s{error}, estimated with the delay"
        if not np.isfinite(self.se) or self.told < 1.0:
            return text + "; the curves cannot tell it from none, or from the longest tried: give --dispersion."
        if abs(self.correlation) > _ALIKE:
            return text + f"; the two cannot be told apart (correlation {self.correlation:.2f}): give one of them."
        return text + f" (correlation {self.correlation:.2f})."


def estimate_arrival(
    curves: Array,
    freed: Callable[[float], InputFunction],
    observation: FrameObservation,
    weights: Array,
    model: CompartmentModel,
    *,
    rate_bounds: tuple[float, float],
) -> Arrival:
    """Delay and dispersion at which `model` with free blood volume fits best.

    Args:
        curves: frame values of the whole brain (K,), or of regions (N, K), kBq/mL.
        freed: the input freed from a dispersion of so many minutes; 0 leaves it as sampled.
        observation, weights, model, rate_bounds: as for `estimate_delay`.
    """
    found: dict[float, Delay] = {}

    def totals(taus: Array) -> tuple[Array, Array]:
        for tau in taus[(taus >= 0.0) & (taus <= _COARSE[-1])]:
            if float(tau) not in found:
                arterial = freed(float(tau))
                found[float(tau)] = estimate_delay(
                    curves, arterial, observation, weights, model, rate_bounds=rate_bounds
                )
        tried = np.array(sorted(found))
        each = np.stack([found[tau].costs for tau in tried])
        freedom = int(np.count_nonzero(weights)) - len(model.parameters) - 2
        return tried, (each * (freedom / np.maximum(each.min(axis=0), 1e-300))).sum(axis=1)

    tried, cost = totals(_COARSE)
    for step in _STEPS:
        tried, cost = totals(np.round(tried[np.argmin(cost)] + np.array([-step, step]), 12))
    best = int(np.argmin(cost))
    se, delay = parabola_error(tried, cost, best), found[tried[best]]
    if best in (0, len(tried) - 1) or not np.isfinite(se):
        return Arrival(float(tried[best]), float("nan"), delay, float("nan"), float(cost[0] - cost[best]))
    around = [found[tried[i]].minutes for i in (best - 1, best + 1)]
    traded = se * (around[1] - around[0]) / (tried[best + 1] - tried[best - 1])
    wide = float(np.hypot(delay.se, traded))
    return Arrival(float(tried[best]), se, replace(delay, se=wide), traded / wide, float(cost[0] - cost[best]))
