"""An image with a segmentation as its diagnosis sees it: voxels, what surrounds them, and their noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import spline_filter

from petkin.diagnosis import Fit, of_nuisance
from petkin.imaging import background_rim
from petkin.io import Regions, Series
from petkin.study.diagnosis.gone import Gone, Undone
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.voxel_noise import VoxelNoise, voxel_noise

Array = NDArray[np.float64]

#: What lies outside the labels is looked at from so many mm away, where little spills over, to so many.
_RIM_MM = (6.0, 18.0)
#: Curves of the regions are mixtures of so many.
_RANK = 4
#: Voxels beside the labels that a slope needs.
BESIDE = 2
#: A frame that holds less than this share of what is predicted is compared as it is.
_FAINT = 0.3


@dataclass(frozen=True)
class Picture:
    """An image with a segmentation, read once.

    Args:
        curves: of the labelled voxels (K, N), kBq/mL.
        place: region of each (N,).
        inside: mask [x, y, z] of the voxels, in C order.
        box: of the grid, around them and the voxels beside them.
        size: voxel edges, mm.
        outside: mean activity around the labels over that inside.
        courses: orthonormal curves of which all others are mixtures (M, K).
        seen: the image in the box as such mixtures [x, y, z, M].
        grain: noise of the voxels, relative to that of counts.
    """

    curves: NDArray[np.float32]
    place: NDArray[np.intp]
    inside: NDArray[np.bool_]
    box: tuple[slice, ...]
    size: tuple[float, ...]
    outside: float
    courses: Array
    seen: Array
    grain: VoxelNoise

    @cached_property
    def splines(self) -> Array:
        """The image as coefficients of cubic splines [M, x, y, z]."""
        return np.stack([spline_filter(maps, mode="nearest") for maps in np.moveaxis(self.seen, -1, 0)])


def read_picture(
    series: Series, regions: Regions, simulator: RegionalSimulator, fit: Fit, gone: Gone | None = None
) -> Picture:
    """The voxels of a segmentation and what surrounds them, reading the file once.

    Args:
        series: the image.
        regions: on its grid.
        simulator: what predicts the regions' means.
        fit: its fit to them.
        gone: a way that is undone first, where the picture is wanted as it would be at rest.
    """
    inside = regions.labels > 0
    size = tuple(float(edge) for edge in series.voxel_mm)
    near, far = (background_rim(regions.labels, reach, size) for reach in _RIM_MM)
    rim = far & ~near
    far = 0.0 if gone is None else gone.most
    beside = [BESIDE + int(np.ceil(far / edge)) for edge in size]
    box, spread = _around(inside, beside), simulator.spread(np.maximum(fit.values, 0.0))
    courses = np.linalg.svd(fit.values, full_matrices=False)[2][:_RANK]
    readers = _readers(courses, spread)
    curves = np.empty((series.count, int(inside.sum())), np.float32)
    seen = np.zeros((*inside[box].shape, len(courses)))
    within = around = 0.0
    undone = None if gone is None else Undone.of(gone, inside, box, size, beside)
    for k, raw in enumerate(series.frames()):
        frame = np.nan_to_num(raw, nan=0.0, posinf=0.0, neginf=0.0)
        frame = frame if undone is None else undone(frame, k)
        curves[k] = frame[inside]
        seen += frame[box][..., None] * readers[:, k]
        weight = float(simulator.clock.frames.duration[k])
        within += weight * float(curves[k].mean())
        around += weight * float(frame[rim].mean()) if rim.any() else 0.0
    place = np.searchsorted(np.array(regions.index), regions.labels[inside])
    labels = np.zeros(inside[box].shape, np.intp)
    labels[inside[box]] = place + 1
    return Picture(
        curves=curves,
        place=place,
        inside=inside,
        box=box,
        size=size,
        outside=float(np.clip(around / within, 0.0, 1.0)) if within > 0 else 0.0,
        courses=courses,
        seen=seen,
        grain=voxel_noise(curves.T, labels, spread, courses, np.array(size)),
    )


def _around(inside: NDArray[np.bool_], beside: Sequence[int]) -> tuple[slice, ...]:
    """The box that holds a mask and so many voxels beside it, within the grid."""
    places = [np.flatnonzero(inside.any(axis=tuple(a for a in range(3) if a != axis))) for axis in range(3)]
    return tuple(slice(max(int(at[0]) - n, 0), int(at[-1]) + n + 1) for at, n in zip(places, beside, strict=True))


def _readers(courses: Array, spread: Array) -> Array:
    """What a voxel's curve is multiplied by to give its mixture of courses, weighted by the noise (M, K)."""
    usual = np.sqrt((spread**2).mean(axis=0))
    return np.linalg.pinv((courses / usual).T) / usual


