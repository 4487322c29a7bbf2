"""What several data sets have in common: causes that they share, in which of them, and how strong.

Every member has a shared cause e with probability pi, at a strength of its own, or else what any data set may have:

    log B(e) = log int prod_i [(1 - pi) b_i + pi e_i] d pi - sum_i log b_i

with e_i the evidence of all explanations of member i that hold e, and b_i that of none or any of the catalogue.
Strengths are drawn about a common mean, with a spread between members by DerSimonian and Laird. Who carries the cause
is then asked at the strength that it has in the others, where a strength s with error d speaks for it by

    N(s; mean, spread^2 + error^2 + d^2) / N(s; 0, d^2):

a member that shows none of a cause that is strong elsewhere does not have it weakly.

Reference: DerSimonian R, Laird N. Meta-analysis in clinical trials. Control Clin Trials 1986;7:177-188.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from petkin.diagnosis.diagnose import CLAIM
from petkin.diagnosis.evidence import SECOND, two_sided
from petkin.diagnosis.how_far import Interval
from petkin.diagnosis.sets import probabilities, smallest_set
from petkin.diagnosis.verdict import Diagnosis, Estimate

Array = NDArray[np.float64]

#: Prevalences tried, from where a cause is shared rather than chance; the chance that a member without it has no gap.
_PREVALENCES = np.linspace(0.15, 0.99, 43)
_NO_GAP = 0.5
_TAILS, _Z90 = (0.05, 0.95), 1.6448536269514722
_LISTED, _NEGLIGIBLE = 8, 0.005
#: Probability from which on a member's strength counts among the carriers', in rounds: sure ones first, so that weak
#: ones cannot vouch for one another; the least spread between members, relative.
_CARRY, _LEAST_SPREAD = (0.9, 0.5, 0.5), 0.3


@dataclass(frozen=True)
class Member:
    """One data set.

    Args:
        label: its name.
        p_value: of no gap.
        evidence: log evidence by explanation, "a" or "a+b".
        strengths: of single effects.
        alike: cosines by pair of explanations.
    """

    label: str
    p_value: float
    evidence: Mapping[str, float]
    strengths: Mapping[str, Estimate]
    alike: Mapping[frozenset[str], float]

    @classmethod
    def of(cls, label: str, found: Diagnosis) -> Member:
        """A diagnosis as a member of a cohort."""
        evidence = {name: value for name, (_, value) in found.evidence.items()}
        evidence |= {cause.label: cause.log_evidence for cause in found.likely}
        return cls(label, found.p_value, evidence, found.strengths, found.alike)

    def holding(self, names: Sequence[str]) -> float:
        """Log evidence of all explanations that hold these effects, averaged over the pairs a second could make."""
        within = [value for label, value in self.evidence.items() if set(names) <= set(label.split("+"))]
        if len(names) == 2 and not within:
            return max(self.evidence.get(name, 0.0) for name in names) - SECOND
        return float(np.logaddexp.reduce(within)) if within else 0.0

    @property
    def background(self) -> float:
        """Log evidence of no effect or any single one."""
        singles = np.array([value for label, value in self.evidence.items() if "+" not in label])
        any_single = np.log(1 - _NO_GAP) + float(np.logaddexp.reduce(singles)) - np.log(singles.size)
        return float(np.logaddexp(np.log(_NO_GAP), any_single))


@dataclass(frozen=True)
class SharedCause:
    """A cause that several members may share.

    Args:
        effects: names, one or two.
        probability: that it is what they share.
        log_evidence: against nothing shared.
        prevalence: share of the members that have it.
        carriers: probability that each member has it (N,).
        mean: of the strengths; None where fewer than two members give one.
        between: standard deviation of the strengths between members.
        unit: of the strengths.
    """

    effects: tuple[str, ...]
    probability: float
    log_evidence: float
    prevalence: Interval
    carriers: Array
    mean: Interval | None
    between: float | None
    unit: str

    @property
    def label(self) -> str:
        return "+".join(self.effects)


@dataclass(frozen=True)
class Cohort:
    """What a cohort shares.

    Args:
        members: in order.
        p_value: of no gap in any of them.
        causes: likeliest first.
        unshared: probability that nothing is shared.
        chosen: names in the verdict's set.
        set_probability: of the set.
    """

    members: tuple[Member, ...]
    p_value: float
    causes: tuple[SharedCause, ...]
    unshared: float
    chosen: tuple[str, ...]
    set_probability: float

    @property
    def present(self) -> bool:
        return self.p_value <= CLAIM

    @property
    def kind(self) -> str:
        """none, named, ambiguous or unknown (gaps, but nothing that they share)."""
        if not self.present:
            return "none"
        if not self.chosen:
            return "unknown"
        return "named" if len(self.chosen) == 1 else "ambiguous"


def in_common(members: Sequence[Member]) -> Cohort:
    """The causes that data sets share.

    Args:
        members: two or more.
    """
    background = np.array([m.background for m in members])
    labels = list(dict.fromkeys(label for m in members for label in m.evidence))
    found = [_judged(label, members, background) for label in labels]
    probability, unshared = probabilities({c.label: c.log_evidence for c in found}, 0.0)
    ranked = sorted(found, key=lambda c: -c.log_evidence)
    listed = [c for c in ranked if probability[c.label] > _NEGLIGIBLE and c.log_evidence > 0][:_LISTED]
    p = _together([m.p_value for m in members])
    chosen: tuple[str, ...] = ()
    if p <= CLAIM and unshared < 0.5 and listed:
        chosen = smallest_set({c.label: probability[c.label] for c in listed}, _alike(members))
    causes = tuple(replace(c, probability=probability[c.label]) for c in listed)
    total = sum(probability[name] for name in chosen)
    return Cohort(tuple(members), p, causes if p <= CLAIM else (), unshared, chosen, total)


def _judged(label: str, members: Sequence[Member], background: Array) -> SharedCause:
    """One cause with its evidence; its probability is not known yet."""
    names = tuple(label.split("+"))
    own = np.array([m.holding(names) for m in members])
    plain = _mixture(own, background)
    strengths = [m.strengths.get(label) for m in members]
    informed = plain
    for least in _CARRY:
        carrying = [s if share > least else None for s, share in zip(strengths, informed.carriers)]
        informed = _mixture(own + _at_their_strength(strengths, carrying), background)
    known = [s for s, share in zip(strengths, informed.carriers) if s is not None and share > _CARRY[-1]]
    pooled = _pooled(known)
    return SharedCause(
        names,
        0.0,
        plain.log_evidence,
        informed.prevalence,
        informed.carriers,
        None if pooled is None else pooled.interval,
        None if pooled is None else pooled.between,
        known[0].unit if known else "",
    )


@dataclass(frozen=True)
class _Mixture:
    """Members that have a cause with some prevalence, or what any data set may have."""

    log_evidence: float
    prevalence: Interval
    carriers: Array


def _mixture(own: Array, background: Array) -> _Mixture:
    mixed = np.logaddexp(np.log1p(-_PREVALENCES[:, None]) + background, np.log(_PREVALENCES[:, None]) + own)
    by_prevalence = (mixed - background).sum(axis=1)
    total = float(np.logaddexp.reduce(by_prevalence))
    weight = np.exp(by_prevalence - total)
    low, high = np.interp(_TAILS, np.cumsum(weight), _PREVALENCES)
    carriers = weight @ np.exp(np.log(_PREVALENCES[:, None]) + own - mixed)
    return _Mixture(
        total - float(np.log(_PREVALENCES.size)),
        Interval(float(weight @ _PREVALENCES), float(low), float(high)),
        carriers,
    )


def _at_their_strength(strengths: Sequence[Estimate | None], carrying: Sequence[Estimate | None]) -> Array:
    """What every member's evidence gains where a cause has the strength of the other carriers, not just any."""
    gains = np.zeros(len(strengths))
    for i, mine in enumerate(strengths):
        others = _pooled([s for j, s in enumerate(carrying) if j != i and s is not None])
        if mine is None or others is None:
            continue
        error = _error(mine)
        between = max(others.between, _LEAST_SPREAD * abs(others.mean))
        wide = between**2 + others.error**2 + error**2
        there = -0.5 * ((mine.value - others.mean) ** 2 / wide + np.log(wide / error**2))
        gains[i] = there + 0.5 * (mine.value / error) ** 2 - float(two_sided(np.asarray(mine.value / error)))
    return gains


