"""Evidence beside the channels: contrasts that know nothing of a channel's mean, each with a noise of its own.

    c = a e + nuisance + noise

for all rows of one family at once. A template's evidence is averaged over settings as that of any hypothesis; a gap of
no name is one hypothesis more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import evidence
from petkin.diagnosis.departures import Departure, judge_departures
from petkin.diagnosis.detect import p_value
from petkin.diagnosis.families import Family, root
from petkin.diagnosis.strength import Z90

Array = NDArray[np.float64]

_TINY = 1e-300
#: Log evidence from which on a name that contrasts see may be what a gap of no name is.
_SEEN = 1.0
#: Share of its nuisance that a family keeps where a size is read: what is told of nuisance is told without the effect,
#: which makes it large. With all of it 27 motions of training images err by 0.20 in the logarithm, with this by 0.15.
_KEPT = 0.25


@dataclass(frozen=True)
class Pattern:
    """What an effect of unit amplitude adds to one family of contrasts.

    Args:
        name: of the hypothesis.
        family: which contrasts.
        rows: (J, K).
        setting: values of its other parameters.
        scale: amplitude that the rows belong to, where they are not proportional to it; else 1.
        signed: whether it may be negative.
        width: standard deviation of the amplitude's prior, in units of `scale`.
        course: in time (K,), where it has one.
        usual: whether its amplitude is that of the hypothesis; others are looked for, but give no size.
    """

    name: str
    family: str
    rows: Array
    setting: Mapping[str, float]
    scale: float = 1.0
    signed: bool = True
    width: float = 1.0
    course: Array | None = None
    usual: bool = True


@dataclass(frozen=True)
class Best:
    """The usual pattern of a hypothesis that its contrasts like best, in the family that they like best, with its
    amplitude and 90 % interval, which what it leaves of its contrasts widens."""

    pattern: Pattern
    value: float
    low: float
    high: float
    detectability: float = np.inf  # d' of an amplitude as large as the prior's standard deviation


@dataclass(frozen=True)
class Contrasted:
    """What contrasts say.

    Args:
        evidence: log evidence by hypothesis.
        settings: every setting of a hypothesis with its log evidence.
        best: by hypothesis.
        p_value: of none of them.
        unnamed: log evidence of a gap of no name, no more than a name's with what is left beside it; None where none
            was looked for.
        drawn: log evidence of draws of noise, by hypothesis (n,).
        departed: log evidence of a gap of no name for the data, then for as many draws (1 + n,).
    """

    evidence: Mapping[str, float]
    settings: Mapping[str, Sequence[tuple[Mapping[str, float], float]]]
    best: Mapping[str, Best]
    p_value: float
    unnamed: float | None = None
    drawn: Mapping[str, Array] = field(default_factory=dict)
    departed: Array | None = None


def judge_contrasts(
    families: Mapping[str, Family],
    patterns: Sequence[Pattern],
    departures: Sequence[Departure] = (),
    *,
    draws: int,
    rng: np.random.Generator,
) -> Contrasted:
    """Evidence of every pattern's hypothesis.

    Args:
        families: contrasts by name.
        patterns: what to look for.
        departures: where there may be a gap of no name.
        draws: of noise for the p-value.
        rng: randomness.
    """
    by_name: dict[str, list[tuple[Pattern, float, float, Array]]] = {}
    for name, family in families.items():
        mine = [pattern for pattern in patterns if pattern.family == name]
        if not mine:
            continue
        scores, information = family.scored(np.stack([p.rows.ravel() for p in mine]))
        drawn = rng.standard_normal((draws, len(mine))) @ root(information)
        for i, pattern in enumerate(mine):
            size = float(information[i, i])
            entry = (pattern, float(scores[i]), size, _evidence(pattern, drawn[:, i], size))
            by_name.setdefault(pattern.name, []).append(entry)
    found, settings, best, nulls, courses = {}, {}, {}, {}, {}
    for name, entries in by_name.items():
        each = np.array([float(_evidence(p, np.asarray(score), size)) for p, score, size, _ in entries])
        found[name] = _mean(each[:, None])[0]
        settings[name] = [(pattern.setting, float(value)) for (pattern, *_), value in zip(entries, each)]
        nulls[name] = _mean(np.stack([null for *_, null in entries]))
        liked = entries[int(np.argmax(each))][0]
        courses[name] = liked.course
        mine = [i for i, (p, *_) in enumerate(entries) if p.usual and p.family == liked.family]
        pattern, _, information, _ = entries[max(mine, key=lambda i: each[i])]
        best[name] = _sized(pattern, families[pattern.family], information)
    unnamed, departed = None, None
    observed, drawn = list(found.values()), list(nulls.values())
    if departures:
        named = {name: course for name, course in courses.items() if course is not None}
        alone, null, left = judge_departures(departures, named, draws=draws, rng=rng)
        departed = np.append(alone, null)
        observed, drawn = [*observed, alone], [*drawn, null]
        unnamed = min([alone, *(found[name] + beyond for name, beyond in left.items() if found[name] > _SEEN)])
    p = p_value(_mean(np.array(observed)[:, None])[0], _mean(np.stack(drawn)))
    evidence_of = {name: float(value) for name, value in found.items()}
    return Contrasted(evidence_of, settings, best, p, unnamed, nulls, departed)


def _evidence(pattern: Pattern, score: Array, information: float) -> Array:
    t = score / np.sqrt(information + pattern.width**-2.0)
    return evidence.two_sided(t) if pattern.signed else evidence.one_sided(t)


def _mean(logs: Array) -> Array:
    """log of the mean over the first axis."""
    return np.logaddexp.reduce(logs, axis=0) - np.log(len(logs))


def _sized(pattern: Pattern, family: Family, information: float) -> Best:
    """Amplitude with errors as many times those of noise as the root of chi2 a degree of freedom has it, if above 1.

    Reference: Birge RT. Phys Rev 1932;40:207-227.
    """
    (score,), ((known,),) = family.with_nuisance(_KEPT).scored(pattern.rows.reshape(1, -1))
    known, widened = max(float(known), _TINY), max(family.misfit(pattern.rows), 1.0) ** 0.5
    value, error = float(score) / known, widened * known**-0.5
    low, high = value - Z90 * error, value + Z90 * error
    seen = pattern.width * max(information, 0.0) ** 0.5
    return Best(pattern, pattern.scale * value, pattern.scale * low, pattern.scale * high, seen)
