"""What an image shows beyond the means of its regions: blur, motion, gains that differ across the head.

Every spatial effect is looked for by a contrast, a weighted sum over the voxels of each region whose weights sum to
zero, so that it knows nothing of the region's mean: the blurred image for the point spread, the gradient along an axis
for motion, the place along it for attenuation. Its nuisance is kinetics that vary within regions and, for what sets in
during the scan, mixtures of the regions' curves that were there all the time.

    c_r(k) = sum_v w_v x_v(k) / (g(k) s_r(k)),   sum_v w_v = 0,   sum_v w_v^2 = 1

with g what all regions of a frame have in common. What moves or is tilted is the image as it is seen; what it would be
without blur, and what contrasts would be without what sets in, is drawn from the labels.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations_with_replacement, product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from petkin.diagnosis import Contrasted, Family, Hypothesis, Pattern, holding, judge_contrasts
from petkin.effects.imaging import after
from petkin.imaging import PLANES, WAYS, Exchange, FrameSchedule, blur, middle_and_rim, origin
from petkin.study.diagnosis.fields import Maps, departures
from petkin.study.diagnosis.onsets import onsets
from petkin.study.diagnosis.picture import BESIDE, Voxels
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.variation import Variation, Weighed

Array = NDArray[np.float64]

#: FWHM tried, mm, and the one whose picture weighs the voxels.
_WIDTHS, _TYPICAL = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 14.0), 6.0
#: Priors: mm of motion, relative gain at the edge of the head, and blur in units of the FWHM tried.
_MOTION_MM, _GAIN = 10.0, 0.2
_MOTIONS, _GAINS = ("motion_step", "motion_drift"), ("attenuation_mismatch",)
#: How far regions are seen to move, mm. A mixture of their curves that is weaker than this share of the strongest tells
#: nothing of what motion brings.
_FAR_MM, _TOLD = (-10.0, -4.0, -1.5, 0.0, 1.5, 4.0, 10.0), 0.01
#: Rounds in which the sharp image is found.
_SHARPENED = 8
#: How many times the likeliest share of mixtures of the regions' curves a contrast holds, as few rows tell it: of 142
#: training images of noise 0.28 then have a p-value below 0.25, 0.39 with the likeliest.
_TIMES = 1.6
#: When a drift begins and ends, as shares of the scan.
_DRIFTS = ((0.0, 1.0), (0.0, 1 / 3), (0.0, 2 / 3), (1 / 3, 2 / 3), (1 / 3, 1.0), (2 / 3, 1.0))
#: Onsets at most, and the shares of a frame at which they are tried: no refit moves them; draws of noise.
_ONSETS, _WITHIN, _DRAWS = 40, (0.0, 0.5), 400
#: How often contrasts show nothing of an effect that is there: a head turns, a gain is in one region alone.
_UNSEEN = {"partial_volume": 0.05, "motion_step": 0.2, "motion_drift": 0.2, "attenuation_mismatch": 0.5}


@dataclass(frozen=True)
class Looked:
    """What contrasts say, and the width of the point spread that the image shows, mm."""

    contrasted: Contrasted
    width_mm: float

    @property
    def log_odds(self) -> dict[str, float]:
        """What the image lends its effects, by name: their evidence, as often as they show."""
        return {name: _shown(name, evidence) for name, evidence in self.contrasted.evidence.items()}

    def told(self, hypothesis: Hypothesis) -> Hypothesis:
        """A hypothesis about regions that knows what the image says of it, setting by setting where it has some."""
        name = hypothesis.name
        if name not in self.contrasted.evidence:
            return hypothesis
        found = self.contrasted.settings[name]
        each = np.array([_shown(name, _said(found, setting)) for setting in hypothesis.settings])
        told = each - np.logaddexp.reduce(each) + np.log(len(each))
        return replace(hypothesis, log_odds=self.log_odds[name], told=tuple(map(float, told)), witness="image")


def _shown(name: str, evidence: float) -> float:
    """Log evidence of an effect that may not show in contrasts at all."""
    return float(np.logaddexp(np.log(_UNSEEN[name]), np.log1p(-_UNSEEN[name]) + evidence))


def _said(found: Sequence[tuple[Mapping[str, float], float]], setting: Mapping[str, float]) -> float:
    """Log evidence of contrasts for a setting: along its axis and at its onset, read between those that contrasts were
    tried at; averaged over what it does not say."""
    mine = [(s, e) for s, e in found if "axis" not in setting or s["axis"] == setting["axis"]]
    at: dict[float, list[float]] = {}
    for s, e in mine:
        at.setdefault(s["onset"] if "onset" in setting else 0.0, []).append(e)
    times = sorted(at)
    logs = [np.logaddexp.reduce(at[time]) - np.log(len(at[time])) for time in times]
    return float(np.interp(setting.get("onset", 0.0), times, logs))


def look(voxels: Voxels, simulator: RegionalSimulator, names: frozenset[str], *, seed: int) -> Looked:
    """Contrasts of an image against every spatial effect that may be missing, and gaps of no name.

    Args:
        voxels: of its segmentation.
        simulator: what predicts the regions' means.
        names: of the candidates.
        seed: of the draws of noise.
    """
    predicted = _Predicted.of(voxels)
    families, patterns = predicted.blurred()
    width = predicted.width(families["blur"].rows, patterns)
    voxels = replace(voxels, drawn=predicted.seen(width)[voxels.inside])
    scene = _Scene(voxels)
    contrasts = scene.contrasts()
    variation = Variation.of(voxels, contrasts)
    least = simulator.accuracy * float(np.median(np.abs(voxels.fit.values) / voxels.spread)) + 1e-300
    for contrast in contrasts:
        families[contrast.family] = scene.family(contrast, variation, least)
        patterns += scene.patterns(contrast, simulator)
    patterns = [pattern for pattern in patterns if pattern.name in names]
    rng = np.random.default_rng((seed, len(patterns)))
    named = scene.added(contrasts)
    unnamed = departures(voxels, variation, simulator.clock.frames.mid, named, least=least)
    found = judge_contrasts(families, patterns, unnamed, least=least, draws=_DRAWS, rng=rng)
    return Looked(found, width)


def moves(voxels: Voxels) -> Exchange:
    """What motion adds to regions, as the picture tells.

        mean over region r of x as it has moved, less x = sum_s D_rs x_s

    D has no more in it than the curves of the regions tell apart.
    """
    picture = voxels.picture
    number = np.maximum(np.bincount(voxels.place), 1)[:, None]
    shares = np.linalg.pinv(voxels.fit.values @ picture.courses.T, rcond=_TOLD)
    labelled = voxels.inside[picture.box]
    at, rest = np.argwhere(labelled).T.astype(np.float64), picture.seen[labelled]
    found = np.zeros((WAYS, len(_FAR_MM), len(number), len(number)))
    for way, (n, far) in product(_Scene(voxels).motions, enumerate(_FAR_MM)):
        came = origin(at, way, far, picture.size, labelled)
        there = [map_coordinates(maps, came, order=1, mode="nearest") for maps in np.moveaxis(picture.seen, -1, 0)]
        found[way, n] = voxels.over_regions(np.stack(there, axis=1) - rest) / number @ shares
    return Exchange(np.array(_FAR_MM), found)


def _through(maps: Array, width: float, size: tuple[float, ...]) -> Array:
    return np.asarray(blur(maps, width, size), np.float64)


@dataclass(frozen=True)
class _Contrast(Weighed):
    """A contrast along or about an axis and what it looks for: effects that add maps times their amplitude.

    Args:
        family: its name.
        names: of the effects.
        axis: of the grid.
        maps: what a unit of them adds to every voxel, in courses (N, M).
        prior: standard deviation of the amplitude, in its unit.
    """

    family: str
    names: tuple[str, ...]
    axis: int
    maps: Array
    prior: float


@dataclass(frozen=True)
class _Predicted:
    """The predicted image: maps [x, y, z, M] that follow courses (M, K), each region at its predicted curve."""

    voxels: Voxels
    maps: Array

    @classmethod
    def of(cls, voxels: Voxels) -> _Predicted:
        picture = voxels.picture
        levels = voxels.fit.values @ picture.courses.T
        maps = np.empty((*picture.inside.shape, levels.shape[1]))
        maps[...] = picture.outside * levels[picture.place].mean(axis=0)
        maps[picture.inside] = levels[picture.place]
        return cls(voxels, maps)

    def seen(self, width: float) -> Array:
        """The image through a point spread, as sharp before it as its regions' means demand (x, y, z, M).

        Reference: van Cittert PH. Z Phys 1931;69:298-308 (repeated re-blurring).
        """
        inside, wanted, size = self.voxels.inside, self._means(self.maps), self.voxels.picture.size
        sharp = self.maps.copy()
        for _ in range(_SHARPENED):
            short = wanted - self._means(_through(sharp, width, size))
            sharp[inside] += short[self.voxels.place]
        return _through(sharp, width, size)

    def _means(self, maps: Array) -> Array:
        """Means over the regions (R, M)."""
        number = np.maximum(np.bincount(self.voxels.place), 1)
        return self.voxels.over_regions(maps[self.voxels.inside]) / number[:, None]

    def blurred(self) -> tuple[dict[str, Family], list[Pattern]]:
        """One contrast for the point spread, with a pattern a width.

        It is there in every frame, as kinetics that vary are: how far they do is told by decoys of this very contrast,
        which are as fine as it is.
        """
        voxels, courses = self.voxels, self.voxels.picture.courses
        weights = voxels.centred(self.seen(_TYPICAL)[voxels.inside] @ courses.mean(axis=1))
        contrast = Weighed(weights, voxels.picture.grain.between(weights))
        variation = Variation.of(voxels, [contrast])
        rows = [voxels.framed(weights, self.seen(width)[voxels.inside], courses) for width in _WIDTHS]
        patterns = [
            Pattern("partial_volume", "blur", row, {}, scale=width, signed=False)
            for width, row in zip(_WIDTHS, rows, strict=True)
        ]
        return {"blur": Family(voxels.sums(weights), variation.columns(weights), contrast.noise)}, patterns

    def width(self, contrast: Array, patterns: list[Pattern]) -> float:
        """The FWHM at which the predicted contrast is as large as the image's, mm."""
        typical = patterns[_WIDTHS.index(_TYPICAL)].rows
        sizes = np.maximum.accumulate([0.0, *(float((typical * p.rows).sum()) for p in patterns)])
        return float(np.interp(float((typical * contrast).sum()), sizes, [0.0, *_WIDTHS]))


