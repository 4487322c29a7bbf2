"""What may be missing in two masses on a spring without a damper: x1'' = -s k (|x1 - x2| - l0), x2'' = -x1''."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin_bench.gaps.moving import CAMERA, Body, Effects, hypothesis, size

Array = NDArray[np.float64]

_REST, _CANVAS, _STUCK = 6.0, 6.0, 0.02
_AMPLITUDES = "swings of several sizes: amplitudes die as exponentials, hyperbolas or straight lines"


def _law(t: float, q: Array, v: Array, p: Array, e: Effects) -> Array:
    apart, fast = q[..., 0] - q[..., 1], v[..., 0] - v[..., 1]
    stretch = np.abs(apart) - _REST * (1.0 + size(e, "rest_length"))
    pull = -np.sign(apart) * (p[0] * stretch + size(e, "spring_cubic") * stretch**3)
    pull = pull - size(e, "damping_linear") * fast - size(e, "damping_quadratic") * np.abs(fast) * fast
    pull = pull - size(e, "damping_coulomb") * np.tanh(fast / _STUCK)
    pitch = e["forcing"].setting["pitch"] if "forcing" in e else 0.0
    first = pull + size(e, "forcing") * np.sin(pitch * t)
    return np.stack([first, -pull / (1.0 + size(e, "mass_ratio"))], axis=-1) + size(e, "gravity_tilt")


def _points(q: Array) -> Array:
    return np.stack([q, np.zeros_like(q)], axis=-1) / _CANVAS


def _start(points: Array, interval: float) -> Array:
    places = points[:3, :, 0] * _CANVAS
    return np.concatenate([places[0], (-1.5 * places[0] + 2.0 * places[1] - 0.5 * places[2]) / interval])


_SHEET = "the masses on a balance"
MASS_SPRING = Body(
    name="mass_spring",
    states=("x1", "x2", "v1", "v2"),
    parameters=(("k", "1/s^2", 10.0, 3.0),),
    law=_law,
    points=_points,
    start=_start,
    hypotheses=(
        hypothesis("damping_linear", "dynamics", "1/s", 0.0, 1.0, _AMPLITUDES),
        hypothesis("damping_quadratic", "dynamics", "1/m", 0.0, 1.0, _AMPLITUDES),
        hypothesis("damping_coulomb", "dynamics", "m/s^2", 0.0, 2.0, _AMPLITUDES),
        hypothesis("spring_cubic", "dynamics", "1/(m s)^2", -2.0, 2.0, "swings of several sizes"),
        hypothesis("rest_length", "dynamics", "1", -0.1, 0.1, "the spring at rest"),
        hypothesis("mass_ratio", "dynamics", "1", -0.5, 1.0, _SHEET),
        hypothesis(
            "forcing", "dynamics", "m/s^2", -2.0, 2.0, "a longer run", settings=({"pitch": 1.0}, {"pitch": 4.0})
        ),
        hypothesis("gravity_tilt", "dynamics", "m/s^2", -0.5, 0.5, "a level on the track"),
        *CAMERA,
    ),
    interval=0.1,
    frames=50,
)
