"""What may be missing in a free cube that a constant force in the plane pushes at one corner.

    x' = v,  m v' = f,  I omega' = (R r) x f,  f = (fx, fy, 0), r = (1, 1, 1) / sqrt 3, m = 8, I = 16 / 3

The pose is x and the rotation vector theta, R = exp(theta x), with omega along the world's axes and h = |theta| / 2:

    theta' = omega - theta x omega / 2 + (1 - h cot h) / |theta|^2  theta x (theta x omega)

The camera is that of the rendered pictures: far away, looking down at 30 degrees, what is nearer is larger; it shows
four corners of the cube.

Reference: Bortz JE. IEEE Trans Aerosp Electron Syst 1971;7:61-66 (rate of the rotation vector).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from petkin_bench.gaps.moving import CAMERA, Body, forcing, hypothesis
from petkin_bench.gaps.stepping import compiled, pushed

Array = NDArray[np.float64]

_MASS, _INERTIA = 8.0, 16.0 / 3.0
_LEVER = np.full(3, 1.0 / math.sqrt(3.0))
_CORNERS = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]) / math.sqrt(3.0)
_CANVAS, _DISTANCE, _ELEVATION = 2.6, 8.0, math.pi / 6
_SEVERAL = "pushes of several sizes and directions"


def _cross(a: Array, b: Array) -> Array:
    """a x b along the last axis; numpy's own takes three times as long on few vectors."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def rotated(theta: Array, vectors: Array) -> Array:
    """exp(theta x) of vectors (3,) or (P, 3), by Rodrigues' formula: (..., 3) or (..., P, 3)."""
    if vectors.ndim == 2:
        theta = theta[..., None, :]
    angle = np.linalg.norm(theta, axis=-1, keepdims=True)
    once = _cross(theta, vectors)
    return vectors + np.sinc(angle / np.pi) * once + 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2 * _cross(theta, once)


@compiled
def _rate(q: Array, v: Array, rate: Array) -> None:
    theta, omega = q[3:], v[3:]
    half = 0.5 * math.sqrt(theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2)
    bent = 1.0 / 12.0 if half < 1e-3 else (1.0 - half * math.cos(half) / math.sin(half)) / (4.0 * half**2)
    once, twice = np.empty(3), np.empty(3)
    _crossed(theta, omega, once)
    _crossed(theta, once, twice)
    for i in range(3):
        rate[i] = v[i]
        rate[3 + i] = omega[i] - 0.5 * once[i] + bent * twice[i]


@compiled
def _crossed(a: Array, b: Array, found: Array) -> None:
    found[0], found[1], found[2] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def _law(t: float, q: Array, v: Array, p: Array, e: Any, a: Array) -> None:
    beats = 1.0 + pushed(t, e)
    force, arm, torque = np.empty(3), np.empty(3), np.empty(3)
    force[0], force[1], force[2] = beats * p[0], beats * p[1], beats * e.force_elevation
    _turned(q[3:], _LEVER, arm)
    _crossed(arm, force, torque)
    drag = e.drag_linear + e.drag_quadratic * math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    for i in range(3):
        a[i] = force[i] / (_MASS * (1.0 + e.mass_ratio)) - drag * v[i]
        a[3 + i] = (1.0 + e.lever) * torque[i] / (_INERTIA * (1.0 + e.inertia)) - e.spin_damping * v[3 + i]
    a[2] -= e.gravity


@compiled
def _turned(theta: Array, vector: Array, found: Array) -> None:
    """exp(theta x) of a vector, by Rodrigues' formula."""
    angle = math.sqrt(theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2)
    small = angle < 1e-4
    first = 1.0 - angle**2 / 6.0 if small else math.sin(angle) / angle
    second = 0.5 - angle**2 / 24.0 if small else (1.0 - math.cos(angle)) / angle**2
    once, twice = np.empty(3), np.empty(3)
    _crossed(theta, vector, once)
    _crossed(theta, once, twice)
    for i in range(3):
        found[i] = vector[i] + first * once[i] + second * twice[i]


def _points(q: Array) -> Array:
    corners = q[..., None, :3] + rotated(q[..., 3:], _CORNERS)
    c, s = math.cos(_ELEVATION), math.sin(_ELEVATION)
    up, near = s * corners[..., 1] + c * corners[..., 2], s * corners[..., 2] - c * corners[..., 1]
    scale = _DISTANCE / (_DISTANCE - near) / _CANVAS
    return np.stack([scale * corners[..., 0], scale * up], axis=-1)


def _pose(points: Array) -> Array:
    """By least squares, frame after frame."""
    begin, found = np.zeros(6), []
    for seen in points:
        begin = least_squares(lambda q, seen=seen: (_points(q) - seen).ravel(), begin).x
        found.append(begin)
    return np.stack(found)


def _speeds(place: Array, rate: Array) -> Array:
    """Of the middle and of the turn, at a small angle."""
    return np.concatenate([rate[:3], rate[3:] + 0.5 * _cross(place[3:], rate[3:])])


RIGID_BODY = Body(
    name="rigid_body",
    states=("x", "y", "z", "tx", "ty", "tz", "vx", "vy", "vz", "wx", "wy", "wz"),
    parameters=(("fx", "N", 0.0, 10.0), ("fy", "N", 0.0, 10.0)),
    law=_law,
    rate=_rate,
    points=_points,
    pose=_pose,
    speeds=_speeds,
    hypotheses=(
        hypothesis("force_elevation", "dynamics", "N", -10.0, 10.0, "a second camera, from the side"),
        hypothesis("mass_ratio", "dynamics", "1", -0.3, 0.5, "the cube on a balance"),
        hypothesis("inertia", "dynamics", "1", -0.3, 0.5, "a push of known torque"),
        hypothesis("lever", "dynamics", "1", -0.3, 0.3, "a picture of where the force acts"),
        hypothesis("gravity", "dynamics", "m/s^2", -2.0, 2.0, "a cube that nothing pushes"),
        hypothesis("drag_linear", "dynamics", "1/s", 0.0, 1.0, _SEVERAL),
        hypothesis("drag_quadratic", "dynamics", "1/m", 0.0, 1.0, _SEVERAL),
        hypothesis("spin_damping", "dynamics", "1/s", 0.0, 2.0, _SEVERAL),
        forcing("1", 1.0, fast=4.0),
        *CAMERA,
    ),
    interval=1.0 / 30.0,
    frames=45,
)
