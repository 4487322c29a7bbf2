"""Three orthogonal planes through the centre of a mask: which voxels, which way up, which side is left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Fewer voxels than this across or up make no picture worth drawing.
_FEWEST = 4
_MARGIN = 2
#: Axis pairs: patient right/left, front/back, up/down; the second letter is where the axis starts.
_PAIRS = ("RL", "AP", "SI")
_NAMES = ("sagittal", "coronal", "axial")


@dataclass(frozen=True)
class Plane:
    """One cut through a volume.

    Args:
        name: "axial", "coronal", "sagittal", or the array axes where directions are not known.
        axis: array axis that is cut.
        index: voxel index along it, from 0.
        across, up: array axes drawn to the right and upwards.
        reverse_across, reverse_up: whether rising index runs left or down.
        box: slice kept along each array axis.
        sides: letters at the left and right edge, "" where not known.
        size_mm: width and height.
    """

    name: str
    axis: int
    index: int
    across: int
    up: int
    reverse_across: bool
    reverse_up: bool
    box: tuple[slice, slice, slice]
    sides: tuple[str, str]
    size_mm: tuple[float, float]

    @property
    def label(self) -> str:
        return f"{self.name}, {'ijk'[self.axis]} = {self.index}"

    def cut(self, volume: NDArray) -> NDArray:
        """The plane as rows from bottom to top, columns from left to right."""
        window = list(self.box)
        window[self.axis] = slice(self.index, self.index + 1)
        flat = volume[tuple(window)].squeeze(self.axis)
        flat = flat.T if self.across < self.up else flat
        return flat[:: -1 if self.reverse_up else 1, :: -1 if self.reverse_across else 1]


def orthogonal_planes(inside: NDArray[np.bool_], voxel_mm: tuple[float, float, float], axes: str = "") -> list[Plane]:
    """Axial, coronal and sagittal plane through the centre of mass of a mask, cropped to it.

    Right is drawn on the right (neurological). A volume of one or few slices gives only the planes it has.

    Args:
        inside: the mask, [x, y, z].
        voxel_mm: voxel edges, mm.
        axes: directions of rising index, e.g. "RAS"; "" when not known.
    """
    place = [next(i for i, c in enumerate(axes.upper()) if c in pair) for pair in _PAIRS] if axes else [0, 1, 2]
    centre, box = _centre_and_box(inside)
    planes = []
    for normal in (2, 1, 0):
        across, up = [d for d in (0, 1, 2) if d != normal]
        shape = [box[place[d]].stop - box[place[d]].start for d in (across, up)]
        if min(inside.shape[place[across]], inside.shape[place[up]]) < _FEWEST:
            continue
        planes.append(
            Plane(
                name=_NAMES[normal] if axes else f"{'ijk'[across]}–{'ijk'[up]} plane",
                axis=place[normal],
                index=centre[place[normal]],
                across=place[across],
                up=place[up],
                reverse_across=_reversed(axes, place[across]),
                reverse_up=_reversed(axes, place[up]),
                box=box,
                sides=(_PAIRS[across][1], _PAIRS[across][0]) if axes else ("", ""),
                size_mm=(shape[0] * voxel_mm[place[across]], shape[1] * voxel_mm[place[up]]),
            )
        )
    return planes


def _reversed(axes: str, axis: int) -> bool:
    return bool(axes) and axes[axis].upper() in "LPI"


def _centre_and_box(inside: NDArray[np.bool_]) -> tuple[list[int], tuple[slice, slice, slice]]:
    if not inside.any():
        inside = np.ones_like(inside)
    centre, box = [], []
    for axis, size in enumerate(inside.shape):
        profile = inside.sum(axis=tuple(a for a in range(3) if a != axis))
        used = np.flatnonzero(profile)
        centre.append(round(float(np.average(np.arange(size), weights=profile))))
        box.append(slice(max(int(used[0]) - _MARGIN, 0), min(int(used[-1]) + 1 + _MARGIN, size)))
    return centre, (box[0], box[1], box[2])
