"""What the spatial effects that a simulator includes may have added to an image: nuisance of its contrasts.

Regions tell how large such an effect is along one way. What an image shows of it is left free: motion in every way of
moving, with what large motion does to edges beside their slope, and gains along every axis and in smooth waves over the
head, each with the course of the effect, as large as its prior lets it be. A step may be early or late by a frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.effects import Effect
from petkin.effects.imaging import after
from petkin.study.diagnosis.fields import fields_of
from petkin.study.diagnosis.gone import DRIFT
from petkin.study.diagnosis.including import without
from petkin.study.diagnosis.joint import added
from petkin.study.diagnosis.picture import Voxels
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.scene import GAIN, GAINS, MOTION_MM, MOTIONS, Scene, drifts

Array = NDArray[np.float64]

#: Voxels that tell what an image holds of included effects.
_TOLD_BY = 4000
#: Share of its way that the picture may seem to drift besides: no two pictures are alike, and one of all frames is one
#: of both places. Without it 2 of 11 images with an included step of 3 mm were taken to drift as well.
_INEXACT = 0.05


def spatial(simulator: RegionalSimulator) -> tuple[Effect, ...]:
    """Those of the effects that a simulator includes which an image may show."""
    return tuple(effect for effect in simulator.includes if effect.name in MOTIONS + GAINS)


def bare(simulator: RegionalSimulator) -> RegionalSimulator:
    """The simulator without those."""
    return without(simulator, frozenset(effect.name for effect in spatial(simulator)))


@dataclass(frozen=True)
class _Part:
    """Maps (N, M), and courses (c, K) that each of them may have, times the usual size of both."""

    maps: Callable[[], Iterable[Array]]
    courses: Array


@dataclass(frozen=True)
class Standing:
    """What may have been added to the voxels of a segmentation."""

    voxels: Voxels
    parts: tuple[_Part, ...]

    @classmethod
    def of(cls, voxels: Voxels, simulator: RegionalSimulator) -> Standing:
        """By the effects that a simulator includes."""
        scene = Scene(voxels)
        return cls(voxels, tuple(part for e in spatial(simulator) for part in _parts(e, scene, simulator)))

    def joint(self, weights: Array, regions: NDArray[np.intp]) -> Array:
        """What several contrasts of each of some regions may hold of it, by weights (F, N): (n, F R, K)."""
        shape = (len(weights) * len(regions), self.voxels.spread.shape[1])
        found = [np.zeros((0, *shape))]
        for part in self.parts:
            held = added(self.voxels, weights, regions, part.maps())
            found.append((held[:, None] * part.courses[:, None]).reshape(-1, *shape))
        return np.concatenate(found)

    def beside(self, residual: Array) -> Array:
        """Residuals of the voxels (N, K) without what of it they are likely to hold.

        a = (G + v 1)^-1 A' x,   G = A' A,   of columns A whose amplitudes a have variance one, x of variance v

        told by every n-th voxel, a few thousand of them.
        """
        if not self.parts:
            return residual
        few = np.arange(0, len(residual), max(len(residual) // _TOLD_BY, 1))
        square, score = self._normal(residual, few)
        noise = float(residual[few].var())
        sizes = iter(np.linalg.solve(square + noise * np.eye(len(score)), score))
        left = residual.copy()
        for part in self.parts:
            mixed = np.zeros((len(part.courses), *self.voxels.seen.shape))
            for maps in part.maps():
                for held in mixed:
                    held += next(sizes) * maps
            for held, course in zip(mixed, part.courses, strict=True):
                left -= held @ (self.voxels.picture.courses * course) / self.voxels.spread[self.voxels.place]
        return left

    def _normal(self, residual: Array, few: NDArray[np.intp]) -> tuple[Array, Array]:
        """A' A and A' x over some voxels, region by region: maps are few numbers a voxel, whatever the frames."""
        shapes = [np.stack([maps[few] for maps in part.maps()]) for part in self.parts]
        count = [len(maps) * len(part.courses) for maps, part in zip(shapes, self.parts, strict=True)]
        ends = np.cumsum([0, *count])
        square, score = np.zeros((ends[-1], ends[-1])), np.zeros(ends[-1])
        for r, spread in enumerate(self.voxels.spread):
            mine = self.voxels.place[few] == r
            courses = [part.courses[:, None] * self.voxels.picture.courses / spread for part in self.parts]
            for i, one in enumerate(courses):
                here, at = shapes[i][:, mine], slice(ends[i], ends[i + 1])
                score[at] += np.einsum("anm,cmk,nk->ac", here, one, residual[few[mine]], optimize=True).ravel()
                for j, other in enumerate(courses):
                    there = shapes[j][:, mine]
                    shared = np.einsum("anm,bnp->abmp", here, there, optimize=True)
                    block = np.einsum("abmp,cmk,dpk->acbd", shared, one, other, optimize=True)
                    square[at, ends[j] : ends[j + 1]] += block.reshape(count[i], count[j])
        return square, score


def _parts(effect: Effect, scene: Scene, simulator: RegionalSimulator) -> list[_Part]:
    courses = _courses(effect, simulator)
    if not len(courses):
        return []
    if effect.name in MOTIONS:
        gone, far = scene.voxels.gone, _INEXACT * _way(effect, scene, simulator)
        found = [
            _Part(scene.motions.values, MOTION_MM * courses),
            _Part(lambda: scene.bends, 0.5 * MOTION_MM**2 * courses**2),
            _Part(lambda: scene.thirds, MOTION_MM**3 / 6.0 * courses**3),
        ]
        drifting = drifts(simulator.clock.frames)
        if far:
            found.append(_Part(scene.motions.values, far * np.stack(drifting)))
        if gone is not None:
            by_part = np.stack(scene.courses(DRIFT, gone.way, drifting[0]))
            found.append(_Part(lambda: scene.parts(DRIFT, gone.way), far * by_part))
        return found
    tilts = _Part(lambda: (scene.tilt(axis) for axis in scene.axes), GAIN * courses)
    voxels = scene.voxels
    return [tilts, _Part(lambda: (field[:, None] * voxels.seen for field in fields_of(voxels)), GAIN * courses)]


def _way(effect: Effect, scene: Scene, simulator: RegionalSimulator) -> float:
    """How far the image shows motion to have gone, mm; 0 where it is not sure that any has."""
    gone, seen = scene.voxels.gone, simulator.seen.get(effect.name)
    if gone is not None:
        return gone.most
    return 0.0 if seen is None else seen.value


def _courses(effect: Effect, simulator: RegionalSimulator) -> Array:
    """Of an effect over the frames (c, K); none of one that could not be seen."""
    if effect.name == "motion_drift":
        return np.stack(drifts(simulator.clock.frames))
    onset = simulator.settings.get(effect.name, {}).get("onset")
    if onset is None:
        return np.zeros((0, len(simulator.clock.frames)))
    course = after(simulator.clock, float(onset))
    at = int(np.searchsorted(simulator.clock.frames.end, float(onset), side="right"))
    near = slice(max(at - 1, 0), at + 2)
    return np.concatenate([course[None], np.eye(len(course))[near]])