@dataclass(frozen=True)
class Voxels:
    """A picture with what the simulator says of its regions.

    Args:
        picture: with its voxels.
        fit: of the simulator to the regions' means.
        spread: of the noise, relative (R, K).
        sensitivity: derivatives of the weighted regional curves by their own parameters (R, K, P).
        drawn: the labelled voxels as labels and a point spread have them, in mixtures of courses (N, M); None before
            the width is known.
        expected: means of the regions (R, K), where they are not those of the fit.
        gone: a way that the picture has gone, which is seen, and fitted, as it would be at rest.
    """

    picture: Picture
    fit: Fit
    spread: Array
    sensitivity: Array
    drawn: Array | None = None
    expected: Array | None = None
    gone: Gone | None = None

    @classmethod
    def of(cls, picture: Picture, simulator: RegionalSimulator, fit: Fit) -> Voxels:
        """Beside a fit to the regions' means."""
        own, alone = len(simulator.own), replace(simulator, grain=picture.grain.by_frame)
        spread = alone.spread(np.maximum(fit.values, 0.0))
        derivative = of_nuisance(simulator, fit.state, fit.values)
        mine = np.stack([derivative[r * own : (r + 1) * own, r].T for r in range(len(fit.values))])
        return cls(picture, fit, spread, mine / spread[:, :, None])

    @property
    def place(self) -> NDArray[np.intp]:
        return self.picture.place

    @property
    def inside(self) -> NDArray[np.bool_]:
        return self.picture.inside

    @cached_property
    def residual(self) -> Array:
        """(x - f) / s of every voxel (N, K)."""
        return (self.picture.curves.T - self.fit.values[self.place]) / self.spread[self.place]

    def over_regions(self, columns: Array | NDArray[np.float32]) -> Array:
        """Sums of columns (N, M) over each region (R, M)."""
        count = len(self.fit.values)
        return np.stack([np.bincount(self.place, column, count) for column in columns.T], axis=1).astype(np.float64)

    @cached_property
    def _common(self) -> Array:
        """Factor of a whole frame (K,): what all regions have in common, and no contrast should see."""
        expected = self.fit.values if self.expected is None else self.expected
        weight = np.bincount(self.place, minlength=len(expected))[:, None] * expected / self.spread**2
        found = (weight * self.means).sum(axis=0) / np.maximum((weight * expected).sum(axis=0), 1e-300)
        return np.where(found > _FAINT, found, 1.0)

    @cached_property
    def means(self) -> Array:
        """Of the regions (R, K)."""
        return self.mean_over(self.picture.curves.T)

    def mean_over(self, columns: Array | NDArray[np.float32]) -> Array:
        """Means of columns (N, M) over each region (R, M)."""
        number = np.bincount(self.place, minlength=len(self.fit.values))
        return self.over_regions(columns) / np.maximum(number, 1)[:, None]

    def sums(self, weights: Array) -> Array:
        """Weighted sums over each region (R, K), of weights that sum to zero there."""
        return self.over_regions(weights[:, None] * self.picture.curves.T) / (self._common * self.spread)

    def weighed(self, weights: Array, region: int) -> Array:
        """The same of one region, by several weights of its voxels (D, n) at once (D, K)."""
        curves = self.picture.curves.T[self.place == region]
        return np.asarray(weights @ curves / (self._common * self.spread[region]), np.float64)

    @cached_property
    def seen(self) -> Array:
        """The labelled voxels as mixtures of courses (N, M)."""
        return self.picture.seen[self.inside[self.picture.box]]

    @property
    def expectation(self) -> Array:
        """The same as they are drawn, without noise; as seen before that is known."""
        return self.seen if self.drawn is None else self.drawn

    def total(self, maps: Array) -> Array:
        """Sum over the frames, in units of the noise, of maps that follow the courses (..., M): (...)."""
        usual = np.sqrt((self.spread**2).mean(axis=0))
        return maps @ (self.picture.courses / usual).sum(axis=1)

    def mixed(self, sizes: Array, region: int) -> Array:
        """Columns of a mixture of courses that a contrast of one region holds so much of (M,): (K, M)."""
        return (sizes[:, None] * self.picture.courses).T / self.spread[region][:, None]

    def usual(self, share: float) -> Array:
        """How much of every course a mixture of that size usually has (M,): as regions' curves have."""
        found = np.sqrt(((self.fit.values @ self.picture.courses.T) ** 2).mean(axis=0))
        return share / np.linalg.norm(found) * found

    def beside(self, weights: Array) -> Array:
        """Weighted sums over each region (R, K) beside those of the picture as it is drawn, where there is one."""
        sums = self.sums(weights)
        return sums if self.drawn is None else sums - self.framed(weights, self.drawn, self.picture.courses)

    def there(self, weights: Array) -> Array:
        """Columns of mixtures of the regions' curves (R M, R, K), each region's for itself, by weights of voxels (N,).

        Where edges run within voxels no label tells, so that a contrast may hold some of all curves, as large as what
        the image shows.
        """
        held = self.over_regions(weights[:, None] * self.seen)
        sizes = self.usual(float(np.sqrt((held**2).sum(axis=1).mean())))
        columns = np.zeros((len(held), held.shape[1], *self.spread.shape))
        for r in range(len(held)):
            columns[r, :, r] = self.mixed(sizes, r).T
        return columns.reshape(-1, *self.spread.shape)

    def centred(self, weights: Array) -> Array:
        """Weights less their mean over the region, of unit length in each."""
        free = self.apart(weights[:, None])[:, 0]
        length = np.sqrt(self.over_regions(free[:, None] ** 2)[:, 0])
        return free / np.where(length > 0, length, np.inf)[self.place]

    def apart(self, columns: Array) -> Array:
        """Columns (N, M) less their means over the region."""
        return columns - self.mean_over(columns)[self.place]

    def framed(self, weights: Array, maps: Array, courses: Array) -> Array:
        """sum_v w_v m_v(k) / s_r(k) by region (R, K), of maps (N, M) that follow courses (M, K)."""
        return (self.over_regions(weights[:, None] * maps) @ courses) / self.spread
