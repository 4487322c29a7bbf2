"""A subject and its scan: three families of blood curves, kinetics, frames. Nothing of the product is used here.

Blood is straight between the samples of the record, which is what the product is given; minutes and kBq/mL.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

Array = NDArray[np.float64]

#: Seconds of every frame: two clinical schedules of which one is drawn, and frames as short as those of simulations.
SCHEDULES_S = {
    "clinical": (
        [10] * 6 + [20] * 6 + [60] * 6 + [180] * 4 + [300] * 14,
        [15] * 8 + [30] * 6 + [60] * 5 + [300] * 16,
    ),
    "short": ([30] * 80,),
}
#: Half-lives of 11C and 18F, min.
HALF_LIVES = (20.364, 109.77)
#: Spread of the logarithm of how noisy a region is.
_UNLIKE = 0.2
_RATES = ((0.06, 0.4), (0.05, 0.3), (0.02, 0.1), (0.01, 0.06))


@dataclass(frozen=True)
class Blood:
    """Total plasma, share of it that is tracer, whole blood; all (T,) at `t`."""

    t: Array
    total: Array
    parent: Array
    whole: Array


@dataclass(frozen=True)
class Frames:
    """Start and end of every frame, min, and the decay constant, 1/min."""

    start: Array
    end: Array
    decay: float

    @property
    def mid(self) -> Array:
        return 0.5 * (self.start + self.end)

    @property
    def counted(self) -> Array:
        """int e^{-decay t} over every frame."""
        return (np.exp(-self.decay * self.start) - np.exp(-self.decay * self.end)) / self.decay


@dataclass(frozen=True)
class Subject:
    """Blood as recorded, rates K1 k2 k3 k4 (R, 4), vB (R,), delay of the tissue (min), frames.

    Regions have several volumes: `noisiness` (R,) is that of each, relative to a usual one.
    """

    blood: Blood
    rates: Array
    vB: Array
    delay: float
    frames: Frames
    noisiness: Array


def draw_subject(rng: np.random.Generator, regions: int, schedules: str = "clinical") -> Subject:
    """One subject of the population."""
    among = SCHEDULES_S[schedules]
    edges = np.concatenate([[0.0], np.cumsum(among[int(rng.integers(len(among)))])]) / 60.0
    frames = Frames(edges[:-1], edges[1:], math.log(2.0) / HALF_LIVES[int(rng.integers(2))])
    rates = np.stack([rng.uniform(*bounds, regions) for bounds in _RATES], axis=1)
    blood = _blood(rng, float(edges[-1]))
    noisiness = np.exp(_UNLIKE * rng.spawn(1)[0].standard_normal(regions))
    return Subject(blood, rates, rng.uniform(0.02, 0.08, regions), rng.uniform(-0.1, 0.35), frames, noisiness)


def _blood(rng: np.random.Generator, end: float) -> Blood:
    t = np.concatenate([np.arange(0.0, 4.0, 1 / 60), np.arange(4.0, 12.0, 1 / 6), np.arange(12.0, end + 3.0, 0.5)])
    since = np.maximum(t - rng.uniform(0.2, 0.8), 0.0)
    total = _FAMILIES[int(rng.integers(len(_FAMILIES)))](rng, since) * rng.uniform(40.0, 90.0)
    parent = 1.0 / (1.0 + (t / rng.uniform(15.0, 45.0)) ** rng.uniform(1.1, 1.9))
    ratio = rng.uniform(0.6, 0.75) + rng.uniform(0.0, 0.2) * t / (t + 20.0)
    return Blood(t, total, parent, total * ratio)


def _gamma_rise(rng: np.random.Generator, s: Array) -> Array:
    """A gamma-variate first pass and three exponentials that rise with its area."""
    peak, power = rng.uniform(0.3, 0.5), rng.uniform(1.5, 3.0)
    first = (s / peak) ** power * np.exp(power * (1.0 - s / peak))
    arrived = 1.0 - np.exp(-s / peak)
    return first + arrived * _tail(rng, s)


def _tail(rng: np.random.Generator, s: Array) -> Array:
    fast, middle, slow = rng.uniform(0.8, 1.6), rng.uniform(0.1, 0.25), rng.uniform(0.004, 0.012)
    high, level, low = rng.uniform(0.1, 0.25), rng.uniform(0.05, 0.12), rng.uniform(0.04, 0.1)
    return high * np.exp(-fast * s) + level * np.exp(-middle * s) + low * np.exp(-slow * s)


def _infusion(rng: np.random.Generator, s: Array) -> Array:
    """A bolus followed by a slow infusion, which fades after two thirds of the scan."""
    bolus = _gamma_rise(rng, s)
    slow = rng.uniform(0.02, 0.08) * (1.0 - np.exp(-s / rng.uniform(15.0, 30.0)))
    return bolus + slow * np.exp(-np.maximum(s - 0.66 * s[-1], 0.0) / 10.0)


def _spline(rng: np.random.Generator, s: Array) -> Array:
    """A monotone spline through the logarithm of a few levels, after a straight rise."""
    rise = rng.uniform(0.3, 0.6)
    knots = np.array([0.0, 0.4, 1.2, 4.0, 12.0, 30.0, 60.0, 120.0])
    least = np.array([0.5, 0.5, 0.4, 0.3, 0.2, 0.15, 0.2])
    falls = np.cumsum(np.concatenate([[0.0], rng.uniform(least, 2.2 * least)]))
    after = np.maximum(s - rise, 0.0)
    return np.where(s < rise, s / rise, np.exp(-PchipInterpolator(knots, falls)(after)))


_FAMILIES = (_gamma_rise, _infusion, _spline)
