"""What may be missing in a pendulum without damping: phi'' = -(G / L) sin phi."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin_bench.gaps.moving import CAMERA, Body, forcing, hypothesis
from petkin_bench.gaps.stepping import compiled, friction, pushed

Array = NDArray[np.float64]

_LENGTH, _ARM = 2.0, 0.66
_AMPLITUDES = "swings of several sizes: amplitudes die as exponentials, hyperbolas or straight lines"


@compiled
def _law(t: float, q: Array, v: Array, p: Array, e: Any, a: Array) -> None:
    pull = -p[0] / _LENGTH * math.sin(q[0] - e.gravity_tilt) * (1.0 + e.stiffening * q[0] ** 2)
    a[0] = pull - friction(v[0], e) + e.torque + pushed(t, e)


def _points(q: Array) -> Array:
    return _ARM * np.stack([np.sin(q), np.cos(q)], axis=-1)


def _pose(points: Array) -> Array:
    return np.asarray(np.unwrap(np.arctan2(points[..., 0], points[..., 1]), axis=0), np.float64)


PENDULUM = Body(
    name="pendulum",
    states=("phi", "phi'"),
    parameters=(("G", "m/s^2", 10.0, 3.0),),
    law=_law,
    points=_points,
    pose=_pose,
    hypotheses=(
        hypothesis("damping_linear", "dynamics", "1/s", 0.0, 1.0, _AMPLITUDES),
        hypothesis("damping_quadratic", "dynamics", "1", 0.0, 1.0, _AMPLITUDES),
        hypothesis("damping_coulomb", "dynamics", "rad/s^2", 0.0, 1.0, _AMPLITUDES),
        hypothesis("torque", "dynamics", "rad/s^2", -1.0, 1.0, "the angle at rest"),
        forcing("rad/s^2", 1.0),
        hypothesis("gravity_tilt", "dynamics", "rad", -0.3, 0.3, "a plumb line in the picture"),
        hypothesis("stiffening", "dynamics", "1", -0.2, 0.2, "swings of several sizes"),
        *CAMERA,
    ),
    interval=0.1,
    frames=50,
    steps=6,
)
