"""What an image shows beyond the means of its regions: blur, motion, gains that differ across the head.

Every spatial effect is looked for by a contrast, a weighted sum over the voxels of each region whose weights sum to
zero, so that it knows nothing of the region's mean: the blurred image for the point spread, the gradient along an axis
for motion, the place along it for attenuation. Its nuisance is kinetics that vary within regions and, for what sets in
during the scan, what was there before.

    c_r(k) = sum_v w_v (x_v(k) - f_r(k)) / s_r(k),   sum_v w_v = 0,   sum_v w_v^2 = 1
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import Contrasted, Fit, Noise, Pattern, judge_contrasts, of_nuisance
from petkin.effects.imaging import after
from petkin.imaging import FrameSchedule, background_rim, blur
from petkin.io import Regions, Series
from petkin.study.diagnosis.regional import RegionalSimulator, onsets

Array = NDArray[np.float64]

#: FWHM tried, mm, and the one whose picture weighs the voxels.
_WIDTHS, _TYPICAL = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 14.0), 6.0
#: What lies outside the labels is looked at from one FWHM away, where little spills over, to so many.
_BEYOND = 3.0
#: Priors: mm of motion, relative gain at the edge of the head, and blur in units of the FWHM tried.
_MOTION_MM, _GAIN = 10.0, 0.2
#: Variance of the logarithm of kinetics within a region, times the voxels that vary together.
_VARIED = 1.0
#: What was there all the time may be so many times as large as the prior of what sets in.
_BEFORE = 10.0
#: Curves of the regions are mixtures of so many; rounds in which the sharp image is found.
_RANK, _SHARPENED = 4, 4
_ONSETS, _DRAWS = 40, 400
#: Evidence that contrasts hold against an effect counts no more than this: a head may move in ways that no axis shows.
_AGAINST = -1.0


@dataclass(frozen=True)
class Voxels:
    """The voxels of a segmentation, with what the simulator says of their regions.

    Args:
        curves: (K, N), kBq/mL.
        place: region of each (N,).
        inside: mask [x, y, z] of the voxels, in C order.
        size: voxel edges, mm.
        outside: mean activity around the labels over that inside.
        fit, noise: of the simulator to the regions' means.
        sensitivity: derivatives of the weighted regional curves by their own parameters (R, K, P).
    """

    curves: NDArray[np.float32]
    place: NDArray[np.intp]
    inside: NDArray[np.bool_]
    size: tuple[float, ...]
    outside: float
    fit: Fit
    noise: Noise
    sensitivity: Array

    @cached_property
    def residual(self) -> Array:
        """(x - f) / s of every voxel (N, K)."""
        spread = self.noise.spread
        return (self.curves.T - self.fit.values[self.place]) / spread[self.place]

    def sums(self, weights: Array) -> Array:
        """Weighted sums of the residual over each region (R, K)."""
        count = len(self.fit.values)
        sums = [np.bincount(self.place, weights * row, count) for row in self.residual.T]
        return np.stack(sums, axis=1).astype(np.float64)

    def centred(self, weights: Array) -> Array:
        """Weights less their mean over the region, of unit length in each."""
        count = len(self.fit.values)
        number = np.maximum(np.bincount(self.place, minlength=count), 1)
        free = weights - (np.bincount(self.place, weights, count) / number)[self.place]
        length = np.sqrt(np.bincount(self.place, free**2, count))
        return free / np.where(length > 0, length, np.inf)[self.place]

    def framed(self, weights: Array, maps: Array, courses: Array) -> Array:
        """sum_v w_v m_v(k) / s_r(k) by region (R, K), of maps (N, M) that follow courses (M, K)."""
        count = len(self.fit.values)
        sums = np.stack([np.bincount(self.place, weights * column, count) for column in maps.T], axis=1)
        return (sums @ courses) / self.noise.spread


def read_voxels(series: Series, regions: Regions, simulator: RegionalSimulator, fit: Fit, noise: Noise) -> Voxels:
    """Voxels of a segmentation, reading the file once.

    Args:
        series: the image.
        regions: on its grid.
        simulator: what predicts the regions' means.
        fit, noise: its fit to them.
    """
    inside = regions.labels > 0
    size = tuple(float(edge) for edge in series.voxel_mm)
    rim = background_rim(regions.labels, _BEYOND * _TYPICAL, size) & ~background_rim(regions.labels, _TYPICAL, size)
    curves = np.empty((series.count, int(inside.sum())), np.float32)
    within = around = 0.0
    for k, frame in enumerate(series.frames()):
        curves[k] = np.nan_to_num(frame[inside], nan=0.0, posinf=0.0, neginf=0.0)
        weight = float(simulator.clock.frames.duration[k])
        within += weight * float(curves[k].mean())
        around += weight * float(np.nan_to_num(frame[rim]).mean()) if rim.any() else 0.0
    own = len(simulator.own)
    derivative = of_nuisance(simulator, fit.state, fit.values)
    count = len(fit.values)
    mine = np.stack([derivative[r * own : (r + 1) * own, r].T for r in range(count)])
    return Voxels(
        curves=curves,
        place=np.searchsorted(np.array(regions.index), regions.labels[inside]),
        inside=inside,
        size=size,
        outside=float(np.clip(around / within, 0.0, 1.0)) if within > 0 else 0.0,
        fit=fit,
        noise=noise,
        sensitivity=mine / noise.spread[:, :, None],
    )


@dataclass(frozen=True)
class Looked:
    """What contrasts say, and the width of the point spread that the image shows, mm."""

    contrasted: Contrasted
    width_mm: float

    @property
    def log_odds(self) -> dict[str, float]:
        """What the image lends its effects, by name."""
        return {name: max(value, _AGAINST) for name, value in self.contrasted.evidence.items()}


def look(voxels: Voxels, simulator: RegionalSimulator, names: frozenset[str], *, seed: int) -> Looked | None:
    """Contrasts of an image against every spatial effect that may be missing; None where there is none of them.

    Args:
        voxels: of its segmentation.
        simulator: what predicts the regions' means.
        names: of the candidates.
        seed: of the draws of noise.
    """
    scene = _Scene.of(voxels)
    families, patterns = scene.blurred()
    width = scene.width(families["blur"][0], patterns)
    for axis in scene.axes:
        for more_families, more in (scene.moving(axis, width, simulator), scene.tilted(axis, simulator)):
            families |= more_families
            patterns += more
    patterns = [pattern for pattern in patterns if pattern.name in names]
    if not patterns:
        return None
    least = simulator.accuracy * float(np.median(np.abs(voxels.fit.values) / voxels.noise.spread)) + 1e-300
    rng = np.random.default_rng((seed, len(patterns)))
    return Looked(judge_contrasts(families, patterns, least=least, draws=_DRAWS, rng=rng), width)


def _through(maps: Array, width: float, size: tuple[float, ...]) -> Array:
    return np.asarray(blur(maps, width, size), np.float64)


_Found = tuple[dict[str, tuple[Array, Array]], list[Pattern]]


@dataclass(frozen=True)
class _Scene:
    """The predicted image: maps [x, y, z, M] that follow courses (M, K), each region at its predicted curve."""

    voxels: Voxels
    maps: Array
    courses: Array

    @classmethod
    def of(cls, voxels: Voxels) -> _Scene:
        left, size, courses = np.linalg.svd(voxels.fit.values, full_matrices=False)
        rank = min(_RANK, size.size)
        levels = left[:, :rank] * size[:rank]
        maps = np.empty((*voxels.inside.shape, rank))
        maps[...] = voxels.outside * levels[voxels.place].mean(axis=0)
        maps[voxels.inside] = levels[voxels.place]
        return cls(voxels, maps, courses[:rank])

    @property
    def axes(self) -> Iterator[int]:
        return (axis for axis, size in enumerate(self.voxels.inside.shape) if size > 1)

    @property
    def _varied(self) -> Array:
        """Columns of kinetics that vary within regions (R, K, P)."""
        return np.sqrt(_VARIED) * self.voxels.sensitivity

    def _seen(self, width: float) -> Array:
        """The image through a point spread, as sharp before it as its regions' means demand (x, y, z, M).

        Reference: van Cittert PH. Z Phys 1931;69:298-308 (repeated re-blurring).
        """
        inside, wanted = self.voxels.inside, self._means(self.maps)
        sharp = self.maps.copy()
        for _ in range(_SHARPENED):
            short = wanted - self._means(_through(sharp, width, self.voxels.size))
            sharp[inside] += short[self.voxels.place]
        return _through(sharp, width, self.voxels.size)

    def _means(self, maps: Array) -> Array:
        """Means over the regions (R, M)."""
        place, columns = self.voxels.place, maps[self.voxels.inside].T
        number = np.maximum(np.bincount(place), 1)
        return np.stack([np.bincount(place, column) / number for column in columns], axis=1)

    def _mean(self, maps: Array) -> Array:
        """Their mean over the frames (N,)."""
        return maps @ self.courses.mean(axis=1)

    def blurred(self) -> _Found:
        """One contrast for the point spread, with a pattern a width."""
        inside = self.voxels.inside
        weights = self.voxels.centred(self._mean(self._seen(_TYPICAL)[inside]))
        rows = [self.voxels.framed(weights, self._seen(width)[inside], self.courses) for width in _WIDTHS]
        patterns = [
            Pattern("partial_volume", "blur", row, {}, scale=width, signed=False)
            for width, row in zip(_WIDTHS, rows, strict=True)
        ]
        return {"blur": (self.voxels.sums(weights), self._varied)}, patterns

    def width(self, contrast: Array, patterns: list[Pattern]) -> float:
        """The FWHM at which the predicted contrast is as large as the image's, mm."""
        typical = patterns[_WIDTHS.index(_TYPICAL)].rows
        sizes = np.maximum.accumulate([0.0, *(float((typical * p.rows).sum()) for p in patterns)])
        return float(np.interp(float((typical * contrast).sum()), sizes, [0.0, *_WIDTHS]))

    def moving(self, axis: int, width: float, simulator: RegionalSimulator) -> _Found:
        """Motion along an axis, mm: a step, or a drift."""
        seen = self._seen(max(width, self.voxels.size[axis]))
        slope = np.gradient(seen, self.voxels.size[axis], axis=axis)[self.voxels.inside]
        family = f"motion {axis}"
        return self._setting_in(family, ("motion_step", "motion_drift"), axis, slope, _MOTION_MM, simulator)

    def tilted(self, axis: int, simulator: RegionalSimulator) -> _Found:
        """A gain that grows along an axis, by so much from the middle to the edge of the head."""
        place = np.nonzero(self.voxels.inside)[axis].astype(np.float64)
        place = 2.0 * (place - place.mean()) / max(float(np.ptp(place)), 1.0)
        gained = place[:, None] * self.maps[self.voxels.inside]
        return self._setting_in(f"gain {axis}", ("attenuation_mismatch",), axis, gained, _GAIN, simulator)

    def _setting_in(
        self, family: str, names: tuple[str, ...], axis: int, maps: Array, width: float, simulator: RegionalSimulator
    ) -> _Found:
        weights = self.voxels.centred(self._mean(maps))
        always = self.voxels.framed(weights, maps, self.courses)
        frames = simulator.clock.frames
        patterns = []
        for name in names:
            for setting, course in _courses(name, frames, simulator):
                place = {"axis": float(axis), **setting}
                patterns.append(Pattern(name, family, always * course, place, width=width))
        nuisance = np.concatenate([self._varied, (_BEFORE * width * always)[:, :, None]], axis=2)
        return {family: (self.voxels.sums(weights), nuisance)}, patterns


def _courses(
    name: str, frames: FrameSchedule, simulator: RegionalSimulator
) -> Iterator[tuple[dict[str, float], Array]]:
    """Settings and courses over the frames of what sets in during the scan."""
    if name == "motion_drift":
        yield {}, frames.mid / frames.end[-1]
        return
    for onset in onsets(simulator.clock, _ONSETS):
        yield {"onset": onset}, after(simulator.clock, onset)
