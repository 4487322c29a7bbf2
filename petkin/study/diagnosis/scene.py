"""What motion and gains that differ across the head add to the voxels of an image, as it is seen.

Maps follow the picture's courses: [N, M] by voxel and course.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from petkin.imaging import PLANES, FrameSchedule, Leg, middle_and_rim, origins
from petkin.study.diagnosis.gone import DRIFT, PARTS, STEP, between
from petkin.study.diagnosis.picture import BESIDE, Picture, Voxels

Array = NDArray[np.float64]

#: Effects that move the picture, and that change it by gains.
MOTIONS, GAINS = (STEP, DRIFT), ("attenuation_mismatch",)
#: Priors: mm of motion, relative gain at the edge of the head.
MOTION_MM, GAIN = 10.0, 0.2
#: When a drift begins and ends, as shares of the scan; the first is the whole of it.
_DRIFTS = ((0.0, 1.0), (0.0, 1 / 3), (0.0, 2 / 3), (1 / 3, 2 / 3), (1 / 3, 1.0), (2 / 3, 1.0))


def drifts(frames: FrameSchedule) -> list[Array]:
    """Courses (K,) that a drift may have over the frames, that over the whole scan first."""
    passed = frames.mid / frames.end[-1]
    return [np.clip((passed - begins) / (ends - begins), 0.0, 1.0) for begins, ends in _DRIFTS]


def laid(picture: Picture, legs: Sequence[Leg]) -> Array:
    """The labelled voxels as mixtures of courses where the picture has moved so (N, M), a cubic spline between voxels.

    Reference: Unser M. IEEE Signal Process Mag 1999;16(6):22-38.
    """
    labelled = picture.inside[picture.box]
    came = origins(np.argwhere(labelled).T.astype(np.float64), legs, picture.size, labelled)
    return np.stack([map_coordinates(maps, came, mode="nearest", prefilter=False) for maps in picture.splines], axis=1)


@dataclass(frozen=True)
class Scene:
    """The image as it is seen."""

    voxels: Voxels

    @property
    def axes(self) -> list[int]:
        """Of the grid, those with more than one voxel."""
        return [axis for axis, size in enumerate(self.voxels.inside.shape) if size > 1]

    @cached_property
    def motions(self) -> dict[int, Array]:
        """What a millimetre of motion adds, by way of moving.

        dx = - u . grad x,   or (x moved by all of a long way - x) / its mm
        """
        along = {axis: -slope for axis, slope in self._slopes.items()}
        turned = {3 + n: self._turn(plane) for n, plane in enumerate(PLANES) if set(plane) <= set(self.axes)}
        gone = {} if self.voxels.gone is None else {self.voxels.gone.way: self._parts[-1]}
        return along | turned | gone

    def parts(self, name: str, way: int) -> list[Array]:
        """Maps that together, each with its course, are what a millimetre adds of a motion."""
        return self._parts if self._gradual(name, way) else [self.motions[way]]

    def courses(self, name: str, way: int, course: Array) -> list[Array]:
        """The courses (K,) of those maps, where that of the motion goes from 0 to 1: of a step the share of every
        frame, of a drift the part of its way."""
        if not self._gradual(name, way):
            return [course]
        return list(between(course, PARTS)[1:])

    def _gradual(self, name: str, way: int) -> bool:
        """Whether a motion goes a long way by and by."""
        gone = self.voxels.gone
        return name == DRIFT and gone is not None and way == gone.way

    @cached_property
    def _parts(self) -> list[Array]:
        """What parts of a long way add, by its mm."""
        gone, seen, picture = self.voxels.gone, self.voxels.seen, self.voxels.picture
        assert gone is not None
        return [(laid(picture, gone.legs(part)) - seen) / gone.mm for part in PARTS[1:]]

    @cached_property
    def bends(self) -> list[Array]:
        """Second derivatives, 1/mm^2: what large motion does beside its slope."""
        picture = self.voxels.picture
        labelled = self.voxels.inside[picture.box]
        slopes = {axis: _slope(picture.seen, picture.size[axis], axis) for axis in self.axes}
        pairs = combinations_with_replacement(slopes, 2)
        return [_slope(slopes[one], picture.size[other], other)[labelled] for one, other in pairs]

    @cached_property
    def thirds(self) -> list[Array]:
        """Third derivatives along the axes, 1/mm^3: what is left of edges beside both."""
        picture = self.voxels.picture
        labelled, found = self.voxels.inside[picture.box], []
        for axis in self.axes:
            maps = picture.seen
            for _ in range(3):
                maps = _slope(maps, picture.size[axis], axis)
            found.append(maps[labelled])
        return found

    def tilt(self, axis: int) -> Array:
        """What a gain adds that grows along an axis, by one from the middle to the edge of the head."""
        return self._along(axis)[:, None] * self.voxels.seen

    def weighing_tilt(self, axis: int) -> Array:
        """The same in the picture as it is drawn, which shares no noise with the frames that it weighs."""
        return self._along(axis)[:, None] * self.voxels.expectation

    def _along(self, axis: int) -> Array:
        place = np.nonzero(self.voxels.inside)[axis].astype(np.float64)
        return np.asarray(2.0 * (place - place.mean()) / max(float(np.ptp(place)), 1.0), np.float64)

    def _turn(self, plane: tuple[int, int]) -> Array:
        """Of a turn about the middle of the labels, by a millimetre at their rim."""
        one, two = plane
        size = np.array(self.voxels.picture.size)
        middle, rim = middle_and_rim(self.voxels.inside, plane, size)
        at = (np.argwhere(self.voxels.inside) - middle) * size
        return np.asarray((at[:, [two]] * self._slopes[one] - at[:, [one]] * self._slopes[two]) / rim, np.float64)

    @cached_property
    def _slopes(self) -> dict[int, Array]:
        """Derivatives, 1/mm, by axis."""
        picture = self.voxels.picture
        labelled = self.voxels.inside[picture.box]
        return {axis: _slope(picture.seen, picture.size[axis], axis)[labelled] for axis in self.axes}


def _slope(maps: Array, edge: float, axis: int) -> Array:
    """Derivative of maps [x, y, z, M] along an axis, 1/mm, as sharp as two neighbours to either side tell it.

    x' = (8 (x_1 - x_-1) - (x_2 - x_-2)) / 12,   beyond the grid as at its end

    Reference: Fornberg B. Math Comput 1988;51:699-706, table 1 (central, fourth order).
    """
    pad = [(BESIDE, BESIDE) if a == axis else (0, 0) for a in range(maps.ndim)]
    x = np.moveaxis(np.pad(maps, pad, mode="edge"), axis, 0)
    slope = (8.0 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12.0 * edge)
    return np.moveaxis(slope, 0, axis)
