"""What may be missing in two pendulums in a chain of equal masses and arms, without damping.

With c = cos(phi1 - phi2), s = sin(phi1 - phi2), m = m1 / m2 = 1, L the upper arm and l L the lower, l = 1:

    [(m + 1) L   l L c] [phi1'']   [-l L s phi2'^2 - (m + 1) G sin phi1 + T1]
    [L c         l L  ] [phi2''] = [ L s phi1'^2 - G sin phi2 + T2          ]

T holds friction at the two pivots (of the second, by the difference of speeds, and back on the first) and forcing.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin_bench.gaps.moving import CAMERA, Body, forcing, hypothesis
from petkin_bench.gaps.stepping import compiled, friction, pushed

Array = NDArray[np.float64]

_LENGTH, _ARM = 1.5, 0.43
_AMPLITUDES = "swings of several sizes: amplitudes die as exponentials, hyperbolas or straight lines"


@compiled
def _law(t: float, q: Array, v: Array, p: Array, e: Any, a: Array) -> None:
    upper, lower, weight = 2.0 + e.mass_ratio, 1.0 + e.length_ratio, p[0] / _LENGTH
    c, s = math.cos(q[0] - q[1]), math.sin(q[0] - q[1])
    at_second = friction(v[1] - v[0], e)
    pull = upper * weight * math.sin(q[0] - e.gravity_tilt)
    one = -lower * s * v[1] ** 2 - pull + pushed(t, e) - friction(v[0], e) + at_second
    two = s * v[0] ** 2 - weight * math.sin(q[1] - e.gravity_tilt) - at_second
    whole = lower * (upper - c**2)
    a[0], a[1] = lower * (one - c * two) / whole, (upper * two - c * one) / whole


def _points(q: Array) -> Array:
    return _ARM * np.stack([np.sin(q), np.cos(q)], axis=-1).cumsum(axis=-2)


def _pose(points: Array) -> Array:
    arms = np.diff(points, axis=1, prepend=0.0)
    return np.asarray(np.unwrap(np.arctan2(arms[..., 0], arms[..., 1]), axis=0), np.float64)


DOUBLE_PENDULUM = Body(
    name="double_pendulum",
    states=("phi1", "phi2", "phi1'", "phi2'"),
    parameters=(("G", "m/s^2", 10.0, 3.0),),
    law=_law,
    points=_points,
    pose=_pose,
    hypotheses=(
        hypothesis("mass_ratio", "dynamics", "1", -0.5, 1.0, "the masses on a balance"),
        hypothesis("length_ratio", "dynamics", "1", -0.2, 0.2, "a ruler along the arms"),
        hypothesis("damping_linear", "dynamics", "1/s", 0.0, 1.0, _AMPLITUDES),
        hypothesis("damping_quadratic", "dynamics", "1", 0.0, 1.0, _AMPLITUDES),
        hypothesis("damping_coulomb", "dynamics", "rad/s^2", 0.0, 1.0, _AMPLITUDES),
        forcing("rad/s^2", 2.0),
        hypothesis("gravity_tilt", "dynamics", "rad", -0.3, 0.3, "a plumb line in the picture"),
        *CAMERA,
    ),
    interval=0.1,
    frames=40,
    steps=8,
)
