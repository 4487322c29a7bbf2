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
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petkin.diagnosis import WITHIN, Contrasted, Family, Hypothesis, Pattern, Sighting, judge_contrasts
from petkin.effects.imaging import after
from petkin.study.diagnosis.drawing import Predicted
from petkin.study.diagnosis.fields import Maps, views_of
from petkin.study.diagnosis.gone import Gone
from petkin.study.diagnosis.joint import added, beside, there
from petkin.study.diagnosis.moving import apart, less
from petkin.study.diagnosis.onsets import onsets
from petkin.study.diagnosis.picture import Voxels
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.scene import GAIN, GAINS, MOTION_MM, MOTIONS, Scene, drifts
from petkin.study.diagnosis.standing import Standing
from petkin.study.diagnosis.variation import Variation, Weighed

Array = NDArray[np.float64]

#: A way is laid onto frames to within so many mm (90 %).
_LAID_MM = 1.0
#: Contrasts whose way differs from it by more than this in its logarithm tell another one.
_ANOTHER, _HARDLY = 0.3, 1e-3
#: How many times the likeliest share of mixtures of the regions' curves a contrast holds, as few rows tell it: of 142
#: training images of noise 0.28 then have a p-value below 0.25, 0.39 with the likeliest.
_TIMES = 1.6
#: Onsets at most, and the shares of a frame at which they are tried: no refit moves them; draws of noise.
_ONSETS, _WITHIN, _DRAWS = 40, (0.0, 0.5), 400
#: Log evidence of an effect from which on it is taken off before kinetics are asked how they vary.
_EVIDENT = 3.0
#: How often contrasts show nothing of an effect that is there: a head turns, a gain is in one region alone.
_UNSEEN = {"partial_volume": 0.05, "motion_step": 0.2, "motion_drift": 0.2, "attenuation_mismatch": 0.5}


@dataclass(frozen=True)
class Looked:
    """What contrasts say.

    Args:
        contrasted: of every spatial effect, and of gaps of no name.
        width_mm: of the point spread that the image shows.
        sightings: where the image puts an effect and the kinetics beside it, by name.
    """

    contrasted: Contrasted
    width_mm: float
    sightings: Mapping[str, Sighting] = field(default_factory=dict)

    @property
    def log_odds(self) -> dict[str, float]:
        """What the image lends its effects, by name: their evidence, as often as they show."""
        return {name: float(_shown(name, evidence)) for name, evidence in self.contrasted.evidence.items()}

    @property
    def against(self) -> dict[str, Array]:
        """The same for the data, then for draws of noise (1 + n,); of a gap of no name under a name of its own."""
        found = {
            name: _shown(name, np.append(evidence, self.contrasted.drawn[name]))
            for name, evidence in self.contrasted.evidence.items()
        }
        departed = self.contrasted.departed
        return found if departed is None else found | {WITHIN: departed}

    @property
    def evident(self) -> bool:
        """Whether something sets in during the scan, whatever it is."""
        timed = [self.contrasted.evidence[n] for n, b in self.contrasted.best.items() if b.pattern.course is not None]
        unnamed = self.contrasted.unnamed
        return max([*timed, -np.inf if unnamed is None else unnamed]) >= _EVIDENT

    def told(self, hypothesis: Hypothesis) -> Hypothesis:
        """A hypothesis about regions that knows what the image says of it, setting by setting where it has some."""
        name = hypothesis.name
        if name not in self.contrasted.evidence:
            return hypothesis
        found = self.contrasted.settings[name]
        each = np.array([_shown(name, _said(found, setting)) for setting in hypothesis.settings])
        told = each - np.logaddexp.reduce(each) + np.log(len(each))
        return replace(
            hypothesis,
            log_odds=self.log_odds[name],
            told=tuple(map(float, told)),
            witness="image",
            sighting=self.sightings.get(name),
        )


def _mean(logs: Sequence[float]) -> float:
    """log of the mean."""
    return float(np.logaddexp.reduce(logs) - np.log(len(logs)))


def _shown(name: str, evidence: ArrayLike) -> Array:
    """Log evidence of an effect that may not show in contrasts at all."""
    return np.logaddexp(np.log(_UNSEEN[name]), np.log1p(-_UNSEEN[name]) + np.asarray(evidence))


def _said(found: Sequence[tuple[Mapping[str, float], float]], setting: Mapping[str, float]) -> float:
    """Log evidence of contrasts for a setting: along its axis and at its onset, read between those that contrasts were
    tried at; averaged over what it does not say."""
    mine = [(s, e) for s, e in found if "axis" not in setting or s["axis"] == setting["axis"]]
    at: dict[float, list[float]] = {}
    for s, e in mine:
        at.setdefault(s["onset"] if "onset" in setting else 0.0, []).append(e)
    times = sorted(at)
    logs = [_mean(at[time]) for time in times]
    return float(np.interp(setting.get("onset", 0.0), times, logs))


