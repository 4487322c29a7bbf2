"""Painting a phantom on a grid: labels, and how much of each voxel every region fills."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.phantoms.definition import Phantom, Region, Shape

#: Sixteen regions in as many voxels fill two gigabytes.
_MOST_VOXELS = 256**3


@dataclass(frozen=True)
class PaintedPhantom:
    """A phantom on a grid.

    Args:
        labels: region index of each voxel (x, y, z), 0 outside; the region that fills most of it.
        fractions: share of each voxel that each region fills, (x, y, z, regions); their sum is below 1 at the border.
        regions: in the order of the last axis of `fractions`.
        affine: voxel index to mm, RAS+, origin in the middle of the field of view.
        voxel_size: mm.
    """

    labels: Int[NDArray, "x y z"]
    fractions: Float[NDArray, "x y z regions"]
    regions: tuple[Region, ...]
    affine: Float[NDArray, "4 4"]
    voxel_size: tuple[float, float, float]

    @property
    def mask(self) -> Bool[NDArray, "x y z"]:
        """Voxels that belong to a region."""
        return self.labels > 0

    def map_of(self, values: Float[NDArray, " regions"]) -> Float[NDArray, "x y z"]:
        """Spread one value a region over its voxels; 0 outside."""
        table = np.zeros(max(r.index for r in self.regions) + 1)
        table[[r.index for r in self.regions]] = values
        return table[self.labels]


def paint(
    phantom: Phantom,
    *,
    voxel_size: float | None = None,
    grid: Sequence[int] | None = None,
    subsamples: int = 1,
) -> PaintedPhantom:
    """Paint a phantom.

    Args:
        phantom: what to paint.
        voxel_size: mm, the same along every axis; the phantom's own where neither this nor `grid` is given.
        grid: voxels an axis instead, over the phantom's field of view.
        subsamples: points an axis in each voxel; above 1, voxels at borders are shared in fractions.

    Raises:
        InputError: a grid that cannot be, or so coarse that a region has no voxel of its own.
    """
    size, shape = _geometry(phantom, voxel_size, grid)
    regions = phantom.regions
    column = np.full(regions[-1].index + 1, len(regions))  # the last column counts what lies outside
    column[[r.index for r in regions]] = np.arange(len(regions))
    filled = np.zeros((math.prod(shape), len(regions) + 1), np.float32)
    offsets = (np.arange(subsamples) + 0.5) / subsamples - 0.5
    rows = np.arange(len(filled))
    for offset in itertools.product(offsets, repeat=phantom.dimensions):
        index = _labels_at(phantom, _points(shape, size, offset)).ravel()
        filled[rows, column[index]] += 1.0
    winner = np.array([r.index for r in regions] + [0])[filled.argmax(axis=1)]
    three = (*shape, 1)[:3]
    labels = winner.reshape(three).astype(np.int16)
    _refuse_lost_regions(regions, labels, size)
    fractions = (filled[:, :-1] / filled[0].sum()).reshape(*three, len(regions))
    return PaintedPhantom(labels, fractions, regions, _affine(three, size), _in_three(size))


def _geometry(
    phantom: Phantom, voxel_size: float | None, grid: Sequence[int] | None
) -> tuple[tuple[float, ...], tuple[int, ...]]:
    if grid is not None:
        if len(grid) != phantom.dimensions or min(grid) < 1:
            raise InputError(
                f"Phantom {phantom.name!r} needs {phantom.dimensions} grid sizes of 1 or more; got {tuple(grid)}."
            )
        shape = tuple(int(n) for n in grid)
        size = tuple(extent / n for extent, n in zip(phantom.field_of_view, shape))
    else:
        voxel = phantom.voxel_size if voxel_size is None else voxel_size
        if not (math.isfinite(voxel) and voxel > 0):
            raise InputError(f"A voxel size of {voxel:g} mm cannot be; give one above 0.")
        shape = tuple(max(1, round(extent / voxel)) for extent in phantom.field_of_view)
        size = (float(voxel),) * phantom.dimensions
    if math.prod(shape) > _MOST_VOXELS:
        raise InputError(f"A grid of {' x '.join(map(str, shape))} voxels is too large; choose larger voxels.")
    return size, shape


def _points(shape: tuple[int, ...], size: tuple[float, ...], offset: tuple[float, ...]) -> list[NDArray[np.floating]]:
    """Coordinates (mm) of a point in every voxel, one open-grid array an axis."""
    axes = [(np.arange(n) - (n - 1) / 2 + o) * v for n, v, o in zip(shape, size, offset)]
    return list(np.meshgrid(*axes, indexing="ij", sparse=True))


def _labels_at(phantom: Phantom, points: list[NDArray[np.floating]]) -> Int[NDArray, "*b"]:
    if phantom.coordinates == "canvas":
        points = [2.0 * p / extent for p, extent in zip(points, phantom.field_of_view)]
    labels = np.zeros(np.broadcast_shapes(*(p.shape for p in points)), int)
    for region in phantom.region:
        for shape in region.shapes:
            labels[_inside(shape, points)] = region.index
    return labels


def _inside(shape: Shape, points: list[NDArray[np.floating]]) -> Bool[NDArray, "*b"]:
    turn = _rotation(shape.angles, len(points))
    moved = [p - c for p, c in zip(points, shape.centre)]
    scaled = [sum(turn[i, j] * moved[i] for i in range(len(moved))) / r for j, r in enumerate(shape.radii)]
    distance = np.sqrt(sum(u**2 for u in scaled))
    edge: NDArray[np.floating] | float = 1.0
    if shape.folds is not None:
        edge = 1.0 + shape.folds.depth * np.cos(shape.folds.around * np.arctan2(scaled[1], scaled[0]))
        if len(scaled) == 3:
            polar = np.arcsin(np.clip(scaled[2] / np.maximum(distance, 1e-12), -1.0, 1.0))
            edge = 1.0 + (edge - 1.0) * np.cos(shape.folds.along * polar)
    inside = distance <= edge
    for half in shape.keep:
        inside = inside & (sum(n * p for n, p in zip(half.normal, points)) > half.above)
    return inside


def _rotation(angles: tuple[float, ...], dimensions: int) -> Float[NDArray, "d d"]:
    """Columns are the shape's own axes: turned about x, then y, then z (2-D: about z)."""
    turn = np.eye(dimensions)
    if len(angles) == 1:
        return _plane_turn(turn, 0, 1, angles[0])
    for (i, j), angle in zip(((1, 2), (2, 0), (0, 1)), angles):
        turn = _plane_turn(np.eye(dimensions), i, j, angle) @ turn
    return turn


def _plane_turn(eye: Float[NDArray, "d d"], i: int, j: int, degrees: float) -> Float[NDArray, "d d"]:
    turn, angle = eye.copy(), math.radians(degrees)
    turn[i, i] = turn[j, j] = math.cos(angle)
    turn[j, i], turn[i, j] = math.sin(angle), -math.sin(angle)
    return turn


def _in_three(size: tuple[float, ...]) -> tuple[float, float, float]:
    """A single slice is as thick as its voxels are wide."""
    return size[0], size[1], size[2] if len(size) == 3 else size[0]


def _affine(shape: tuple[int, ...], size: tuple[float, ...]) -> Float[NDArray, "4 4"]:
    voxel = np.array(_in_three(size))
    affine = np.diag([*voxel, 1.0])
    affine[:3, 3] = -voxel * (np.array(shape) - 1) / 2
    return affine


def _refuse_lost_regions(regions: tuple[Region, ...], labels: Int[NDArray, "x y z"], size: tuple[float, ...]) -> None:
    present = set(np.unique(labels).tolist())
    lost = [r.name for r in regions if r.index not in present]
    if lost:
        raise InputError(f"Voxels of {max(size):g} mm leave no voxel for {', '.join(lost)}; choose smaller ones.")
