"""Moving bodies as the engine of diagnosis sees them: channels are trials, samples the places of points in pictures.

A trial has a start of its own; the law's parameters are shared. An effect changes the acceleration, the walls, the
clock or the camera, each by its amplitude, which is 0 where it is absent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import Coordinates, Hypothesis, Term

Array = NDArray[np.float64]
Effects = Mapping[str, Term]
#: (time, places, speeds, parameters, effects) -> acceleration, all of them (..., n).
Law = Callable[[float, Array, Array, Array, Effects], Array]
#: (places, speeds) -> rates of the places.
Rate = Callable[[Array, Array], Array]

#: Standard deviation of a start's prior: none to speak of.
_WIDE = 20.0
_STEP = 1e-5
#: Cosines of the flexible fit, of either sign, a coordinate.
_COSINES = 14


def size(effects: Effects, name: str) -> Any:
    """Amplitude of an effect; 0 where it is absent."""
    return effects[name].amplitude if name in effects else 0.0


def _speeds(_: Array, v: Array) -> Array:
    return v


@dataclass(frozen=True)
class Body:
    """A system that moves.

    Args:
        name: as in reports.
        states: symbols of a start, places before speeds.
        parameters: symbols of the law's parameters, with mean and sd of their prior.
        law: acceleration.
        points: places (..., n) -> points in the picture (..., P, 2).
        start: points of the first frames (T, P, 2) and the time between them -> places and speeds.
        hypotheses: its catalogue.
        interval: time between frames, s.
        frames: how many.
        wall: places are reflected at +-wall; 0 for none.
        steps: of the integration, a frame.
        rate: of the places, where it is not the speeds.
    """

    name: str
    states: tuple[str, ...]
    parameters: tuple[tuple[str, str, float, float], ...]
    law: Law
    points: Callable[[Array], Array]
    start: Callable[[Array, float], Array]
    hypotheses: tuple[Hypothesis, ...]
    interval: float
    frames: int
    wall: float = 0.0
    steps: int = 6
    rate: Rate = _speeds

    @property
    def dimensions(self) -> int:
        return len(self.states) // 2


@dataclass(frozen=True)
class MovingBodies:
    """A body in several trials.

    Args:
        body: which.
        data: places of its points in pictures (trials, P 2 T), for the starts of fits.
    """

    body: Body
    data: Array

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(f"trial {i + 1}" for i in range(len(self.data)))

    @property
    def clock(self) -> Array:
        """Times of the frames (T,)."""
        return np.asarray(np.arange(self.body.frames) * self.body.interval, np.float64)

    @property
    def times(self) -> Array:
        return np.tile(self.clock, self.data.shape[1] // self.body.frames)

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
        seen = self.data.reshape(len(self.data), -1, 2, self.body.frames)
        points = np.moveaxis(seen, -1, 1)
        return (np.stack([self.body.start(trial, self.body.interval) for trial in points]),)

    def predict(self, own: Array, shared: Array, terms: tuple[Term, ...] = ()) -> Array:
        effects = {term.hypothesis.name: term for term in terms}
        places = travelled(self.body, own, shared, effects)
        points = seen(self.body.points(places), self.body.interval, effects)
        return np.moveaxis(points, -3, -1).reshape(*own.shape[:-1], -1)

    def driven(self, own: Array, shared: Array, courses: Callable[[Array], Array]) -> Array:
        return np.zeros((0, len(self.channels), len(self.times)))

    def unsure(self, own: Array, shared: Array) -> Array:
        return np.zeros((0, len(self.channels), len(self.times)))

    def spread(self, values: Array) -> Array:
        return np.ones_like(values)

    def uneven(self, values: Array) -> Array:
        return np.zeros((0, *values.shape))

    def flexible(self, shared: Array) -> Array:
        blocks = self.data.shape[1] // self.body.frames
        cosines = np.cos(np.pi * np.arange(_COSINES)[:, None] * np.linspace(0.0, 1.0, self.body.frames))
        alone = np.kron(np.eye(blocks), cosines)
        return np.asarray(np.concatenate([alone, -alone]), np.float64)


def travelled(body: Body, own: Array, shared: Array, effects: Effects) -> Array:
    """Places at every frame (..., T, n), by Runge-Kutta steps of fourth order and reflection at walls."""
    half = body.dimensions
    q, v = own[..., :half].copy(), own[..., half:].copy()
    step = body.interval * (1.0 + size(effects, "frame_rate")) / body.steps
    found = [q]
    for k in range((body.frames - 1) * body.steps):
        q, v = _stepped(body, k * step, step, q, v, shared, effects)
        if (k + 1) % body.steps == 0:
            found.append(q)
    return np.stack(found, axis=-2)


def _stepped(
    body: Body, t: float, h: float, q: Array, v: Array, shared: Array, effects: Effects
) -> tuple[Array, Array]:
    a1 = body.law(t, q, v, shared, effects)
    r1, v2 = body.rate(q, v), v + h / 2 * a1
    q2 = q + h / 2 * r1
    a2, r2 = body.law(t + h / 2, q2, v2, shared, effects), body.rate(q2, v2)
    q3, v3 = q + h / 2 * r2, v + h / 2 * a2
    a3, r3 = body.law(t + h / 2, q3, v3, shared, effects), body.rate(q3, v3)
    q4, v4 = q + h * r3, v + h * a3
    a4, r4 = body.law(t + h, q4, v4, shared, effects), body.rate(q4, v4)
    moved, faster = q + h / 6 * (r1 + 2 * r2 + 2 * r3 + r4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return (moved, faster) if not body.wall else _reflected(body.wall, moved, faster, a1, effects)


def _reflected(wall: float, q: Array, v: Array, a: Array, effects: Effects) -> tuple[Array, Array]:
    """Past a wall: back by the time since the hit, away from it with what restitution and friction leave."""
    kept = 1.0 - size(effects, "restitution")
    past = np.abs(q) - wall
    hit = (past > 0) & (q * v > 0)
    since = np.where(hit, past / np.maximum(np.abs(v), 1e-9), 0.0)
    at_wall = v - a * since
    away = np.where(hit, -kept * at_wall, at_wall)
    along = np.where(hit[..., ::-1], 1.0 - size(effects, "wall_friction"), 1.0)
    away = away * along
    there = np.where(hit, np.sign(q) * wall, q - v * since)
    back = there + away * since + 0.5 * a * since**2
    return np.where(hit, back, q), np.where(hit, away + a * since, v * along)


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
