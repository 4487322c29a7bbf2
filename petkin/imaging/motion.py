"""Motion of what is scanned: where the picture lies in every frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError

Array = NDArray[np.float64]

#: Planes of a grid in which a picture may turn, from the first axis towards the second.
PLANES = ((0, 1), (0, 2), (1, 2))
#: Ways in which it may move: along three axes, and in three planes.
WAYS = 3 + len(PLANES)


@dataclass(frozen=True)
class Motion:
    """One motion.

    Args:
        way: 0, 1, 2 along that axis of the grid; 3, 4, 5 a turn in a plane of `PLANES`.
        far: mm by which the picture, or its rim where it turns, has moved in every frame (K,).
        share: of every frame after it has moved (K,).
    """

    way: int
    far: Array
    share: Array


@dataclass(frozen=True)
class Exchange:
    """What motion adds to regions, as shares of the values of all: D of x + D x.

    Args:
        far: mm, ascending, 0 among them (n,).
        shares: by way of moving and by how far (W, n, R, R); between those it is a cubic spline, and beyond as there.
    """

    far: Array
    shares: Array

    @property
    def ways(self) -> tuple[int, ...]:
        """Those in which something changes."""
        return tuple(np.flatnonzero(self.shares.any(axis=(1, 2, 3))).tolist())

    def by(self, motion: Motion) -> Array:
        """D of every frame (K, R, R)."""
        weights = self._between(np.clip(motion.far, self.far[0], self.far[-1]))
        return np.asarray(np.tensordot(motion.share[:, None] * weights, self.shares[motion.way], axes=1), np.float64)

    @cached_property
    def _between(self) -> Callable[[Array], Array]:
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.far, np.eye(self.far.size), bc_type="natural")


def moved(
    volume: Array,
    way: int,
    far: float,
    voxel_size: Sequence[float],
    labelled: NDArray[np.bool_],
    *,
    blurred: bool = False,
) -> Array:
    """A picture [x, y, z] that has moved by so many mm; what comes from beyond the grid is empty.

    Between voxels it is linear: a picture that is even in every voxel is then averaged over voxels as it lies. One that
    went through a point spread would lose more by that, and is a cubic spline there.

    Args:
        volume: the picture at rest.
        way: as of `Motion`.
        far: mm, at the rim of what is labelled where it turns, about the middle of that.
        voxel_size: mm.
        labelled: mask [x, y, z] of what moves.
        blurred: whether it went through a point spread.

    Raises:
        InputError: the grid has one voxel along an axis that is moved along or turned.
    """
    from scipy.ndimage import map_coordinates

    axes = (way,) if way < 3 else PLANES[way - 3]
    flat = [axis for axis in axes if volume.shape[axis] == 1]
    if flat:
        raise InputError(f"axis={way}: the picture has one voxel along axis {flat[0]} and cannot move there.")
    came = origin(np.indices(volume.shape, float).reshape(3, -1), way, far, voxel_size, labelled)
    order = 3 if blurred else 1
    return np.asarray(map_coordinates(volume, came, order=order, mode="constant"), np.float64).reshape(volume.shape)


def origin(at: Array, way: int, far: float, voxel_size: Sequence[float], labelled: NDArray[np.bool_]) -> Array:
    """Where places (3, N), in voxels, were before a motion; arguments as of `moved`."""
    size, came = np.array(voxel_size, float), at.copy()
    if way < 3:
        came[way] -= far / size[way]
        return came
    one, two = PLANES[way - 3]
    middle, rim = middle_and_rim(labelled, (one, two), size)
    x, y = ((at[axis] - middle[axis]) * size[axis] for axis in (one, two))
    c, s = np.cos(far / rim), np.sin(far / rim)
    came[one] = middle[one] + (c * x + s * y) / size[one]
    came[two] = middle[two] + (c * y - s * x) / size[two]
    return came


@dataclass(frozen=True)
class Leg:
    """One part of a way.

    Args:
        way: as of `Motion`.
        far: mm.
    """

    way: int
    far: float


def origins(at: Array, legs: Sequence[Leg], voxel_size: Sequence[float], labelled: NDArray[np.bool_]) -> Array:
    """Where places (3, N), in voxels, were before motions that came one after another."""
    for leg in reversed(legs):
        at = origin(at, leg.way, leg.far, voxel_size, labelled)
    return at


def middle_and_rim(labelled: NDArray[np.bool_], plane: Sequence[int], voxel_size: Array) -> tuple[Array, float]:
    """The middle of what is labelled (3,), in voxels, and the furthest from it in a plane, mm."""
    at = np.argwhere(labelled).astype(np.float64)
    middle = at.mean(axis=0)
    beside = ((at - middle) * voxel_size)[:, list(plane)]
    return middle, max(float(np.hypot(*beside.T).max()), 1e-300)
