"""What may be missing in two pendulums in a chain of equal masses and arms, without damping.

With c = cos(phi1 - phi2), s = sin(phi1 - phi2), m = m1 / m2 = 1, L the upper arm and l L the lower, l = 1:

    [(m + 1) L   l L c] [phi1'']   [-l L s phi2'^2 - (m + 1) G sin phi1 + T1]
    [L c         l L  ] [phi2''] = [ L s phi1'^2 - G sin phi2 + T2          ]

T holds friction at the two pivots (of the second, by the difference of speeds, and back on the first) and forcing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin_bench.gaps.moving import CAMERA, Body, Effects, hypothesis, size

Array = NDArray[np.float64]

_LENGTH, _ARM = 1.5, 0.43
#: Speed below which friction fades, rad/s: without it Coulomb's law has no derivative.
_STUCK = 0.02
_AMPLITUDES = "swings of several sizes: amplitudes die as exponentials, hyperbolas or straight lines"


def _friction(fast: Array, e: Effects) -> Array:
    drag = size(e, "damping_linear") * fast + size(e, "damping_quadratic") * np.abs(fast) * fast
    return drag + size(e, "damping_coulomb") * np.tanh(fast / _STUCK)


def _law(t: float, q: Array, v: Array, p: Array, e: Effects) -> Array:
    tilt, upper = size(e, "gravity_tilt"), 2.0 + size(e, "mass_ratio")
    lower = 1.0 + size(e, "length_ratio")
    c, s = np.cos(q[..., 0] - q[..., 1]), np.sin(q[..., 0] - q[..., 1])
    sin1, sin2 = np.sin(q[..., 0] - tilt), np.sin(q[..., 1] - tilt)
    pitch = e["forcing"].setting["pitch"] if "forcing" in e else 0.0
    at_second = _friction(v[..., 1] - v[..., 0], e)
    pushed = size(e, "forcing") * np.sin(pitch * t) - _friction(v[..., 0], e) + at_second
    one = -lower * s * v[..., 1] ** 2 - upper * p[0] / _LENGTH * sin1 + pushed
    two = s * v[..., 0] ** 2 - p[0] / _LENGTH * sin2 - at_second
    whole = lower * (upper - c**2)
    return np.stack([lower * (one - c * two), upper * two - c * one], axis=-1) / whole[..., None]


def _points(q: Array) -> Array:
    return _ARM * np.stack([np.sin(q), np.cos(q)], axis=-1).cumsum(axis=-2)


def _start(points: Array, interval: float) -> Array:
    arms = np.diff(points[:3], axis=1, prepend=0.0)
    angle = np.unwrap(np.arctan2(arms[..., 0], arms[..., 1]), axis=0)
    return np.concatenate([angle[0], (-1.5 * angle[0] + 2.0 * angle[1] - 0.5 * angle[2]) / interval])


DOUBLE_PENDULUM = Body(
    name="double_pendulum",
    states=("phi1", "phi2", "phi1'", "phi2'"),
    parameters=(("G", "m/s^2", 10.0, 3.0),),
    law=_law,
    points=_points,
    start=_start,
    hypotheses=(
        hypothesis("mass_ratio", "dynamics", "1", -0.5, 1.0, "the masses on a balance"),
        hypothesis("length_ratio", "dynamics", "1", -0.2, 0.2, "a ruler along the arms"),
        hypothesis("damping_linear", "dynamics", "1/s", 0.0, 1.0, _AMPLITUDES),
        hypothesis("damping_quadratic", "dynamics", "1", 0.0, 1.0, _AMPLITUDES),
        hypothesis("damping_coulomb", "dynamics", "rad/s^2", 0.0, 1.0, _AMPLITUDES),
        hypothesis(
            "forcing", "dynamics", "rad/s^2", -2.0, 2.0, "a longer run", settings=({"pitch": 1.0}, {"pitch": 4.0})
        ),
        hypothesis("gravity_tilt", "dynamics", "rad", -0.3, 0.3, "a plumb line in the picture"),
        *CAMERA,
    ),
    interval=0.1,
    frames=40,
    steps=8,
)
