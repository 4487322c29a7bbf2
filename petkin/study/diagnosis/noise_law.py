"""Laws by which frame values may scatter: how the size of the noise goes with the value, with time, with the frame."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from petkin.imaging import FrameObservation

Array = NDArray[np.float64]

#: Floor of a frame's expected value, as a share of the region's highest.
_FLOOR = 0.02


class NoiseLaw(NamedTuple):
    """Exponents a, b, c of sd^2 = value^a e^{b lambda t} / duration^c, of values that are corrected for decay.

    Those of counts are 1, 1, 1; where noise has one size they are 0, 0, 0, and of a percentage of the value 2, 0, 0.
    """

    value: float = 1.0
    decay: float = 1.0
    duration: float = 1.0

    def __str__(self) -> str:
        if self == COUNTS:
            return "variance as of counts: value e^(lambda t) / duration"
        value, decay, duration = (f"{round(exponent, 1) + 0.0:g}" for exponent in self)
        return f"variance as value^{value} e^({decay} lambda t) / duration^{duration}, not as of counts (1, 1, 1)"

    def spread(self, values: Array, clock: FrameObservation) -> Array:
        """sd of counts (R, K), sqrt(max(f, floor) e^{lambda t} / d) of a value corrected for decay; by another law as
        large in the median frame of a region."""
        spread = np.sqrt(_level(values) / clock.mean_decay_times_duration)
        if self == COUNTS:
            return spread
        apart = np.subtract(self, COUNTS)[:, None, None] * contrasts(values, clock)
        return np.asarray(spread * np.exp(apart.sum(axis=0)), np.float64)


#: How counts scatter.
COUNTS = NoiseLaw()


def terms(values: Array, clock: FrameObservation) -> Array:
    """What an exponent of the law multiplies in ln sd (3, R, K): half of ln value, lambda t and -ln duration."""
    level, duration = _level(values), clock.frames.duration
    parts = (level, duration / clock.mean_decay_times_duration, 1.0 / duration)
    return 0.5 * np.log(np.maximum(np.stack([np.broadcast_to(part, level.shape) for part in parts]), 1e-300))


def contrasts(values: Array, clock: FrameObservation) -> Array:
    """`terms` less those of a region's median frame."""
    each = terms(values, clock)
    return each - np.median(each, axis=-1, keepdims=True)


def _level(values: Array) -> Array:
    return np.asarray(np.maximum(values, _FLOOR * values.max(axis=1, keepdims=True)), np.float64)
