"""A gap of no name beside the channels: contrasts that depart smoothly in time, in one place or in several at once.

    c = sum_bj a_bj e_bj + nuisance + noise,    e_bj(k) = e_b(k) w_j phi_j(k)

e_b is what a unit gain in place b adds to all rows of a family, phi_j a cosine of time or of its logarithm. A gap is in
one place, or in all of a family, with one spread or as visible any way. Whatever makes all places larger than noise and
nuisance allow is a misfit of these, and no gap: scores are scaled by the median of all places.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from petkin.diagnosis import evidence
from petkin.diagnosis.families import Family, root
from petkin.diagnosis.unknown import courses

Array = NDArray[np.float64]

#: Cosines of time.
_COUNT = 8
#: Median of chi-square with so many degrees of freedom: half of the regularised gamma function (DLMF 8.2.4) lies below.
_USUAL = 2.0 * gammaincinv(_COUNT / 2, 0.5)
#: w^2 of departures that are as visible any way, and the least share of the largest information that a direction has.
_WIDE, _LEAST = np.geomspace(0.1, 30.0, 12), 1e-9


@dataclass(frozen=True)
class Departure:
    """Where a family of contrasts may depart.

    Args:
        family: the contrasts.
        added: what a unit gain in every place adds to them (places, J, K).
        times: of the samples (K,).
        parts: the same of other places, which overlap and are in no gap together (parts, J, K); none is no rows.
        held: of named effects, what they add by their amplitude (m, J, K), and by its square (n, J, K); an effect's
            course in time is its own.
    """

    family: Family
    added: Array
    times: Array
    parts: Array
    held: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Scored:
    """Scores and what is known of them; which belong to one place or to all (group, members) by scale of time."""

    score: Array
    information: Array
    alone: tuple[NDArray[np.intp], ...]
    together: tuple[NDArray[np.intp], ...]

    @classmethod
    def of(cls, departure: Departure, named: Mapping[str, Array]) -> tuple[_Scored, dict[str, _Scored]]:
        """Scores, and by name what an effect with its course (K,) leaves of them."""
        cosines = np.stack([each[:_COUNT] for each in courses(departure.times)])
        places = np.concatenate([departure.added, departure.parts])
        count = len(places) * len(cosines) * _COUNT
        beside = {
            name: np.concatenate([by * named[name], squared * named[name] ** 2]).reshape(-1, departure.family.rows.size)
            for name, (by, squared) in departure.held.items()
            if name in named
        }
        others = np.concatenate([np.zeros((0, departure.family.rows.size)), *beside.values()])
        score, information = departure.family.scored_over_time(places, cosines.reshape(-1, cosines.shape[2]), others)
        which = np.arange(count).reshape(len(places), len(cosines), _COUNT)
        alone = tuple(which[:, scale] for scale in range(len(cosines)))
        together = tuple(each[: len(departure.added)].reshape(1, -1) for each in alone)
        left, start, mine = {}, count, np.arange(count)
        for name, theirs in beside.items():
            both = np.append(mine, np.arange(start, start + len(theirs)))
            left[name] = cls(*_beyond(score[both], information[np.ix_(both, both)], count), alone, together)
            start += len(theirs)
        return cls(score[mine], information[:count, :count], alone, together), left

    def misfits(self) -> list[float]:
        """Squares of the scores of every place that is in a gap of several, in units of what they have without one."""
        found = []
        for place in self.together[0].reshape(-1, _COUNT):
            inner = self.information[np.ix_(place, place)]
            found.append(float(self.score[place] @ np.linalg.lstsq(inner, self.score[place], rcond=1e-9)[0]))
        return found

    def evidence(self, scores: Array, scale: float) -> tuple[Array, Array, Array]:
        """log evidence of a departure in one place, of every place (..., n); in all, as large in each (..., n); in all,
        as visible any way (..., n)."""
        found = [self._each(scores, groups, scale) for groups in (self.alone, self.together)]
        return found[0], found[1], self._visible(scores, scale)

    def _visible(self, scores: Array, scale: float) -> Array:
        """log evidence of any mixture of places with any course, whose priors are as wide as the errors times w.

            log B = w^2 / (1 + w^2) q / 2 - n / 2 log(1 + w^2),   q = s' I^-1 s of n directions, averaged over w

        What nuisance hides is no less likely for it: a gap that shows in what it leaves of many places is seen.

        Reference: Zellner A. In: Goel PK, Zellner A, eds. Bayesian inference and decision techniques. 1986:233-243.
        """
        found = []
        for (group,) in self.together:
            size, axes = np.linalg.eigh(self.information[np.ix_(group, group)])
            kept = size > _LEAST * size[-1]
            square = ((scores[..., group] @ (axes[:, kept] / np.sqrt(size[kept]))) ** 2).sum(axis=-1) / scale
            gained = 0.5 * square[..., None] * _WIDE / (1.0 + _WIDE)
            found.append(evidence.mean(gained - 0.5 * kept.sum() * np.log1p(_WIDE)))
        return np.stack(found, axis=-1)

    def _each(self, scores: Array, by_scale: Sequence[NDArray[np.intp]], scale: float) -> Array:
        found = []
        for groups in by_scale:
            spread = evidence.Spread.of(self.information[groups[:, :, None], groups[:, None, :]] / scale)
            found.append(spread.together(scores[..., groups] / scale))
        return np.concatenate(found, axis=-1)


def _beyond(score: Array, information: Array, count: int) -> tuple[Array, Array]:
    """Scores of the first columns where the others are there as large as they like."""
    mine, theirs = slice(count), slice(count, None)
    shared = np.linalg.lstsq(information[theirs, theirs], information[theirs, mine], rcond=1e-9)[0]
    return score[mine] - shared.T @ score[theirs], information[mine, mine] - shared.T @ information[theirs, mine]


def judge_departures(
    departures: Sequence[Departure],
    named: Mapping[str, Array] | None = None,
    *,
    draws: int,
    rng: np.random.Generator,
) -> tuple[float, Array, dict[str, float]]:
    """log evidence of a gap of no name, that of draws of noise, and that of one beside named effects.

    Args:
        departures: family by family.
        named: courses (K,) of effects, by name.
        draws: of noise.
        rng: randomness.
    """
    every, beside = zip(*[_Scored.of(each, named or {}) for each in departures], strict=True)
    usual = np.median([m for each in every for m in each.misfits()]) / _USUAL
    scale = max(float(usual), 1.0)
    drawn = [rng.standard_normal((draws, len(each.score))) @ root(each.information) for each in every]
    null = _total([each.evidence(scores, 1.0) for each, scores in zip(every, drawn, strict=True)])
    left = {}
    for name in named or {}:
        theirs = [each[name] for each in beside if name in each]
        if theirs:
            left[name] = float(_total([each.evidence(each.score, scale) for each in theirs]))
    return float(_total([each.evidence(each.score, scale) for each in every])), null, left


def _total(found: list[tuple[Array, ...]]) -> Array:
    """One place, several as large and several as visible are as likely."""
    kinds = [evidence.mean(np.concatenate(kind, axis=-1)) for kind in zip(*found, strict=True)]
    return evidence.mean(np.stack(kinds, axis=-1))