@dataclass(frozen=True)
class _Scene:
    """The image as it is seen, and what sets in during the scan and changes it."""

    voxels: Voxels

    @property
    def axes(self) -> list[int]:
        return [axis for axis, size in enumerate(self.voxels.inside.shape) if size > 1]

    def contrasts(self) -> list[_Contrast]:
        """Motion along every axis of the grid and about it, and gains along every axis."""
        moved = [self._of(f"motion {way}", _MOTIONS, way, maps, _MOTION_MM) for way, maps in self.motions.items()]
        return moved + [self._of(f"gain {axis}", _GAINS, axis, self._tilt(axis), _GAIN) for axis in self.axes]

    @cached_property
    def motions(self) -> dict[int, Array]:
        """What a millimetre of motion adds to every voxel (N, M), by way of moving.

        dx = - u . grad x
        """
        along = {axis: -slope for axis, slope in self._slopes.items()}
        turned = {3 + n: self._turn(plane) for n, plane in enumerate(PLANES) if set(plane) <= set(self.axes)}
        return along | turned

    def _turn(self, plane: tuple[int, int]) -> Array:
        """Of a turn about the middle of the labels, by a millimetre at their rim."""
        one, two = plane
        size = np.array(self.voxels.picture.size)
        middle, rim = middle_and_rim(self.voxels.inside, plane, size)
        at = (np.argwhere(self.voxels.inside) - middle) * size
        return np.asarray((at[:, [two]] * self._slopes[one] - at[:, [one]] * self._slopes[two]) / rim, np.float64)

    def _tilt(self, axis: int) -> Array:
        """What a gain adds that grows along an axis, by one from the middle to the edge of the head (N, M)."""
        place = np.nonzero(self.voxels.inside)[axis].astype(np.float64)
        place = 2.0 * (place - place.mean()) / max(float(np.ptp(place)), 1.0)
        return np.asarray(place[:, None] * self.voxels.seen, np.float64)

    @cached_property
    def _slopes(self) -> dict[int, Array]:
        """Derivatives of the labelled voxels along every axis, 1/mm (N, M)."""
        picture = self.voxels.picture
        labelled = self.voxels.inside[picture.box]
        return {axis: _slope(picture.seen, picture.size[axis], axis)[labelled] for axis in self.axes}

    @cached_property
    def _bends(self) -> list[Array]:
        """Second derivatives of the labelled voxels, 1/mm^2 (N, M): what large motion does beside its slope."""
        picture = self.voxels.picture
        labelled = self.voxels.inside[picture.box]
        slopes = {axis: _slope(picture.seen, picture.size[axis], axis) for axis in self.axes}
        pairs = combinations_with_replacement(slopes, 2)
        return [_slope(slopes[one], picture.size[other], other)[labelled] for one, other in pairs]

    def _of(self, family: str, names: tuple[str, ...], axis: int, maps: Array, prior: float) -> _Contrast:
        weights = self.voxels.centred(self.voxels.total(maps))
        return _Contrast(weights, self.voxels.picture.grain.between(weights), family, names, axis, maps, prior)

    def added(self, contrasts: Sequence[_Contrast]) -> dict[str, Maps]:
        """What its effects add to the voxels along and about all axes, by mm and, of motion, by mm^2; by name."""
        found: dict[str, Maps] = {}
        for name in dict.fromkeys(name for contrast in contrasts for name in contrast.names):
            by = [contrast.maps for contrast in contrasts if name in contrast.names]
            found[name] = by, self._bends if name in _MOTIONS else []
        return found

    def family(self, contrast: _Contrast, variation: Variation, least: float) -> Family:
        """Its rows beside the drawn picture's, with what they may hold of an image that stays as it is."""
        weights = contrast.weights
        bare = Family(self.voxels.beside(weights), variation.columns(weights), contrast.noise)
        return holding(bare, self.voxels.there(weights), least, times=_TIMES)

    def patterns(self, contrast: _Contrast, simulator: RegionalSimulator) -> list[Pattern]:
        """What its effects add, by setting."""
        always = self.voxels.framed(contrast.weights, contrast.maps, self.voxels.picture.courses)
        place = {"axis": float(contrast.axis)}
        return [
            Pattern(name, contrast.family, always * course, place | setting, width=contrast.prior, course=course)
            for name in contrast.names
            for setting, course in _courses(name, simulator.clock.frames, simulator)
        ]


