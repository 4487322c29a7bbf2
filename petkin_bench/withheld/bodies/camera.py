"""The generator's own camera: when it opens, and what its lens and its mount do to points.

Of the catalogue: exposure, frame rate, lens, roll, scale, offset. Of no catalogue: a mount that drifts or jumps, a
picture read line by line, a screen that is not square to the lens, a slow zoom.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from petkin_bench.withheld.bodies.rigs import Kit, Rig

Array = NDArray[np.float64]

#: Gauss-Legendre nodes of an exposure; the share of a frame over which a speed is taken.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
_NEAR = 0.02


def pictured(rig: Rig, places: Callable[[Array], Array], kit: Kit) -> Array:
    """Points (B, T, P, 2) of places that are told at ascending times."""
    clock = np.asarray(np.arange(rig.frames) * rig.interval * (1.0 + kit.get("frame_rate", 0.0)), np.float64)
    points = _exposed(rig, places, clock, kit)
    late = clock[:, None] / clock[-1]
    x, y = points[..., 0], points[..., 1]
    if "lens_distortion" in kit:
        r2 = x**2 + y**2
        if kit.get("divided", 0.0):
            larger = 1.0 / (1.0 - kit["lens_distortion"] * r2)
        else:
            larger = 1.0 + kit["lens_distortion"] * r2 * (1.0 + kit.get("steeper", 0.0) * r2)
        x, y = x * larger, y * larger
    if "keystone" in kit:
        x, y = x * (1.0 + kit["keystone"] * y), y * (1.0 + kit["keystone"] * y)
    angle = kit.get("camera_roll", 0.0) + kit.get("slipping", 0.0) * late
    x, y = np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y
    larger = 1.0 + kit.get("camera_scale", 0.0) + kit.get("zoom", 0.0) * late
    x, y = x * larger + kit.get("camera_offset_x", 0.0), y * larger + kit.get("camera_offset_y", 0.0)
    x = x + kit.get("drift", 0.0) * late
    jumped = (clock[:, None] > kit.get("moment", 0.0)) * kit.get("jump", 0.0)
    return np.stack([x + jumped, y], axis=-1)


def _exposed(rig: Rig, places: Callable[[Array], Array], clock: Array, kit: Kit) -> Array:
    """Points as the shutter sees them, which opens at the clock: averaged over its time, or each line at its own."""
    if kit.get("exposure_blur", 0.0):
        times = (clock[:, None] + 0.5 * kit["exposure_blur"] * rig.interval * (1.0 + _NODES)).ravel()
        points = rig.picture(places(times)).reshape(-1, len(clock), len(_NODES), *_shape(rig))
        return np.asarray(np.einsum("btgpc,g->btpc", points, _WEIGHTS / 2.0), np.float64)
    if "rolling" in kit:
        step = _NEAR * rig.interval
        both = rig.picture(places(np.stack([clock, clock + step], axis=1).ravel()))
        both = both.reshape(-1, len(clock), 2, *_shape(rig))
        here = both[:, :, 0]
        return np.asarray(here + kit["rolling"] * rig.interval * here[..., 1:] * (both[:, :, 1] - here) / step)
    return rig.picture(places(clock))


def _shape(rig: Rig) -> tuple[int, ...]:
    return rig.picture(np.zeros((1, rig.half + rig.turning))).shape[1:]
