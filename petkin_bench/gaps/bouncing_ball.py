"""What may be missing in a ball under gravity along -y between walls: v' = (0, -G), v -> -v at +-5."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin_bench.gaps.moving import CAMERA, Body, hypothesis
from petkin_bench.gaps.stepping import compiled

Array = NDArray[np.float64]

_WALL, _CANVAS = 5.0, 6.0
_BOUNCES = "a flight that meets walls: they show the camera's axes"


@compiled
def _law(t: float, q: Array, v: Array, p: Array, e: Any, a: Array) -> None:
    drag = e.drag_linear + e.drag_quadratic * math.hypot(v[0], v[1])
    a[0] = p[0] * math.sin(e.gravity_tilt) + e.wind - drag * v[0] - e.magnus * v[1]
    a[1] = -p[0] * math.cos(e.gravity_tilt) - drag * v[1] + e.magnus * v[0]


def _points(q: Array) -> Array:
    return q[..., None, :] / _CANVAS


def _pose(points: Array) -> Array:
    return points[:, 0] * _CANVAS


BOUNCING_BALL = Body(
    name="bouncing_ball",
    states=("x", "y", "vx", "vy"),
    parameters=(("G", "m/s^2", 3.0, 2.0),),
    law=_law,
    points=_points,
    pose=_pose,
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
)