def look(voxels: Voxels, simulator: RegionalSimulator, names: frozenset[str], *, seed: int) -> Looked:
    """Contrasts of an image against every spatial effect that may be missing, and gaps of no name.

    What moves makes kinetics seem to vary, which hides it. Where an effect is evident, contrasts are asked again with
    what varies without it; their p-value is that of the first time, when nothing was taken for there. A way that the
    picture has gone is taken for there from the start.

    Args:
        voxels: of its segmentation.
        simulator: what predicts the regions' means.
        names: of the candidates; of an effect that it includes no more is looked for.
        seed: of the draws of noise.
    """
    predicted, standing = Predicted.of(voxels), Standing.of(voxels, simulator)
    blurring, patterns = predicted.blurred()
    voxels, still = (voxels, voxels) if voxels.gone is None else apart(voxels, voxels.gone)
    sums = still.sums(blurring.weights)
    width = predicted.width(sums, patterns)
    drawn = predicted.seen(width)[voxels.inside]
    scene = Scene(replace(voxels, drawn=drawn))
    contrasts, calm = _contrasts(scene), replace(still, drawn=drawn)
    variation = Variation.of(calm, contrasts)
    contrasts = [replace(each, pair=variation.parted(calm, each)) for each in contrasts]
    patterns += [pattern for contrast in contrasts for pattern in _patterns(contrast, scene, simulator)]
    patterns = [pattern for pattern in patterns if pattern.name in names]
    least = simulator.accuracy * float(np.median(np.abs(voxels.fit.values) / voxels.spread)) + 1e-300
    views = views_of(scene.voxels, _named(scene, contrasts), least=least)

    def asked(still: Voxels, variation: Variation) -> Contrasted:
        varying = Variation.of(still, [blurring])
        blurred = Family.of(sums, _held(blurring.weights[None], varying, standing), blurring.noise, least)
        families = {"blur": blurred}
        families |= {each.family: _family(each, scene, calm, variation, standing, least) for each in contrasts}
        held = (variation.joint, standing.joint)
        unnamed = [view.departure(held, simulator.clock.frames.mid, least) for view in views]
        rng = np.random.default_rng((seed, len(patterns)))
        return judge_contrasts(families, patterns, unnamed, draws=_DRAWS, rng=rng)

    first = asked(calm, variation)
    if voxels.gone is not None:
        return Looked(_as_gone(voxels.gone, first), width, _sighted(voxels, simulator))
    timed = {name: best for name, best in first.best.items() if best.pattern.course is not None}
    leader = max(timed, key=lambda name: first.evidence[name], default=None)
    if leader is None or first.evidence[leader] < _EVIDENT:
        return Looked(first, width)
    best = timed[leader]
    maps = next(contrast.maps for contrast in contrasts if contrast.family == best.pattern.family)
    rest = less(scene.voxels, maps, best.value * np.asarray(best.pattern.course))
    again = asked(rest, Variation.of(rest, contrasts))
    return Looked(replace(again, p_value=first.p_value), width)


def _as_gone(gone: Gone, found: Contrasted) -> Contrasted:
    """Contrasts that know from the picture as it is laid onto frames how it has moved: at once or by and by, along
    which way, when and how far; how likely it is that it has, they say themselves.

    How far it drifts they tell better, by what is left from frame to frame, unless that is another way altogether.
    """
    names = [name for name in gone.told if name in found.best]
    if gone.name not in names:
        return found
    told = {name: _mean([log for _, log in gone.told[name]]) for name in names}
    most = max(found.evidence[name] for name in names)
    evidence = {name: most + told[name] - told[gone.name] for name in names}
    best = found.best[gone.name]
    if not (
        gone.gradual
        and best.pattern.setting == gone.setting
        and abs(np.log(max(best.value / gone.mm, _HARDLY))) < _ANOTHER
    ):
        best = replace(best, value=gone.mm, low=gone.mm - _LAID_MM, high=gone.mm + _LAID_MM)
    best = replace(best, pattern=replace(best.pattern, setting=gone.setting, course=gone.course))
    return replace(
        found,
        evidence={**found.evidence, **evidence},
        settings={**found.settings, **{name: gone.told[name] for name in names}},
        best={**found.best, gone.name: best},
    )


