"""A head of the generator's own: a continuous object of ellipsoids, looked at in any pose, with kinetics that vary.

Nothing of the product is used here. Lengths are in mm, the middle of the field of view is the origin.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Labels = NDArray[np.int64]

#: Voxels along an edge, and their size.
GRID, VOXEL = 24, 5.0
#: Regions of the segmentation; one more is the scalp, which has no label.
NAMES = ("anterior", "posterior", "core", "nuclei", "hindbrain")
#: Thickness of the rind, and of skull and scalp beyond the brain.
_RIND, _SKULL, _SCALP = 11.0, 4.0, 11.0
#: Length over which kinetics vary, waves that a field is a sum of, and sd of the logarithms of K1 k2 k3 k4 and vB.
LENGTH, _WAVES = 13.0, 24
VARIED = (0.08, 0.06, 0.08, 0.06, 0.15)


@dataclass(frozen=True)
class Pose:
    """Where the head lies: moved (mm), and turned about the z axis through the middle (radians)."""

    moved: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turned: float = 0.0


REST = Pose()


@dataclass(frozen=True, eq=False)
class Head:
    """Radii of the brain, waves (P, W, 3) and their phases (P, W) of the fields of kinetics."""

    radii: Array
    waves: Array
    phases: Array

    @property
    def labels(self) -> Labels:
        """Region of every voxel [x, y, z] at rest, 1 to R; R + 1 is the scalp, 0 air."""
        return self.labelled(points(REST)).reshape(GRID, GRID, GRID)

    def labelled(self, at: Array) -> Labels:
        """Region of every point (N, 3)."""
        deep = np.sqrt(((at / self.radii) ** 2).sum(axis=1))
        mean = float(self.radii.mean())
        beyond = (deep - 1.0) * mean
        found = np.where((beyond > _SKULL) & (beyond < _SKULL + _SCALP), len(NAMES) + 1, 0)
        brain, rind = beyond <= 0, beyond > -_RIND
        found[brain] = 3
        found[brain & rind & (at[:, 1] >= 0)] = 1
        found[brain & rind & (at[:, 1] < 0)] = 2
        beside = np.stack([np.abs(at[:, 0]) - 15.0, at[:, 1] - 6.0, at[:, 2] - 2.0], axis=1)
        found[brain & (((beside / np.array([8.0, 14.0, 10.0])) ** 2).sum(axis=1) <= 1)] = 4
        behind = at - np.array([0.0, -0.55, -0.7]) * self.radii
        found[brain & (((behind / np.array([34.0, 24.0, 18.0])) ** 2).sum(axis=1) <= 1)] = 5
        return found

    def varied(self, at: Array) -> Array:
        """Change of the logarithm of every rate and of vB at points (N, 3): (P, N)."""
        waves = np.cos(np.einsum("pwi,ni->pwn", self.waves, at) + self.phases[:, :, None])
        return np.array(VARIED)[:, None] * np.sqrt(2.0 / _WAVES) * waves.sum(axis=1)


def draw_head(rng: np.random.Generator) -> Head:
    """One head; fields have the correlation e^{-r^2 / (2 length^2)}."""
    radii = np.array([43.0, 48.0, 41.0]) * rng.uniform(0.92, 1.05, 3)
    waves = rng.standard_normal((len(VARIED), _WAVES, 3)) / LENGTH
    return Head(radii, waves, rng.uniform(0.0, 2.0 * np.pi, waves.shape[:2]))


@lru_cache(maxsize=64)
def points(pose: Pose) -> Array:
    """Where in the head the middle of every voxel lies (N, 3)."""
    return _in_head(_middles(), pose)


def _middles() -> Array:
    axis = (np.arange(GRID) - (GRID - 1) / 2) * VOXEL
    return np.asarray(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3), np.float64)


def _in_head(at: Array, pose: Pose) -> Array:
    c, s = np.cos(pose.turned), np.sin(pose.turned)
    return (at - np.array(pose.moved)) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@lru_cache(maxsize=40)
def filled(head: Head, pose: Pose, fine: int) -> Array:
    """Share of every voxel that each region and the scalp fill (R + 1, N), by so many points along an edge."""
    count, middles = len(NAMES) + 1, _middles()
    offsets = ((np.arange(fine) + 0.5) / fine - 0.5) * VOXEL
    found = np.zeros((count + 1, len(middles)))
    every = np.arange(len(middles))
    for offset in itertools.product(offsets, repeat=3):
        found[head.labelled(_in_head(middles + np.array(offset), pose)), every] += 1.0
    return found[1:] / fine**3


@lru_cache(maxsize=40)
def _varied(head: Head, pose: Pose) -> Array:
    return head.varied(points(pose))


def painted(head: Head, pose: Pose, curves: Array, derivatives: Array, *, fine: int = 1) -> Array:
    """A sharp image [x, y, z, K] of curves (R + 1, K) that change by derivatives (R + 1, P, K) with the fields.

    Without any, kinetics do not vary.
    """
    share = filled(head, pose, fine)
    image = share.T @ curves
    if not derivatives.shape[1]:
        return image.reshape(GRID, GRID, GRID, -1)
    varied = _varied(head, pose)
    for own, by in zip(share, derivatives, strict=True):
        inside = own > 0
        image[inside] += own[inside, None] * (varied[:, inside].T @ by)
    return image.reshape(GRID, GRID, GRID, -1)
