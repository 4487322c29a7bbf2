"""A diagnosis of regions together with what the image of the same scan shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import (
    CLAIM,
    Z90,
    Base,
    Best,
    Cause,
    Diagnosis,
    Elsewhere,
    Estimate,
    Fit,
    Hypothesis,
    Strength,
    base_fit,
    smallest_set,
)
from petkin.study.diagnosis.including import in_picture
from petkin.study.diagnosis.moving import moving
from petkin.study.diagnosis.picture import Picture, Voxels
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.resting import at_rest
from petkin.study.diagnosis.spatial import Looked, look
from petkin.study.diagnosis.standing import bare, spatial
from petkin.study.sources import Source

Array = NDArray[np.float64]

#: From this log evidence on the image, not the regions, says how large an effect is and when it set in; below it too
#: where its mm are the surer ones.
_SURE = 3.0
#: From this d' of an effect of a usual size on an image shows it, whatever regions hide.
_SHOWN = 5.0
#: What the smaller of two p-values, of regions and of contrasts, is multiplied by: contrasts' is below 0.02 in 0.07 of
#: noise. Of 182 and 229 training scans of noise alone 0.03 and 0.06 then lie below 0.03, 0.06 and 0.07 with 2; of 114
#: cohorts of such scans 0.04, and 0.08 with 1.
_TESTS = 2.5
#: Effects whose size an image gives in mm, and by what share of it that errs besides noise (standard deviation): slopes
#: are those of an image that has moved, a slow drift is much like kinetics that vary, and voxels blur by themselves. On
#: scans of other generators steps scatter by 0.1 to 0.2, drifts by 0.1 to 0.3, blur by 0.1 to 0.5.
_IN_MM = {"partial_volume": 0.35, "motion_step": 0.15, "motion_drift": 0.25}


@dataclass(frozen=True)
class Imaged:
    """What the image of a scan adds: its voxels, and what contrasts say of spatial effects and gaps of no name."""

    voxels: Voxels
    looked: Looked

    @property
    def log_odds(self) -> dict[str, float]:
        return self.looked.log_odds

    @property
    def elsewhere(self) -> Elsewhere | None:
        """What the image says of a gap of no name."""
        unnamed = self.looked.contrasted.unnamed
        return None if unnamed is None else Elsewhere(unnamed, self.log_odds)


def pictured(
    source: Source, picture: Picture, simulator: RegionalSimulator, values: Array, based: Base, *, seed: int
) -> tuple[RegionalSimulator, Base, Voxels | None]:
    """The simulator that knows from an image what motion adds to regions, and of the effects that it includes what the
    image says, with its fit; and the image at rest where motion that it includes went far.

    Args:
        source: the scan.
        picture: its image.
        simulator: what predicts the means over its regions.
        values: those means (R, K).
        based: what `base_fit` finds.
        seed: of the draws of noise.
    """
    simulator = moving(simulator, Voxels.of(picture, simulator, based[0]))
    names = frozenset(effect.name for effect in spatial(simulator))
    if not names:
        return *in_picture(simulator, values, based), None
    alone = bare(simulator)
    voxels = Voxels.of(picture, alone, base_fit(alone, values)[0])
    looked = look(voxels, alone, names, seed=seed)
    rest = at_rest(source, voxels, alone) if looked.evident else None
    if rest is not None:
        looked = look(rest, alone, names, seed=seed)
        simulator = moving(simulator, rest)
    sizes = {name: _in_mm(name, looked) for name in _sure(looked)}
    return *in_picture(simulator, values, based, partial(_timed, looked), sizes), rest


def _timed(looked: Looked, hypothesis: Hypothesis) -> Hypothesis:
    """A hypothesis about regions that knows what the image says of it, and sets in when it says so where it is sure."""
    told, best = looked.told(hypothesis), looked.contrasted.best.get(hypothesis.name)
    if best is None or "onset" not in best.pattern.setting or looked.contrasted.evidence[hypothesis.name] < _SURE:
        return told
    when = _set("onset", hypothesis.name, best, looked.contrasted.settings[hypothesis.name])
    shapes = (
        replace(s, lower=max(s.lower, when.low), upper=min(s.upper, when.high)) if s.symbol == "onset" else s
        for s in told.shapes
    )
    return replace(told, shapes=tuple(shapes))


def look_at_image(
    source: Source,
    picture: Picture,
    simulator: RegionalSimulator,
    fit: Fit,
    names: frozenset[str],
    rest: Voxels | None = None,
    *,
    seed: int,
) -> tuple[Imaged, RegionalSimulator]:
    """The image's own evidence on spatial effects, and the simulator that knows what motion adds to regions.

    Where the image has evidently moved far it is asked again as it would be at rest, with the p-value of the first
    time, when nothing was taken for there.

    Args:
        source: the scan.
        picture: its image.
        simulator: what predicts the means over its regions.
        fit: of the simulator to them.
        names: of the candidates.
        rest: the image at rest where the simulator includes how it has moved.
        seed: of the draws of noise.
    """
    if rest is not None:
        return Imaged(rest, look(rest, simulator, names, seed=seed)), simulator
    voxels = Voxels.of(picture, simulator, fit)
    first = look(voxels, simulator, names, seed=seed)
    rest = at_rest(source, voxels, simulator) if first.evident else None
    if rest is None:
        return Imaged(voxels, first), simulator
    again = look(rest, simulator, names, seed=seed)
    contrasted = replace(again.contrasted, p_value=first.contrasted.p_value)
    return Imaged(rest, replace(again, contrasted=contrasted)), moving(simulator, rest)


def weighed(found: Diagnosis, looked: Looked, *, seed: int) -> Diagnosis:
    """A diagnosis that knew the image's evidence beforehand, with the p-value of either, and sizes in mm.

    Args:
        found: of the regions, whose hypotheses carried the image's evidence.
        looked: what contrasts say.
        seed: of which draws of noise go together.
    """
    p = min(1.0, _TESTS * min(found.p_value, looked.contrasted.p_value))
    present = p <= CLAIM
    likely = tuple(_sized(cause, looked) for cause in found.likely)
    chosen: tuple[str, ...] = ()
    if present and found.unknown < 0.5:
        chosen = smallest_set({cause.label: cause.probability for cause in likely}, found.alike)
    leader = likely[0]
    onset = next((e.value for e in leader.estimates if e.symbol == "onset"), None)
    frame = next((int(e.value) for e in leader.estimates if e.symbol == "frame"), None)
    return replace(
        found,
        present=present,
        p_value=p,
        causes=likely if present else (),
        likely=likely,
        chosen=chosen,
        set_probability=sum(cause.probability for cause in likely if cause.label in chosen),
        onset=onset if present else None,
        frame=frame if present else None,
        shown=frozenset(name for name, best in looked.contrasted.best.items() if best.detectability >= _SHOWN),
        strengths=found.strengths | _strengths(found, looked),
        profiles={name: one for name, one in found.profiles.items() if name not in looked.contrasted.best},
        against=found.against.witnessed(looked.against, np.random.default_rng(seed), times=_TESTS),
    )


def _sized(cause: Cause, looked: Looked) -> Cause:
    """The cause with the image's amplitude and onset where the image is surer than the regions' means can be."""
    estimates = list(cause.estimates)
    for name in cause.effects:
        best = looked.contrasted.best.get(name)
        if best is None:
            continue
        place = next((i for i, e in enumerate(estimates) if (e.effect, e.symbol) == (name, "amplitude")), None)
        sure = looked.contrasted.evidence[name] >= _SURE
        if name in _IN_MM and place is not None:
            in_mm = _in_mm(name, looked)
            sure = sure or _width(in_mm) < _width(estimates[place])
            estimates[place] = in_mm if sure else estimates[place]
        if sure and len(cause.effects) == 1:
            symbols = [s for s in ("onset", "axis")[: 1 + (name in _IN_MM)] if s in best.pattern.setting]
            estimates = [e for e in estimates if e.symbol not in symbols]
            estimates += [_set(symbol, name, best, looked.contrasted.settings[name]) for symbol in symbols]
    return replace(cause, estimates=tuple(estimates))


def _width(estimate: Estimate) -> float:
    return estimate.high - estimate.low


def _strengths(found: Diagnosis, looked: Looked) -> dict[str, Strength]:
    """Sizes in mm of effects that the image is sure of: how far, since the way is another in every scan."""
    return {
        name: Strength(**vars(_in_mm(name, looked)), signed=False, single=True, alike=_IN_MM[name])
        for name in _sure(looked)
        if name in found.strengths
    }


def _sure(looked: Looked) -> list[str]:
    """Effects that the image gives a size in mm."""
    return [name for name in _IN_MM if looked.contrasted.evidence.get(name, -np.inf) >= _SURE]


def _in_mm(name: str, looked: Looked) -> Estimate:
    """How far the image has moved, or the width of its point spread, with a 90 % interval."""
    best = looked.contrasted.best[name]
    size, error = abs(best.value), 0.5 * abs(best.high - best.low)
    if name == "partial_volume":
        error, size = 0.5 * looked.width_mm * error / max(size, 1e-300), looked.width_mm  # blur grows with its square
    half = float(np.hypot(error, Z90 * _IN_MM[name] * size))
    return Estimate("amplitude", "mm", size, max(size - half, 0.0), size + half, effect=name)


def _set(symbol: str, name: str, best: Best, settings: Sequence[tuple[Mapping[str, float], float]]) -> Estimate:
    """A setting that the image tells: of an onset, up to those tried beside the ones that hold 0.9 of the evidence."""
    value = float(best.pattern.setting[symbol])
    if symbol != "onset":
        return Estimate(symbol, "1", value, value, value, effect=name)
    tried = np.unique([setting[symbol] for setting, _ in settings])
    each = [np.logaddexp.reduce([log for setting, log in settings if setting[symbol] == time]) for time in tried]
    below = np.cumsum(np.exp(np.array(each) - np.logaddexp.reduce(each)))
    first, last = np.searchsorted(below, 0.05), np.searchsorted(below, 0.95)
    low, high = tried[max(first - 1, 0)], tried[min(last + 1, len(tried) - 1)]
    return Estimate(symbol, "min", value, min(float(low), value), max(float(high), value), effect=name)
