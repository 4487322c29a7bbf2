"""Compiled motion: Runge-Kutta steps of fourth order, walls that throw back, and what several laws have in common."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: What a law is compiled by. Its code is made anew in every process: none that is handed to another can be kept.
compiled = numba.njit(error_model="numpy")

#: Speed below which dry friction fades: without it Coulomb's law has no derivative.
_STUCK = 0.02
#: Walls that may be met in a step; Newton's steps to the moment of a hit.
_BOUNCES, _NEWTON = 4, 8


@compiled
def friction(fast: float, e: Any) -> float:
    """Deceleration by friction at a speed: linear, quadratic, and dry (Coulomb's)."""
    drag = e.damping_linear * fast + e.damping_quadratic * abs(fast) * fast
    if e.damping_coulomb != 0.0:
        drag += e.damping_coulomb * math.tanh(fast / _STUCK)
    return float(drag)


@compiled
def pushed(t: float, e: Any) -> float:
    """A periodic push."""
    return float(e.forcing * math.sin(e.pitch * t + e.phase))


@compiled
def _copy(there: Array, here: Array) -> None:
    for i in range(len(here)):
        here[i] = there[i]


@compiled
def speeds_alone(q: Array, v: Array, rate: Array) -> None:
    """Rates of places that are what they seem."""
    _copy(v, rate)


@compiled
def all_travelled(
    law: Any, rate: Any, starts: Array, shared: Array, e: Any, step: float, steps: int, frames: int, wall: float | None
) -> Array:
    """Places (runs, frames, n) of starts (runs, 2 n), in so many steps a frame; without a wall none is compiled."""
    half = starts.shape[1] // 2
    found, room = np.empty((len(starts), frames, half)), np.empty((10, half))
    moved, faster = np.empty(half), np.empty(half)
    for run in range(len(starts)):
        q, v = starts[run, :half].copy(), starts[run, half:].copy()
        _copy(q, found[run, 0])
        for k in range((frames - 1) * steps):
            if wall is None:
                _stepped(law, rate, k * step, step, q, v, shared, e, room)
            else:
                _between_walls(law, rate, k * step, step, q, v, shared, e, wall, moved, faster, room)
            if (k + 1) % steps == 0:
                _copy(q, found[run, (k + 1) // steps])
    return found


@compiled
def _stepped(law: Any, rate: Any, t: float, h: float, q: Array, v: Array, shared: Array, e: Any, room: Array) -> None:
    """Places and speeds (n,) moved on by h."""
    places, speeds = room[8], room[9]
    _copy(q, places)
    _copy(v, speeds)
    for stage in range(4):
        rate(places, speeds, room[stage])
        late = 0.0 if stage == 0 else h if stage == 3 else 0.5 * h
        law(t + late, places, speeds, shared, e, room[4 + stage])
        if stage < 3:
            ahead = h if stage == 2 else 0.5 * h
            for i in range(len(q)):
                places[i], speeds[i] = q[i] + ahead * room[stage, i], v[i] + ahead * room[4 + stage, i]
    for i in range(len(q)):
        q[i] += h / 6.0 * (room[0, i] + 2.0 * room[1, i] + 2.0 * room[2, i] + room[3, i])
        v[i] += h / 6.0 * (room[4, i] + 2.0 * room[5, i] + 2.0 * room[6, i] + room[7, i])


@compiled
def _between_walls(
    law: Any,
    rate: Any,
    t: float,
    h: float,
    q: Array,
    v: Array,
    shared: Array,
    e: Any,
    wall: float,
    moved: Array,
    faster: Array,
    room: Array,
) -> None:
    """A step that ends at the first wall, turns round, and goes on for what is left of it."""
    left = h
    for _ in range(_BOUNCES):
        _copy(q, moved)
        _copy(v, faster)
        _stepped(law, rate, t, left, moved, faster, shared, e, room)
        first, axis = 2.0, -1
        for i in range(len(q)):
            outwards = moved[i] * v[i] > 0.0 or moved[i] * faster[i] > 0.0  # a slow one may fall back within the step
            if abs(moved[i]) > wall and outwards:
                there = math.copysign(wall, moved[i])
                share = _share_to(there, q[i], left * v[i], moved[i], left * faster[i])
                if share < first:
                    first, axis = share, i
        if axis < 0:
            _copy(moved, q)
            _copy(faster, v)
            return
        there = math.copysign(wall, moved[axis])
        _stepped(law, rate, t, first * left, q, v, shared, e, room)
        q[axis] = there
        for i in range(len(q)):
            v[i] *= -(1.0 - e.restitution) if i == axis else 1.0 - e.wall_friction
        left *= 1.0 - first


@compiled
def _share_to(wall: float, q: float, v: float, end: float, faster: float) -> float:
    """Share of a step at which a place meets a wall between two ends; speeds are a step's.

    Newton's steps on the cubic through both places and both speeds, from the straight line between them.
    """
    share = min(max((wall - q) / (end - q), 0.0), 1.0) if end != q else 0.0
    second, third = 3.0 * (end - q) - 2.0 * v - faster, 2.0 * (q - end) + v + faster
    for _ in range(_NEWTON):
        place = q + share * (v + share * (second + share * third)) - wall
        speed = v + share * (2.0 * second + 3.0 * share * third)
        if abs(speed) > 1e-12:
            share = min(max(share - place / speed, 0.0), 1.0)
    return share
