"""What may be missing in a pendulum without damping: phi'' = -(G / L) sin phi."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin_bench.gaps.moving import CAMERA, Body, Effects, hypothesis, size

Array = NDArray[np.float64]

_LENGTH, _ARM = 2.0, 0.66
#: Speed below which friction fades, rad/s: without it Coulomb's law has no derivative.
_STUCK = 0.02
_AMPLITUDES = "swings of several sizes: amplitudes die as exponentials, hyperbolas or straight lines"


def _law(t: float, q: Array, v: Array, p: Array, e: Effects) -> Array:
    pull = -p[0] / _LENGTH * np.sin(q - size(e, "gravity_tilt")) * (1.0 + size(e, "stiffening") * q**2)
    drag = size(e, "damping_linear") * v + size(e, "damping_quadratic") * np.abs(v) * v
    drag = drag + size(e, "damping_coulomb") * np.tanh(v / _STUCK)
    pitch = e["forcing"].setting["pitch"] if "forcing" in e else 0.0
    return pull - drag + size(e, "torque") + size(e, "forcing") * np.sin(pitch * t)


def _points(q: Array) -> Array:
    return _ARM * np.stack([np.sin(q), np.cos(q)], axis=-1)


def _start(points: Array, interval: float) -> Array:
    angle = np.unwrap(np.arctan2(points[:3, 0, 0], points[:3, 0, 1]))
    return np.array([angle[0], (-1.5 * angle[0] + 2.0 * angle[1] - 0.5 * angle[2]) / interval])


PENDULUM = Body(
    name="pendulum",
    states=("phi", "phi'"),
    parameters=(("G", "m/s^2", 10.0, 3.0),),
    law=_law,
    points=_points,
    start=_start,
    hypotheses=(
        hypothesis("damping_linear", "dynamics", "1/s", 0.0, 1.0, _AMPLITUDES),
        hypothesis("damping_quadratic", "dynamics", "1", 0.0, 1.0, _AMPLITUDES),
        hypothesis("damping_coulomb", "dynamics", "rad/s^2", 0.0, 1.0, _AMPLITUDES),
        hypothesis("torque", "dynamics", "rad/s^2", -1.0, 1.0, "the angle at rest"),
        hypothesis(
            "forcing", "dynamics", "rad/s^2", -1.0, 1.0, "a longer run", settings=({"pitch": 1.0}, {"pitch": 4.0})
        ),
        hypothesis("gravity_tilt", "dynamics", "rad", -0.3, 0.3, "a plumb line in the picture"),
        hypothesis("stiffening", "dynamics", "1", -0.2, 0.2, "swings of several sizes"),
        *CAMERA,
    ),
    interval=0.1,
    frames=50,
)
