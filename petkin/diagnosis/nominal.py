"""The simulator as it is: its best fit, and the noise about it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.effect import Simulator
from petkin.diagnosis.noise import first_floor, from_flexible, levels, outlying
from petkin.diagnosis.refit import Fit, State, refit

Array = NDArray[np.float64]
#: What `base_fit` finds: the simulator's fit, the noise, and what a flexible fit took and left of every channel.
Base = tuple[Fit, Noise, list[Array], Array]


def base_fit(simulator: Simulator, data: Array) -> Base:
    """The simulator's own best fit, the noise, what the flexible fit took, and its residual, wild values as they are.

    Two rounds: the second weighs by the values that the first predicts.
    """
    spread = simulator.spread(np.maximum(data, 0.0))
    bends = np.diff(data / spread, n=2, axis=1) / np.sqrt(6.0)
    size = np.full(len(data), np.median(np.abs(bends)) / 0.6745)
    noise = Noise(spread, np.maximum(size, 1e-9 * np.abs(data / spread).max()), 0.0)
    shared = simulator.shared.start
    fits = [refit(simulator, data, noise, State(own, shared)) for own in simulator.starts]
    base = min(fits, key=lambda f: f.objective)
    flexible = from_flexible(data, spread, simulator.flexible(base.state.shared))
    wild = np.ones_like(spread)
    for _ in range(2):
        plain = simulator.spread(np.maximum(base.values, 0.0))
        wild = outlying(flexible[0] * spread / plain)
        spread = plain * wild
        flexible = from_flexible(data, spread, simulator.flexible(base.state.shared))
        least = least_noise(simulator, base.values, spread)
        level, factor = levels(base.values, spread), simulator.common_factor
        noise = first_floor((data - base.values) / spread, spread, flexible, level, least, factor=factor)
        errors = simulator.unsure(base.state.own, base.state.shared)
        noise = replace(noise, errors=errors, uneven=simulator.uneven(np.maximum(base.values, 0.0)))
        base = refit(simulator, data, noise, base.state)
    loose, freedom, bases = flexible
    size = np.sqrt((loose**2).sum(axis=1) / freedom)[:, None]
    return base, noise, bases, loose * wild / size


def least_noise(simulator: Simulator, values: Array, spread: Array) -> Array:
    """Size of noise (C,) as small as the simulator's numerical errors."""
    return simulator.accuracy * np.median(np.abs(values) / spread, axis=1) + 1e-300
