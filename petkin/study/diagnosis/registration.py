"""Where what is scanned has moved: the picture that labels and fits predict, laid onto every frame.

    Q_k = (x_k . p_k)^2 / (p_k . p_k)

over the labelled voxels, with x_k a frame in units of its noise and p_k the predicted one, moved; how bright a frame is
is left free. The motion is the step or drift along one way by which Q, summed over the frames in units of twice the
variance of what no motion explains, grows most; then it may go along other ways as well, by so much for each mm of the
first.

Tracer that goes elsewhere changes the picture too; that is why every frame has a prediction of its own, and why what is
found is believed only where it is far.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from petkin.effects.imaging import after
from petkin.imaging import FrameObservation, Leg, origins
from petkin.study.diagnosis.gone import DRIFT, PARTS, STEP, Gone, between
from petkin.study.diagnosis.onsets import onsets
from petkin.study.diagnosis.picture import Voxels
from petkin.study.diagnosis.scene import Scene, drifts

Array = NDArray[np.float64]

#: How far the picture is tried along one way, mm either way, and beside the best of those.
_FAR_MM = (1.0, 2.0, 3.0, 4.5, 6.0, 8.0, 10.0, 12.0, 15.0, 18.0, 22.0)
_NEAR_MM = (-1.5, -1.0, -0.5, 0.5, 1.0, 1.5)
#: The same along others, as shares of the first.
_BESIDE, _NEARER = (-0.8, -0.5, -0.3, -0.15, 0.15, 0.3, 0.5, 0.8), (-0.07, 0.07)
#: Another way counts where it gains so much of what the first has gained; so many of them.
_MORE, _OTHERS = 0.02, 2
#: Motion that is less, mm, is left to contrasts: of 60 pictures that did not move none was laid on better by as much.
_LEAST_MM = 4.0
#: Onsets at most, which no scan has, and the shares of a frame at which they are tried; for which it is laid.
_ONSETS, _WITHIN, _SHARES = 1000, (0.0, 0.5), (0.0, 0.5, 1.0)


def registered(voxels: Voxels, drawn: Array, clock: FrameObservation) -> Gone | None:
    """The motion that lays a predicted picture onto the frames best; None where it is not far.

    Args:
        voxels: of the segmentation.
        drawn: the picture as labels and a point spread have it [x, y, z, M], in courses.
        clock: frames.
    """
    laying, ways = _Laying.of(voxels, drawn), [*Scene(voxels).motions]
    tried = np.array([-far for far in reversed(_FAR_MM)] + [0.0, *_FAR_MM])
    tables = {way: np.stack([laying((Leg(way, far),)) for far in tried]) for way in ways}
    laying = laying.weighted(np.max([table.max(axis=(0, 1)) for table in tables.values()], axis=0))
    tables = {way: table * laying.weight for way, table in tables.items()}
    every = [each for way in ways for each in _along(way, tried, tables[way], clock)]
    _, first = max(every, key=_gained)
    if abs(first.mm) < _LEAST_MM:
        return None
    near = np.setdiff1d(first.mm + np.array(_NEAR_MM), tried)
    table = np.concatenate([tables[first.way], *(laying((Leg(first.way, far),))[None] for far in near)])
    order = np.argsort([*tried, *near])
    gain, found = max(_along(first.way, np.append(tried, near)[order], table[order], clock), key=_gained)
    at_rest, least = laying(()), _MORE * gain
    for _ in range(_OTHERS):
        others = [way for way in ways if way != found.way and way not in {leg.way for leg in found.beside}]
        each = [found.aside(way, share) for way in others for share in _BESIDE]
        if not each:
            break
        more, best = max(((laying.gain(gone, at_rest), gone) for gone in each), key=_gained)
        if more < gain + least:
            break
        last = best.beside[-1]
        nearer = [found.aside(last.way, last.far + share) for share in _NEARER]
        gain, found = max([(more, best), *((laying.gain(gone, at_rest), gone) for gone in nearer)], key=_gained)
    told = {name: [(gone.setting, each) for each, gone in every if gone.name == name] for name in (STEP, DRIFT)}
    return replace(found, told=told)


def _gained(found: tuple[float, Gone]) -> float:
    return found[0]


@dataclass(frozen=True)
class _Laying:
    """Lays a predicted picture onto frames.

    Args:
        voxels: whose labels move.
        at: places of the labelled voxels (3, N).
        frames: in units of their noise (K, N).
        maps: the predicted picture [M, x, y, z].
        courses: that it follows, in the same units (M, K).
        weight: of every frame (K,).
    """

    voxels: Voxels
    at: Array
    frames: Array
    maps: Array
    courses: Array
    weight: Array

    @classmethod
    def of(cls, voxels: Voxels, drawn: Array) -> _Laying:
        usual = np.sqrt((voxels.spread**2).mean(axis=0))
        frames, courses = voxels.picture.curves / usual[:, None], voxels.picture.courses / usual
        at, even = np.argwhere(voxels.inside).T.astype(float), np.ones(len(frames))
        return cls(voxels, at, frames, np.moveaxis(drawn, -1, 0), courses, even)

    def weighted(self, most: Array) -> _Laying:
        """With Q in log units, as the most of it (K,) leaves noise of every frame."""
        left = (self.frames**2).mean(axis=1) - most / self.frames.shape[1]
        return replace(self, weight=0.5 / np.maximum(left, 1e-300))

    @cached_property
    def _at_rest(self) -> Array:
        return self._seen(())

    def _seen(self, legs: Sequence[Leg]) -> Array:
        """The labelled voxels of the picture, moved (N, M)."""
        came = origins(self.at, legs, self.voxels.picture.size, self.voxels.inside)
        return np.stack([map_coordinates(each, came, order=1, mode="nearest") for each in self.maps], axis=1)

    def __call__(self, legs: Sequence[Leg]) -> Array:
        """Q of every frame with the picture moved so for half of it and for all of it (2, K)."""
        there = self._seen(legs)
        each = []
        for picture in (0.5 * (self._at_rest + there), there):
            along = np.einsum("km,mk->k", self.frames @ picture, self.courses)
            size = np.einsum("mk,mn,nk->k", self.courses, picture.T @ picture, self.courses)
            each.append(self.weight * np.sign(along) * along**2 / np.maximum(size, 1e-300))
        return np.stack(each)

    def gain(self, gone: Gone, at_rest: Array) -> float:
        """What a motion gains over rest."""
        if not gone.gradual:
            return float(_in_part(self(gone.legs()) - at_rest, gone.course))
        each = np.stack([self(gone.legs(part))[1] for part in PARTS[1:]])
        return float(((each - at_rest[1]) * between(gone.course, PARTS)[1:]).sum())


def _in_part(gain: Array, share: Array) -> Array:
    """What frames that lie so for a share of them (K,) gain together, where half and whole ones gain so (..., 2, K)."""
    return (gain * between(share, _SHARES)[1:]).sum(axis=(-2, -1))


def _along(way: int, tried: Array, table: Array, clock: FrameObservation) -> Iterator[tuple[float, Gone]]:
    """Motions of one way, each with what it gains over rest; table (far, 2, K)."""
    gain = table - table[np.flatnonzero(tried == 0.0)[0]]
    for onset in onsets(clock, _ONSETS, _WITHIN, scanner=True):
        share = after(clock, onset)
        gains = _in_part(gain, share)
        best = int(gains.argmax())
        setting = {"axis": float(way), "onset": float(onset)}
        yield float(gains[best]), Gone(STEP, way, float(tried[best]), share, setting)
    whole = gain[:, 1].T
    for course in drifts(clock.frames):
        gains = np.sum([np.interp(part * tried, tried, mine) for part, mine in zip(course, whole, strict=True)], axis=0)
        best = int(gains.argmax())
        yield float(gains[best]), Gone(DRIFT, way, float(tried[best]), course, {"axis": float(way)})
