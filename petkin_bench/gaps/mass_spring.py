"""What may be missing in two masses on a spring without a damper: x1'' = -s k (|x1 - x2| - l0), x2'' = -x1''."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin_bench.gaps.moving import CAMERA, Body, forcing, hypothesis
from petkin_bench.gaps.stepping import compiled, friction, pushed

Array = NDArray[np.float64]

_REST, _CANVAS = 6.0, 6.0
_AMPLITUDES = "swings of several sizes: amplitudes die as exponentials, hyperbolas or straight lines"


@compiled
def _law(t: float, q: Array, v: Array, p: Array, e: Any, a: Array) -> None:
    apart = q[0] - q[1]
    stretch = abs(apart) - _REST * (1.0 + e.rest_length)
    pull = -np.sign(apart) * (p[0] * stretch + e.spring_cubic * stretch**3) - friction(v[0] - v[1], e)
    a[0] = pull + pushed(t, e) + e.gravity_tilt
    a[1] = -pull / (1.0 + e.mass_ratio) + e.gravity_tilt


def _points(q: Array) -> Array:
    return np.stack([q, np.zeros_like(q)], axis=-1) / _CANVAS


def _pose(points: Array) -> Array:
    return points[..., 0] * _CANVAS


_SHEET = "the masses on a balance"
MASS_SPRING = Body(
    name="mass_spring",
    states=("x1", "x2", "v1", "v2"),
    parameters=(("k", "1/s^2", 10.0, 3.0),),
    law=_law,
    points=_points,
    pose=_pose,
    hypotheses=(
        hypothesis("damping_linear", "dynamics", "1/s", 0.0, 1.0, _AMPLITUDES),
        hypothesis("damping_quadratic", "dynamics", "1/m", 0.0, 1.0, _AMPLITUDES),
        hypothesis("damping_coulomb", "dynamics", "m/s^2", 0.0, 2.0, _AMPLITUDES),
        hypothesis("spring_cubic", "dynamics", "1/(m s)^2", -2.0, 2.0, "swings of several sizes"),
        hypothesis("rest_length", "dynamics", "1", -0.1, 0.1, "the spring at rest"),
        hypothesis("mass_ratio", "dynamics", "1", -0.5, 1.0, _SHEET),
        forcing("m/s^2", 2.0),
        hypothesis("gravity_tilt", "dynamics", "m/s^2", -0.5, 0.5, "a level on the track"),
        *CAMERA,
    ),
    interval=0.1,
    frames=50,
    steps=6,
)
