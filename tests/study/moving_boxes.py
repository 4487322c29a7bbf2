"""Three boxes that move in front of a scanner, each with a curve of its own."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from petkin.imaging import PLANES, Leg, blur, middle_and_rim, origins
from petkin.study.diagnosis.picture import Picture, Voxels
from petkin.study.diagnosis.voxel_noise import VoxelNoise

REGIONS, FRAMES = 3, 8
EDGE, FINER = 2.0, 4
POINT_SPREAD = 8.0

T = np.arange(FRAMES)
ALIKE = np.stack([a * np.exp(-T / b) for a, b in ((10.0, 4.0), (20.0, 9.0), (35.0, 20.0))])
APART = np.stack([20.0 * np.exp(-T / 2.0), 8.0 * (T + 1) * np.exp(-T / 3.0), 30.0 * (1.0 - np.exp(-(T + 1) / 6.0))])


def boxes() -> np.ndarray:
    """Labels of three boxes side by side and above one another."""
    labels = np.zeros((16, 16, 16), np.intp)
    labels[4:8, 4:12, 4:12], labels[8:12, 4:12, 4:8], labels[8:12, 4:12, 8:12] = 1, 2, 3
    return labels


@cache
def photographed(*legs: Leg) -> np.ndarray:
    """The boxes moved, through a point spread, and averaged over voxels [x, y, z, K], all of it on a finer grid, where
    every point has the label of the place that it came from."""
    labels = boxes()
    fine = labels.repeat(FINER, 0).repeat(FINER, 1).repeat(FINER, 2)
    edge = EDGE / FINER
    at = np.indices(fine.shape, float).reshape(3, -1)
    came = origins(at, [_as_far(leg, labels > 0, fine > 0) for leg in legs], (edge,) * 3, fine > 0)
    there = fine[tuple(np.clip(np.rint(came), 0, len(fine) - 1).astype(np.intp))].reshape(fine.shape)
    seen = [blur((there == r).astype(float), POINT_SPREAD, (edge,) * 3) for r in range(1, 4)]
    maps = np.stack([each.reshape(16, FINER, 16, FINER, 16, FINER).mean(axis=(1, 3, 5)) for each in seen], axis=-1)
    return np.asarray(maps @ APART)


def _as_far(leg: Leg, labelled: np.ndarray, finer: np.ndarray) -> Leg:
    """The same angle of a turn: the middles of finer voxels lie nearer to the rim."""
    if leg.way < 3:
        return leg
    rims = [
        middle_and_rim(m, PLANES[leg.way - 3], np.full(3, e))[1] for m, e in ((labelled, EDGE), (finer, EDGE / FINER))
    ]
    return Leg(leg.way, leg.far * rims[1] / rims[0])


def blurred_regions(levels: np.ndarray, image: np.ndarray | None = None) -> tuple[Voxels, np.ndarray]:
    """Three boxes, each with a curve of its own, through a point spread; and the picture frame by frame."""
    labels = boxes()
    inside, courses = labels > 0, np.linalg.svd(levels, full_matrices=False)[2]
    if image is None:
        image = blur(np.concatenate([np.zeros((1, FRAMES)), levels])[labels], POINT_SPREAD, (EDGE,) * 3)
    means = np.stack([image[labels == r + 1].mean(axis=0) for r in range(3)])
    grain = VoxelNoise(np.ones(FRAMES), np.ones((1, 1, 1)), labels)
    curves = image[inside].T.astype(np.float32)
    box, seen = (slice(None),) * 3, image @ courses.T
    picture = Picture(curves, labels[inside] - 1, inside, box, (EDGE,) * 3, 0.0, courses, seen, grain)
    fit: Any = SimpleNamespace(values=means)
    return Voxels(picture, fit, np.ones_like(levels), np.zeros((REGIONS, FRAMES, 2))), image