def _slope(maps: Array, edge: float, axis: int) -> Array:
    """Derivative of maps [x, y, z, M] along an axis, 1/mm, as sharp as two neighbours to either side tell it.

    x' = (8 (x_1 - x_-1) - (x_2 - x_-2)) / 12,   beyond the grid as at its end

    Reference: Fornberg B. Math Comput 1988;51:699-706, table 1 (central, fourth order).
    """
    pad = [(BESIDE, BESIDE) if a == axis else (0, 0) for a in range(maps.ndim)]
    x = np.moveaxis(np.pad(maps, pad, mode="edge"), axis, 0)
    slope = (8.0 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12.0 * edge)
    return np.moveaxis(slope, 0, axis)


def _courses(
    name: str, frames: FrameSchedule, simulator: RegionalSimulator
) -> Iterator[tuple[dict[str, float], Array]]:
    """Settings and courses over the frames of what sets in during the scan."""
    if name == "motion_drift":
        passed = frames.mid / frames.end[-1]
        for begins, ends in _DRIFTS:
            yield {}, np.clip((passed - begins) / (ends - begins), 0.0, 1.0)
        return
    for onset in onsets(simulator.clock, _ONSETS, _WITHIN, scanner=True):
        yield {"onset": onset}, after(simulator.clock, onset)
