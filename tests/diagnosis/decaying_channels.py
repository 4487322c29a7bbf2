"""A simulator without any physiology: channels that decay, watched by one clock; and what may be missing in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import Coordinates, Hypothesis, Profiles, Shape, Term

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DecayingChannels:
    """y_c(t) = A_c e^{-b_c (t - delay)}, with A and b in logarithms."""

    channels: tuple[str, ...] = ("a", "b", "c", "d")
    count: int = 50
    accuracy: float = 1e-9
    common_factor: bool = False

    @property
    def times(self) -> Array:
        return np.linspace(0.2, 10.0, self.count)

    @property
    def own(self) -> Coordinates:
        return Coordinates(("A", "b"), np.log([5.0, 0.3]), np.array([1.0, 1.0]), np.full(2, 1e-5))

    @property
    def shared(self) -> Coordinates:
        return Coordinates((), np.zeros(0), np.zeros(0), np.zeros(0))

    @property
    def starts(self) -> tuple[Array, ...]:
        return (np.tile(self.own.mean, (len(self.channels), 1)),)

    def predict(self, own: Array, shared: Array, terms: tuple[Term, ...] = ()) -> Array:
        A, b = np.exp(own[..., 0, None]), np.exp(own[..., 1, None])
        values = A * np.exp(-b * self.times)
        for term in terms:
            values = CHANGES[term.hypothesis.name](values, self.times, np.asarray(term.amplitude), term.setting)
        return values

    def driven(self, own: Array, shared: Array, courses: Callable[[Array], Array]) -> Array:
        return np.zeros((0, len(self.channels), len(self.times)))

    def departing(self, values: Array) -> tuple[Profiles, ...]:
        return (Profiles.of_values(values),)

    def unsure(self, own: Array, shared: Array) -> Array:
        return np.zeros((0, len(self.channels), len(self.times)))

    def spread(self, values: Array) -> Array:
        return np.ones_like(values)

    def uneven(self, values: Array) -> Array:
        return np.zeros((0, *values.shape))

    def flexible(self, shared: Array) -> Array:
        return np.exp(-np.geomspace(0.01, 3.0, 12)[:, None] * self.times)


CHANGES = {
    "offset": lambda y, t, a, s: y + a,
    "scale": lambda y, t, a, s: y * (1.0 + a),
    "step": lambda y, t, a, s: y * (1.0 + a * (t >= s["onset"])),
    "local step": lambda y, t, a, s: y + a[..., None] * (t >= s["onset"]),
    "local gain": lambda y, t, a, s: y * (1.0 + a[..., None] * (t >= s["onset"])),
    "averaged step": lambda y, t, a, s: y * (1.0 + a * np.clip((t - s["onset"]) / (t[1] - t[0]) + 0.5, 0.0, 1.0)),
    "ripple": lambda y, t, a, s: y + a * np.sin(s["pitch"] * t),
    "clipped": lambda y, t, a, s: np.minimum(y, 3.0),
}
_ONSETS = tuple({"onset": float(t)} for t in np.arange(1.0, 9.5, 0.5))
HYPOTHESES = (
    Hypothesis("offset", "sensor", "offset", "V", -1.0, 1.0),
    Hypothesis("scale", "sensor", "gain", "1", -0.2, 0.2),
    Hypothesis("step", "sensor", "gain", "1", -0.5, 0.5, settings=_ONSETS),
    Hypothesis("local step", "sensor", "jump", "V", -1.0, 1.0, settings=_ONSETS, by_channel=True),
    Hypothesis(
        "ripple",
        "source",
        "size",
        "V",
        0.0,
        1.0,
        settings=({"pitch": 1.5}, {"pitch": 3.0}),
        shapes=(Shape("pitch", 0.5, 6.0),),
    ),
    Hypothesis("clipped", "sensor", "flag", "flag", 0.0, 1.0, flag=True),
)
#: Sets in at any time: a sample during which it does has it in part, so that there is a kink between two samples.
_KINKED = Shape("onset", 0.5, 9.5, sd=np.inf, kinked=True)
AVERAGED = Hypothesis("averaged step", "sensor", "gain", "1", -0.5, 0.5, shapes=(_KINKED,))
TRUTH = np.log([[5.0, 0.2], [3.5, 0.4], [6.0, 0.3], [2.5, 0.15]])


def measured(rng: np.random.Generator, *terms: Term, sd: float = 0.05, share: float = 0.0) -> Array:
    """Data with some of the terms in them, their noise partly common to all channels."""
    simulator = DecayingChannels()
    values = simulator.predict(TRUTH, np.zeros(0), terms)
    alone, common = rng.standard_normal(values.shape), rng.standard_normal(values.shape[1])
    return values + sd * (np.sqrt(1 - share) * alone + np.sqrt(share) * common)


def hypothesis(name: str) -> Hypothesis:
    return next(h for h in HYPOTHESES if h.name == name)
