"""Moving bodies as the engine of diagnosis sees them: channels are trials, samples the places of points in pictures.

A trial has a start of its own; the law's parameters are shared. An effect changes the acceleration, the walls, the
clock or the camera, each by its amplitude, which is 0 where it is absent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import helmert
from scipy.special import comb

from petkin.diagnosis import Coordinates, Hypothesis, Profiles, Shape, Term
from petkin_bench.gaps.stepping import all_travelled, speeds_alone

Array = NDArray[np.float64]
Effects = Mapping[str, Term]
#: (time, places, speeds, parameters, sizes, accelerations), compiled; the last (n,) is what it fills.
Law = Callable[[float, Array, Array, Array, Any, Array], None]
#: (places, speeds, rates of the places), compiled; the last (n,) is what it fills.
Rate = Callable[[Array, Array, Array], None]

#: Median of |x| of a standard normal x.
_NORMAL = 0.6745
#: Standard deviation of a start's prior: none to speak of.
_WIDE = 20.0
_STEP = 1e-5
#: Frames that a start is read off, at least the last; standard deviations that chi-square is seldom above its mean.
_FRAMES, _SELDOM = (15, 10, 7, 5), 4.0
#: What a law between walls is asked for, whether or not a catalogue has it.
_WALLS = ("restitution", "wall_friction")
#: Cosines of the flexible fit, of either sign, a coordinate.
_COSINES = 14


def size(effects: Effects, name: str) -> Any:
    """Amplitude of an effect; 0 where it is absent."""
    return effects[name].amplitude if name in effects else 0.0


@dataclass(frozen=True)
class Body:
    """A system that moves.

    Args:
        name: as in reports.
        states: symbols of a start, places before speeds.
        parameters: symbols of the law's parameters, with mean and sd of their prior.
        law: acceleration.
        points: places (..., n) -> points in the picture (..., P, 2).
        pose: points (T, P, 2) -> places (T, n).
        hypotheses: its catalogue.
        interval: time between frames, s.
        frames: how many.
        wall: places are reflected at +-wall; 0 for none.
        steps: of the integration, a frame.
        rate: of the places, where it is not the speeds.
        speeds: places and their rates -> speeds, the other way round.
    """

    name: str
    states: tuple[str, ...]
    parameters: tuple[tuple[str, str, float, float], ...]
    law: Law
    points: Callable[[Array], Array]
    pose: Callable[[Array], Array]
    hypotheses: tuple[Hypothesis, ...]
    interval: float
    frames: int
    wall: float = 0.0
    steps: int = 1
    rate: Rate = speeds_alone
    speeds: Callable[[Array, Array], Array] = lambda place, rate: rate

    @property
    def dimensions(self) -> int:
        return len(self.states) // 2

    @property
    def shown(self) -> int:
        """Points in a picture."""
        return self.points(np.zeros((1, self.dimensions))).shape[-2]

    def sizes(self, effects: Effects) -> Any:
        """Sizes and settings by name, as a law asks for them; nought of what is absent."""
        settings = [symbol for h in self.hypotheses for symbol in h.settings[0]]
        names = dict.fromkeys([*(h.name for h in self.hypotheses), *_WALLS, *settings])
        found = np.zeros((), [(name, np.float64) for name in names])
        for name, term in effects.items():
            found[name] = term.amplitude
            for symbol, value in term.setting.items():
                found[symbol] = value
        return found[()]

    def begun(self, points: Array) -> tuple[Array, Array]:
        """Places and speeds (2 n,) at the first of the points (T, P, 2), of two parabolas: one through as many frames
        as show no more than noise beside it, and one through many, where noise has wild values."""
        noise = _noise(points, 0)
        places = self.pose(points[: _FRAMES[0]])
        found = []
        for count in _FRAMES:
            frames = np.arange(count) * self.interval
            found.append(np.polynomial.polynomial.polyfit(frames, places[:count], 2))
            there = self.points(np.polynomial.polynomial.polyval(frames, found[-1]).T)
            off, free = ((points[:count] - there) ** 2).sum(), count * there[0].size - 3 * self.dimensions
            if off <= noise**2 * (free + _SELDOM * np.sqrt(2.0 * free)) + 1e-12:
                break
        short, long = (np.concatenate([c[0], self.speeds(c[0], c[1])]) for c in (found[-1], found[0]))
        return short, long


@dataclass(frozen=True)
class MovingBodies:
    """A body in several trials.

    Args:
        body: which.
        data: places of its points in pictures (trials, P 2 T), for the starts of fits and for the noise that all
            points of a picture have in common.

    The samples of a trial are not places of points but their mean over the points of a picture and what lies across it:
    a camera that shakes moves all points of a picture alike, and noise in these is independent.
    """

    body: Body
    data: Array

    @property
    def samples(self) -> Array:
        """The data as samples (trials, P 2 T)."""
        return self._mixed(self.data)

    def places(self, samples: Array) -> Array:
        """Samples as places in pictures (trials, P 2 T)."""
        return self._mixed(samples, back=True)

    def _mixed(self, places: Array, back: bool = False) -> Array:
        """Places (..., P 2 T) as samples, or the other way round."""
        axes = helmert(self._points, full=True)
        seen = places.reshape(*places.shape[:-1], self._points, -1)
        return np.asarray(((axes.T if back else axes) @ seen).reshape(places.shape), np.float64)

    @property
    def _points(self) -> int:
        return self.body.shown

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(f"trial {i + 1}" for i in range(len(self.data)))

    @property
    def clock(self) -> Array:
        """Times of the frames (T,)."""
        return np.asarray(np.arange(self.body.frames) * self.body.interval, np.float64)

    @property
    def times(self) -> Array:
        return np.tile(self.clock, 2 * self._points)

    @property
    def accuracy(self) -> float:
        return 1e-4

    @property
    def common_factor(self) -> bool:
        return False

    @property
    def own(self) -> Coordinates:
        count = len(self.body.states)
        return Coordinates(self.body.states, np.zeros(count), np.full(count, _WIDE), np.full(count, _STEP))

    @property
    def shared(self) -> Coordinates:
        symbols, _, mean, sd = zip(*self.body.parameters)
        return Coordinates(symbols, np.array(mean), np.array(sd), np.full(len(mean), _STEP))

    @property
    def starts(self) -> tuple[Array, ...]:
        return self._starts

    @cached_property
    def _starts(self) -> tuple[Array, ...]:
        seen = self.data.reshape(len(self.data), -1, 2, self.body.frames)
        points = np.moveaxis(seen, -1, 1)
        short, long = (np.stack(each) for each in zip(*map(self.body.begun, points), strict=True))
        return short, long

    def predict(self, own: Array, shared: Array, terms: tuple[Term, ...] = ()) -> Array:
        effects = {term.hypothesis.name: term for term in terms}
        places = travelled(self.body, own, shared, effects)
        points = seen(self.body.points(places), self.body.interval, effects)
        return self._mixed(np.moveaxis(points, -3, -1).reshape(*own.shape[:-1], -1))

    def driven(self, own: Array, shared: Array, courses: Callable[[Array], Array]) -> Array:
        return np.zeros((0, len(self.channels), len(self.times)))

    def departing(self, values: Array) -> tuple[Profiles, ...]:
        """Pictures that are shifted, turned or larger, come early or late, or points that go ways of their own."""
        seen = self.places(values).reshape(len(values), -1, 2, self.body.frames)
        x, y = seen[:, :, 0], seen[:, :, 1]
        one, none = np.ones_like(x), np.zeros_like(x)
        ways = ((one, none), (none, one), (-y, x), (x, y), tuple(np.gradient(each, axis=-1) for each in (x, y)))
        alone = [self._mixed(np.stack(way, axis=2).reshape(1, *values.shape)) for way in ways]
        blocks = np.repeat(np.eye(2 * seen.shape[1]), self.body.frames, axis=1)
        every = np.repeat(blocks[:, None], len(values), axis=1)
        return tuple(Profiles(each, each) for each in (*alone, every))

    def unsure(self, own: Array, shared: Array) -> Array:
        return np.zeros((0, len(self.channels), len(self.times)))

    def spread(self, values: Array) -> Array:
        """Larger along the mean over points, as far as the data are rougher there."""
        found = np.ones_like(values)
        if self._points > 1:
            rough = self.samples.reshape(len(self.data), self._points, 2, -1)
            found[:, : 2 * self.body.frames] = _noise(rough[:, :1], -1) / max(_noise(rough[:, 1:], -1), 1e-12)
        return found

    def uneven(self, values: Array) -> Array:
        return np.zeros((0, *values.shape))

    def flexible(self, shared: Array) -> Array:
        blocks = 2 * self._points
        cosines = np.cos(np.pi * np.arange(_COSINES)[:, None] * np.linspace(0.0, 1.0, self.body.frames))
        alone = np.kron(np.eye(blocks), cosines)
        return np.asarray(np.concatenate([alone, -alone]), np.float64)


def _noise(values: Array, axis: int) -> float:
    """Standard deviation of noise by sixth differences along an axis, which hardly see motion; bounces are few."""
    return float(np.median(np.abs(np.diff(values, n=6, axis=axis))) / (_NORMAL * np.sqrt(comb(12, 6))))


def travelled(body: Body, own: Array, shared: Array, effects: Effects) -> Array:
    """Places at every frame (..., T, n), by Runge-Kutta steps of fourth order that end at walls and go on there."""
    starts = np.ascontiguousarray(own.reshape(-1, own.shape[-1]), np.float64)
    sizes = body.sizes(effects)
    step = body.interval * (1.0 + sizes["frame_rate"]) / body.steps
    found = all_travelled(body.law, body.rate, starts, shared, sizes, step, body.steps, body.frames, body.wall or None)
    return np.asarray(found.reshape(*own.shape[:-1], body.frames, body.dimensions), np.float64)


def seen(points: Array, interval: float, effects: Effects) -> Array:
    """Points (..., T, P, 2) as a camera shows them: exposure, lens, roll, scale, offset."""
    exposure = size(effects, "exposure_blur")
    if np.any(exposure):
        bent = np.gradient(np.gradient(points, axis=-3), axis=-3)
        points = points + exposure**2 / 24.0 * bent
    points = points * (1.0 + size(effects, "lens_distortion") * (points**2).sum(axis=-1, keepdims=True))
    roll = size(effects, "camera_roll")
    x, y = points[..., 0], points[..., 1]
    turned = np.stack([np.cos(roll) * x - np.sin(roll) * y, np.sin(roll) * x + np.cos(roll) * y], axis=-1)
    shift = np.array([size(effects, "camera_offset_x"), size(effects, "camera_offset_y")])
    return turned * (1.0 + size(effects, "camera_scale")) + shift


def hypothesis(name: str, stage: str, unit: str, lower: float, upper: float, split_by: str, **more: Any) -> Hypothesis:
    """An effect of a moving body."""
    return Hypothesis(name, stage, "amplitude", unit, lower, upper, split_by=split_by, **more)


def forcing(unit: str, most: float, *, fast: float = 1.0) -> Hypothesis:
    """A push of unknown size, pitch and phase, which its sign turns round.

    Args:
        unit: of its amplitude.
        most: its plausible size.
        fast: how much faster than some radians a second.
    """
    pitches, phases = np.geomspace(0.8, 5.0, 5) * fast, np.pi * (np.arange(4) + 0.5) / 4.0
    settings = tuple({"pitch": float(f), "phase": float(p)} for f in pitches for p in phases)
    shapes = Shape("pitch", 0.5 * fast, 8.0 * fast, sd=np.inf), Shape("phase", 0.05, np.pi, sd=np.inf)
    return hypothesis("forcing", "dynamics", unit, -most, most, "a longer run", settings=settings, shapes=shapes)


#: What any camera and clock may do; lengths in units of the picture's half.
CAMERA = (
    hypothesis("camera_roll", "observation", "rad", -0.3, 0.3, "a plumb line in the picture"),
    hypothesis("camera_offset_x", "observation", "1", -0.2, 0.2, "a mark at the pivot or the wall"),
    hypothesis("camera_offset_y", "observation", "1", -0.2, 0.2, "a mark at the pivot or the wall"),
    hypothesis("camera_scale", "observation", "1", -0.1, 0.1, "a ruler in the picture"),
    hypothesis("lens_distortion", "observation", "1", -0.1, 0.1, "a picture of a grid"),
    hypothesis("exposure_blur", "observation", "1", 0.0, 1.0, "the shutter's time"),
    hypothesis("frame_rate", "clock", "1", -0.1, 0.1, "a clock in the picture"),
)