def _sighted(voxels: Voxels, simulator: RegionalSimulator) -> dict[str, Sighting]:
    """The way that a picture has gone, and the kinetics that it shows at rest."""
    gone, state = voxels.gone, voxels.fit.state
    same = state.own.shape[1] == simulator.own.mean.size and state.shared.size == simulator.shared.mean.size
    return {gone.name: Sighting(state.own, state.shared, gone.mm, gone.setting)} if gone is not None and same else {}


@dataclass(frozen=True)
class _Contrast(Weighed):
    """A contrast along or about an axis and what it looks for: effects that add maps times their amplitude.

    Args:
        family: its name.
        names: of the effects.
        axis: of the grid.
        maps: what a unit of them adds to every voxel, in courses (N, M).
        prior: standard deviation of the amplitude, in its unit.
        pair: its weights in two parts (2, N), together what is asked.
    """

    family: str
    names: tuple[str, ...]
    axis: int
    maps: Array
    prior: float
    pair: Array = field(default_factory=lambda: np.zeros((0, 0)))


def _contrasts(scene: Scene) -> list[_Contrast]:
    """Motion along every axis of the grid and about it, and gains along every axis."""
    moved = [_of(scene, f"motion {way}", MOTIONS, way, maps, maps, MOTION_MM) for way, maps in scene.motions.items()]
    tilts = [(axis, scene.tilt(axis), scene.weighing_tilt(axis)) for axis in scene.axes]
    return moved + [_of(scene, f"gain {axis}", GAINS, axis, maps, seen, GAIN) for axis, maps, seen in tilts]


def _of(
    scene: Scene, family: str, names: tuple[str, ...], axis: int, maps: Array, weighing: Array, prior: float
) -> _Contrast:
    weights = scene.voxels.centred(scene.voxels.total(weighing))
    return _Contrast(weights, scene.voxels.picture.grain.between(weights), family, names, axis, maps, prior)


def _named(scene: Scene, contrasts: Sequence[_Contrast]) -> dict[str, Maps]:
    """What effects add to the voxels along and about all axes, by mm and, of motion, by mm^2; by name."""
    found: dict[str, Maps] = {}
    for name in dict.fromkeys(name for contrast in contrasts for name in contrast.names):
        by = [contrast.maps for contrast in contrasts if name in contrast.names]
        found[name] = by, scene.bends if name in MOTIONS else []
    return found


def _held(weights: Array, variation: Variation, standing: Standing) -> Array:
    """What contrasts of all regions may hold of kinetics that vary within them and of included effects."""
    regions = np.arange(len(variation.sensitivity))
    return np.concatenate([each.joint(weights, regions) for each in (variation, standing)])


def _family(
    contrast: _Contrast, scene: Scene, still: Voxels, variation: Variation, standing: Standing, least: float
) -> Family:
    """A contrast's rows beside the drawn picture's, with what they may hold of included effects, and of an image that
    stays as it is, as far as one that is still shows it."""
    voxels, pair, regions = scene.voxels, contrast.pair, np.arange(len(variation.sensitivity))
    noise = voxels.picture.grain.between(pair)
    bare = Family.of(beside(still, pair, regions), _held(pair, variation, standing), noise, least)
    return replace(bare.holding(there(voxels, pair, regions), times=_TIMES), rows=beside(voxels, pair, regions))


def _patterns(contrast: _Contrast, scene: Scene, simulator: RegionalSimulator) -> list[Pattern]:
    """What a contrast's effects add, by setting."""
    voxels, place, found = scene.voxels, {"axis": float(contrast.axis)}, []
    regions = np.arange(len(voxels.spread))
    for name in contrast.names:
        moves = name in MOTIONS
        drawn = added(voxels, contrast.pair, regions, scene.parts(name, contrast.axis) if moves else [contrast.maps])
        for setting, course, usual in _courses(name, simulator):
            own = scene.courses(name, contrast.axis, course) if moves else [course]
            rows = np.einsum("njk,nk->jk", drawn, np.stack(own))
            more = {"width": contrast.prior, "course": course, "usual": usual}
            found.append(Pattern(name, contrast.family, rows, place | setting, **more))
    return found


def _courses(name: str, simulator: RegionalSimulator) -> Iterator[tuple[dict[str, float], Array, bool]]:
    """Settings and courses over the frames of what sets in during the scan; how large a drift is, one over the whole
    scan says."""
    if name == "motion_drift":
        whole, *others = drifts(simulator.clock.frames)
        yield {}, whole, True
        yield from (({}, course, False) for course in others)
        return
    for onset in onsets(simulator.clock, _ONSETS, _WITHIN, scanner=True):
        yield {"onset": onset}, after(simulator.clock, onset), True
