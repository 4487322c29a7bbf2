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

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from petkin_bench.gaps.moving import CAMERA, Body, Effects, hypothesis, size

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


def _rate(q: Array, v: Array) -> Array:
    theta, omega = q[..., 3:], v[..., 3:]
    once = _cross(theta, omega)
    half = 0.5 * np.linalg.norm(theta, axis=-1, keepdims=True)
    small = half < 1e-3
    safe = np.where(small, 1.0, half)
    bent = np.where(small, 1.0 / 12.0, (1.0 - safe * np.cos(safe) / np.sin(safe)) / (4.0 * safe**2))
    return np.concatenate([v[..., :3], omega - 0.5 * once + bent * _cross(theta, once)], axis=-1)


def _law(t: float, q: Array, v: Array, p: Array, e: Effects) -> Array:
    pitch = e["forcing"].setting["pitch"] if "forcing" in e else 0.0
    beats = 1.0 + size(e, "forcing") * np.sin(pitch * t)
    force = beats * np.array([p[0], p[1], size(e, "force_elevation")]) + 0.0 * q[..., :3]
    lever = (1.0 + size(e, "lever")) * rotated(q[..., 3:], _LEVER)
    slow, turning = v[..., :3], v[..., 3:]
    speed = np.linalg.norm(slow, axis=-1, keepdims=True)
    drag = size(e, "drag_linear") * slow + size(e, "drag_quadratic") * speed * slow
    faster = force / (_MASS * (1.0 + size(e, "mass_ratio"))) - drag - size(e, "gravity") * np.array([0.0, 0.0, 1.0])
    torque = _cross(lever, force) / (_INERTIA * (1.0 + size(e, "inertia")))
    return np.concatenate([faster, torque - size(e, "spin_damping") * turning], axis=-1)


def _points(q: Array) -> Array:
    corners = q[..., None, :3] + rotated(q[..., 3:], _CORNERS)
    c, s = math.cos(_ELEVATION), math.sin(_ELEVATION)
    up, near = s * corners[..., 1] + c * corners[..., 2], s * corners[..., 2] - c * corners[..., 1]
    scale = _DISTANCE / (_DISTANCE - near) / _CANVAS
    return np.stack([scale * corners[..., 0], scale * up], axis=-1)


def _start(points: Array, interval: float) -> Array:
    """Poses of the first frames by least squares, and the mean speed between them."""
    few = min(6, len(points))
    begin, poses = np.zeros(6), []
    for seen in points[:few]:
        begin = least_squares(lambda q, seen=seen: (_points(q) - seen).ravel(), begin).x
        poses.append(begin)
    times = np.arange(few) * interval
    pose, rate, _ = np.polynomial.polynomial.polyfit(times, np.stack(poses), 2)
    spin = rate[3:] + 0.5 * _cross(pose[3:], rate[3:])
    return np.concatenate([pose, rate[:3], spin])


RIGID_BODY = Body(
    name="rigid_body",
    states=("x", "y", "z", "tx", "ty", "tz", "vx", "vy", "vz", "wx", "wy", "wz"),
    parameters=(("fx", "N", 0.0, 10.0), ("fy", "N", 0.0, 10.0)),
    law=_law,
    rate=_rate,
    points=_points,
    start=_start,
    hypotheses=(
        hypothesis("force_elevation", "dynamics", "N", -10.0, 10.0, "a second camera, from the side"),
        hypothesis("mass_ratio", "dynamics", "1", -0.3, 0.5, "the cube on a balance"),
        hypothesis("inertia", "dynamics", "1", -0.3, 0.5, "a push of known torque"),
        hypothesis("lever", "dynamics", "1", -0.3, 0.3, "a picture of where the force acts"),
        hypothesis("gravity", "dynamics", "m/s^2", -2.0, 2.0, "a cube that nothing pushes"),
        hypothesis("drag_linear", "dynamics", "1/s", 0.0, 1.0, _SEVERAL),
        hypothesis("drag_quadratic", "dynamics", "1/m", 0.0, 1.0, _SEVERAL),
        hypothesis("spin_damping", "dynamics", "1/s", 0.0, 2.0, _SEVERAL),
        hypothesis("forcing", "dynamics", "1", -1.0, 1.0, "a longer run", settings=({"pitch": 4.0}, {"pitch": 12.0})),
        *CAMERA,
    ),
    interval=1.0 / 30.0,
    frames=45,
    steps=1,
)
