"""What several data sets have in common: causes that they share, in which of them, and how strong.

Every member has a shared cause e with probability pi, at a strength of its own, or else what any data set may have:

    log B(e) = log int prod_i [(1 - pi) b_i + pi e_i] d pi - sum_i log b_i

with e_i the evidence of all explanations of member i that hold e, and b_i that of none or any of the catalogue.
Strengths are drawn about a common mean, with a spread between members by DerSimonian and Laird.

Reference: DerSimonian R, Laird N. Meta-analysis in clinical trials. Control Clin Trials 1986;7:177-188.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from petkin.diagnosis.diagnose import CLAIM
from petkin.diagnosis.evidence import SECOND
from petkin.diagnosis.how_far import Interval
from petkin.diagnosis.sets import probabilities, smallest_set
from petkin.diagnosis.verdict import Diagnosis

Array = NDArray[np.float64]

#: Prevalences tried, from where a cause is shared rather than chance; the chance that a member without it has no gap.
_PREVALENCES = np.linspace(0.15, 0.99, 43)
_NO_GAP = 0.5
_TAILS, _Z90 = (0.05, 0.95), 1.6448536269514722
_LISTED, _NEGLIGIBLE = 8, 0.005


@dataclass(frozen=True)
class Strength:
    """How strong an effect is in one data set, with its 90 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Member:
    """One data set.

    Args:
        label: its name.
        p_value: of no gap.
        evidence: log evidence by explanation, "a" or "a+b".
        strengths: of single effects that were fitted.
        alike: cosines by pair of explanations.
    """

    label: str
    p_value: float
    evidence: Mapping[str, float]
    strengths: Mapping[str, Strength]
    alike: Mapping[frozenset[str], float]

    @classmethod
    def of(cls, label: str, found: Diagnosis) -> Member:
        """A diagnosis as a member of a cohort."""
        evidence = {name: value for name, (_, value) in found.evidence.items()}
        evidence |= {cause.label: cause.log_evidence for cause in found.likely}
        first = {c.label: c.estimates[0] for c in found.likely if len(c.effects) == 1 and c.estimates}
        strengths = {name: Strength(e.value, e.low, e.high, e.unit) for name, e in first.items()}
        return cls(label, found.p_value, evidence, strengths, found.alike)

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
    mixed = np.logaddexp(np.log1p(-_PREVALENCES[:, None]) + background, np.log(_PREVALENCES[:, None]) + own)
    by_prevalence = (mixed - background).sum(axis=1)
    total = float(np.logaddexp.reduce(by_prevalence))
    weight = np.exp(by_prevalence - total)
    low, high = np.interp(_TAILS, np.cumsum(weight), _PREVALENCES)
    carriers = weight @ np.exp(np.log(_PREVALENCES[:, None]) + own - mixed)
    prevalence = Interval(float(weight @ _PREVALENCES), float(low), float(high))
    carrying = [m.strengths.get(label) for m, share in zip(members, carriers) if share > 0.5]
    strengths = [s for s in carrying if s is not None]
    mean, between = _pooled(strengths)
    return SharedCause(
        names,
        0.0,
        total - np.log(_PREVALENCES.size),
        prevalence,
        carriers,
        mean,
        between,
        strengths[0].unit if strengths else "",
    )


def _pooled(strengths: Sequence[Strength]) -> tuple[Interval | None, float | None]:
    """Mean with its 90 % interval, and the spread between members beyond their own errors."""
    if len(strengths) < 2 or strengths[0].unit == "flag":
        return None, None
    values = np.array([s.value for s in strengths])
    variance = np.maximum(np.array([(s.high - s.low) / (2 * _Z90) for s in strengths]), 1e-12) ** 2
    weight = 1.0 / variance
    fixed = (weight @ values) / weight.sum()
    excess = weight @ (values - fixed) ** 2 - (len(values) - 1)
    spread = max(excess / (weight.sum() - (weight**2).sum() / weight.sum()), 0.0)
    weight = 1.0 / (variance + spread)
    mean, error = float((weight @ values) / weight.sum()), float(weight.sum() ** -0.5)
    return Interval(mean, mean - _Z90 * error, mean + _Z90 * error), float(np.sqrt(spread))


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
