"""A gap of no name beside the channels: contrasts that depart smoothly in time, in one place or in several at once.

    c = sum_bj a_bj e_bj + nuisance + noise,    e_bj(k) = e_b(k) w_j phi_j(k)

e_b is what a unit gain in place b adds to all rows of a family, phi_j a cosine of time or of its logarithm. A gap is in
one place, or else in all of a family with one spread. Whatever makes all places larger than noise and nuisance allow is
a misfit of these, and no gap: scores are scaled by the median of all places.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from petkin.diagnosis import evidence
from petkin.diagnosis.families import Family, root, scored
from petkin.diagnosis.unknown import courses

Array = NDArray[np.float64]

#: Cosines of time.
_COUNT = 8


@dataclass(frozen=True)
class Departure:
    """Where a family of contrasts may depart.

    Args:
        family: the contrasts.
        added: what a unit gain in every place adds to them (places, J, K).
        times: of the samples (K,).
    """

    family: Family
    added: Array
    times: Array


@dataclass(frozen=True)
class _Scored:
    """Scores and what is known of them; which belong to one place or to all (group, members) by scale of time."""

    score: Array
    information: Array
    alone: tuple[NDArray[np.intp], ...]
    together: tuple[NDArray[np.intp], ...]

    @classmethod
    def of(cls, departure: Departure, least: float) -> _Scored:
        cosines = np.stack([each[:_COUNT] for each in courses(departure.times)])
        columns = departure.added[:, None, None] * cosines[None, :, :, None, :]
        score, information = scored(departure.family, columns.reshape(-1, departure.family.rows.size), least)
        which = np.arange(len(score)).reshape(columns.shape[:3])
        alone = tuple(which[:, scale] for scale in range(len(cosines)))
        return cls(score, information, alone, tuple(each.reshape(1, -1) for each in alone))

    def misfits(self) -> list[float]:
        """Squares of the scores of every place, in units of what they have without a gap."""
        found = []
        for place in self.alone[0]:
            inner = self.information[np.ix_(place, place)]
            found.append(float(self.score[place] @ np.linalg.lstsq(inner, self.score[place], rcond=1e-9)[0]))
        return found

    def evidence(self, scores: Array, scale: float) -> tuple[Array, Array]:
        """log evidence of a departure in one place, of every place (..., n), and in all of them (..., n)."""
        return self._each(scores, self.alone, scale), self._each(scores, self.together, scale)

    def _each(self, scores: Array, by_scale: Sequence[NDArray[np.intp]], scale: float) -> Array:
        found = []
        for groups in by_scale:
            spread = evidence.Spread.of(self.information[groups[:, :, None], groups[:, None, :]] / scale)
            found.append(spread.together(scores[..., groups] / scale))
        return np.concatenate(found, axis=-1)


def judge_departures(
    departures: Sequence[Departure], *, least: float, draws: int, rng: np.random.Generator
) -> tuple[float, Array]:
    """log evidence of a gap of no name, and that of draws of noise.

    Args:
        departures: family by family.
        least: smallest standard deviation that noise may have.
        draws: of noise.
        rng: randomness.
    """
    every = [_Scored.of(each, least) for each in departures]
    usual = np.median([m for each in every for m in each.misfits()]) / chi2.median(_COUNT)
    scale = max(float(usual), 1.0)
    found = _total([each.evidence(each.score, scale) for each in every])
    drawn = [rng.standard_normal((draws, len(each.score))) @ root(each.information) for each in every]
    return float(found), _total([each.evidence(scores, 1.0) for each, scores in zip(every, drawn, strict=True)])


def _total(found: list[tuple[Array, Array]]) -> Array:
    """One place or several are as likely."""
    alone, together = (evidence.mean(np.concatenate(kind, axis=-1)) for kind in zip(*found, strict=True))
    return np.asarray(np.logaddexp(alone, together) - np.log(2.0), np.float64)
