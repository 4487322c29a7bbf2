"""What may be missing in a ball under gravity along -y between walls: v' = (0, -G), v -> -v at +-5."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin_bench.gaps.moving import CAMERA, Body, Effects, hypothesis, size

Array = NDArray[np.float64]

_WALL, _CANVAS = 5.0, 6.0
_BOUNCES = "a flight that meets walls: they show the camera's axes"


def _law(t: float, q: Array, v: Array, p: Array, e: Effects) -> Array:
    tilt = size(e, "gravity_tilt")
    speed = np.sqrt((v**2).sum(axis=-1, keepdims=True))
    drag = size(e, "drag_linear") * v + size(e, "drag_quadratic") * speed * v
    spun = size(e, "magnus") * np.stack([-v[..., 1], v[..., 0]], axis=-1)
    pull = p[0] * np.stack([np.sin(tilt) + 0.0 * q[..., 0], -np.cos(tilt) + 0.0 * q[..., 0]], axis=-1)
    return pull - drag + spun + np.array([1.0, 0.0]) * size(e, "wind")


def _points(q: Array) -> Array:
    return q[..., None, :] / _CANVAS


def _start(points: Array, interval: float) -> Array:
    places = points[:3, 0] * _CANVAS
    return np.concatenate([places[0], (-1.5 * places[0] + 2.0 * places[1] - 0.5 * places[2]) / interval])


BOUNCING_BALL = Body(
    name="bouncing_ball",
    states=("x", "y", "vx", "vy"),
    parameters=(("G", "m/s^2", 3.0, 2.0),),
    law=_law,
    points=_points,
    start=_start,
    hypotheses=(
        hypothesis("gravity_tilt", "dynamics", "rad", -0.6, 0.6, _BOUNCES),
        hypothesis("wind", "dynamics", "m/s^2", -2.0, 2.0, "flights at several speeds"),
        hypothesis("drag_linear", "dynamics", "1/s", 0.0, 0.5, "flights at several speeds"),
        hypothesis("drag_quadratic", "dynamics", "1/m", 0.0, 0.2, "flights at several speeds"),
        hypothesis("magnus", "dynamics", "1/s", -0.5, 0.5, "a ball without spin"),
        hypothesis("restitution", "dynamics", "1", 0.0, 0.4, "more bounces"),
        hypothesis("wall_friction", "dynamics", "1", 0.0, 0.4, "bounces at a slant"),
        *CAMERA,
    ),
    interval=0.05,
    frames=50,
    wall=_WALL,
    steps=10,
)
