"""The dynamic image of a scene, frame by frame: regions or voxels, point spread, noise."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from petkin.imaging import Motion, blur, moved
from petkin.phantoms import random_stream
from petkin.study.simulation.planning import Plan
from petkin.study.simulation.scene import Scene, voxel_values


def image_frames(plan: Plan, scene: Scene) -> Iterator[Float[NDArray, "x y z"]]:
    """Frames in order, kBq/mL; one at a time is in memory."""
    noise, clock = scene.truth.noise, scene.truth.clock
    rng = random_stream(plan.settings.seed, "noise", scene.subject, scene.session)
    common, scale = noise.frame_common(rng, len(clock.frames)), noise.of_frames(clock)
    size, camera = plan.painted.voxel_size, scene.truth.imaging
    motions = [motion(clock) for motion in camera.motions]
    for k, sharp in enumerate(_sharp_frames(plan, scene)):
        frame = _as_it_lies(plan, blur(sharp, camera.point_spread, size), motions, k, camera.point_spread > 0)
        if noise.percent > 0:
            frame = frame + scale[k] * noise.of_values(frame) * (common[k] + noise.voxel_part(rng, frame.shape, size))
        yield frame


def _as_it_lies(
    plan: Plan, frame: Float[NDArray, "x y z"], motions: list[Motion], k: int, blurred: bool
) -> Float[NDArray, "x y z"]:
    """A frame of a head that may have moved, before or within it."""
    painted = plan.painted
    for motion in motions:
        far, share = float(motion.far[k]), float(motion.share[k])
        if far and share:
            there = moved(frame, motion.way, far, painted.voxel_size, painted.mask, blurred=blurred)
            frame = (1.0 - share) * frame + share * there
    return frame


def _sharp_frames(plan: Plan, scene: Scene) -> Iterator[Float[NDArray, "x y z"]]:
    if scene.voxels is None:
        for values in scene.truth.frame_values().numpy().T:
            yield plan.painted.fractions @ values
        return
    for values in voxel_values(scene.voxels).T:
        frame = np.zeros(plan.painted.labels.shape)
        frame[plan.painted.mask] = values
        yield frame