@dataclass(frozen=True)
class _Pooled:
    """Strengths together: their mean with its error, and the spread between members beyond their own errors."""

    mean: float
    error: float
    between: float

    @property
    def interval(self) -> Interval:
        return Interval(self.mean, self.mean - _Z90 * self.error, self.mean + _Z90 * self.error)


def _pooled(strengths: Sequence[Estimate]) -> _Pooled | None:
    """None of fewer than two strengths, or of what has none."""
    if len(strengths) < 2 or strengths[0].unit == "flag":
        return None
    values = np.array([s.value for s in strengths])
    variance = np.array([_error(s) for s in strengths]) ** 2
    weight = 1.0 / variance
    fixed = (weight @ values) / weight.sum()
    excess = weight @ (values - fixed) ** 2 - (len(values) - 1)
    spread = max(excess / (weight.sum() - (weight**2).sum() / weight.sum()), 0.0)
    weight = 1.0 / (variance + spread)
    mean, error = float((weight @ values) / weight.sum()), float(weight.sum() ** -0.5)
    return _Pooled(mean, error, float(np.sqrt(spread)))


def _error(strength: Estimate) -> float:
    return max((strength.high - strength.low) / (2.0 * _Z90), 1e-6)


def _together(p_values: Sequence[float]) -> float:
    """Fisher's combined p-value."""
    return float(chi2.sf(-2.0 * np.log(p_values).sum(), 2 * len(p_values)))


def _alike(members: Sequence[Member]) -> dict[frozenset[str], float]:
    """Mean cosine of every pair of causes over the members that know it."""
    known: dict[frozenset[str], list[float]] = {}
    for member in members:
        for pair, cosine in member.alike.items():
            known.setdefault(pair, []).append(cosine)
    return {pair: float(np.mean(cosines)) for pair, cosines in known.items()}
