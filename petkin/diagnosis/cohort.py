"""What several data sets have in common: causes that they share, in which of them, and how strong.

Every member has a shared cause e with probability pi, or else what any data set may have:

    log B(e) = log int prod_i [(1 - pi) b_i + pi e_i] d pi - sum_i log b_i

with e_i the evidence of all explanations of member i that hold e, and b_i that of none or any of the catalogue. That
nothing is shared is as likely beforehand as that some one of n causes is, any of them alike:

    P(nothing) = 1 / (1 + sum_e B(e) / n)

A cause's strength is either any in each member, or about the same in all, as likely: normal about m with a spread of
some share of it, both unknown. A member whose strength is s with error d then has, of what it had averaged over
strengths of its own (B(t), see `evidence`),

    e_i exp(t^2 / 2) / B(t) N(s; m, spread^2 + d^2) / N(0; 0, d^2),    t = s / d

So what is too weak in each is told by all where their strengths agree, and a member that shows none of a cause that is
strong elsewhere does not have it weakly. Where strengths differ between channels they have nothing in common. The mean
strength that is said is that of DerSimonian and Laird; its interval is theirs, or that of Student's t with the spread
that is seen (Hartung, Knapp), whichever is wider: a spread that few members tell is itself unsure. An error that all
members have alike is not averaged away.

Reference: DerSimonian R, Laird N. Meta-analysis in clinical trials. Control Clin Trials 1986;7:177-188; Knapp G,
Hartung J. Stat Med 2003;22:2693-2710.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from petkin.diagnosis.any_gap import any_gap
from petkin.diagnosis.detect import CLAIM, AgainstNoise
from petkin.diagnosis.evidence import SECOND, one_sided, two_sided
from petkin.diagnosis.how_far import Interval
from petkin.diagnosis.sets import smallest_set
from petkin.diagnosis.verdict import Z90, Diagnosis, Estimate, Strength

Array = NDArray[np.float64]

#: Prevalences tried, from where a cause is shared rather than chance; the chance that a member without it has no gap.
_PREVALENCES = np.linspace(0.15, 0.99, 43)
_NO_GAP = 0.5
_TAILS = (0.05, 0.95)
_LISTED, _NEGLIGIBLE = 8, 0.005
#: The least standard deviation that a strength is taken to have, in its unit.
_LEAST_ERROR = 1e-6
#: Probability from which on a member's strength counts among the carriers'.
_CARRY = 0.5
#: A strength in common: in units of the median error, and by how much of itself it differs between members.
_COMMON, _SPREADS = np.geomspace(0.8, 80.0, 60), (0.2, 0.4)


@dataclass(frozen=True)
class Member:
    """One data set.

    Args:
        label: its name.
        p_value: of no gap.
        evidence: log evidence by explanation, "a" or "a+b".
        strengths: of single effects.
        alike: cosines by pair of explanations.
        against: what speaks for a gap, against draws of noise.
    """

    label: str
    p_value: float
    evidence: Mapping[str, float]
    strengths: Mapping[str, Strength]
    alike: Mapping[frozenset[str], float]
    against: AgainstNoise

    @classmethod
    def of(cls, label: str, found: Diagnosis) -> Member:
        """A diagnosis as a member of a cohort."""
        evidence = {name: value for name, (_, value) in found.evidence.items()}
        evidence |= {cause.label: cause.log_evidence for cause in found.likely}
        return cls(label, found.p_value, evidence, found.strengths, found.alike, found.against)

    def holding(self, names: Sequence[str]) -> float:
        """Log evidence of all explanations that hold these effects, averaged over the pairs a second could make."""
        within = [value for label, value in self.evidence.items() if set(names) <= set(label.split("+"))]
        if len(names) == 2 and not within:
            return max(self.evidence.get(name, 0.0) for name in names) - SECOND
        return float(np.logaddexp.reduce(within)) if within else 0.0

    @property
    def background(self) -> float:
        """Log evidence of no effect, or any one, alone or with any second, as `holding` has it of the likeliest."""
        singles = sum("+" not in label for label in self.evidence)
        explained = np.array([value + np.log(1 + label.count("+")) for label, value in self.evidence.items()])
        any_cause = np.log(1 - _NO_GAP) + float(np.logaddexp.reduce(explained)) - np.log(singles)
        return float(np.logaddexp(np.log(_NO_GAP), any_cause))


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
    probability, unshared = _probabilities({c.label: c.log_evidence for c in found})
    ranked = sorted(found, key=lambda c: -c.log_evidence)
    listed = [c for c in ranked if probability[c.label] > _NEGLIGIBLE and c.log_evidence > 0][:_LISTED]
    p = any_gap([m.p_value for m in members], [m.against for m in members])
    chosen: tuple[str, ...] = ()
    if p <= CLAIM and unshared < 0.5 and listed:
        chosen = smallest_set({c.label: probability[c.label] for c in listed}, _alike(members))
    causes = tuple(replace(c, probability=probability[c.label]) for c in listed)
    total = sum(probability[name] for name in chosen)
    return Cohort(tuple(members), p, causes if p <= CLAIM else (), unshared, chosen, total)


def _probabilities(evidence: Mapping[str, float]) -> tuple[dict[str, float], float]:
    """Of every cause that may be shared, and that none is.

    Args:
        evidence: log evidence by name, against nothing shared; a pair's holds what a second effect costs.
    """
    logs = np.array([*evidence.values()]) - np.log(sum("+" not in name for name in evidence))
    total = float(np.logaddexp.reduce([0.0, *logs]))
    return {name: float(np.exp(value - total)) for name, value in zip(evidence, logs)}, float(np.exp(-total))


def _judged(label: str, members: Sequence[Member], background: Array) -> SharedCause:
    """One cause with its evidence; its probability is not known yet."""
    names = tuple(label.split("+"))
    own = np.array([m.holding(names) for m in members])
    strengths = [m.strengths.get(label) for m in members]
    found = _mixture(own, _about_the_same(own, strengths), background)
    known = [s for s, share in zip(strengths, found.carriers) if s is not None and share > _CARRY]
    pooled = _pooled(known)
    return SharedCause(
        names,
        0.0,
        found.log_evidence,
        found.prevalence,
        found.carriers,
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


def _mixture(own: Array, common: Array, background: Array) -> _Mixture:
    """Of members' evidence with strengths of their own (N,), and with each of some they have in common (S, N)."""
    every = np.concatenate([own[None], common])
    share = np.full(len(every), np.log(0.5 / max(len(common), 1)))
    share[0] = np.log(0.5 if len(common) else 1.0)
    having = np.log(_PREVALENCES)[:, None] + every[:, None]
    mixed = np.logaddexp(np.log1p(-_PREVALENCES)[:, None] + background, having)
    logs = share[:, None] + (mixed - background).sum(axis=-1)
    total = float(np.logaddexp.reduce(logs, axis=None))
    weight = np.exp(logs - total)
    by_prevalence = weight.sum(axis=0)
    low, high = np.interp(_TAILS, np.cumsum(by_prevalence), _PREVALENCES)
    return _Mixture(
        total - float(np.log(_PREVALENCES.size)),
        Interval(float(by_prevalence @ _PREVALENCES), float(low), float(high)),
        np.einsum("sp,spn->n", weight, np.exp(having - mixed)),
    )


def _about_the_same(own: Array, strengths: Sequence[Strength | None]) -> Array:
    """Members' evidence at each of the strengths and spreads that they may have in common (S, N); no rows where there
    is no such strength."""
    known = [s for s in strengths if s is not None and s.single]
    if len(known) < len(strengths):
        return np.zeros((0, own.size))
    values, errors = np.array([s.value for s in known]), np.array([_error(s) for s in known])
    signed, t = known[0].signed, values / errors
    best = own + 0.5 * t**2 - (two_sided(t) if signed else one_sided(t))
    mean = _COMMON * np.median(errors)
    mean = np.concatenate([mean, -mean]) if signed else mean
    each = mean[:, None, None]
    wide = (np.array(_SPREADS)[:, None] * each) ** 2 + errors**2
    return (best - 0.5 * (np.log(wide / errors**2) + (values - each) ** 2 / wide)).reshape(-1, own.size)


@dataclass(frozen=True)
class _Pooled:
    """Strengths together: their mean with its 90 % interval, and the spread between members beyond their own errors."""

    interval: Interval
    between: float


def _pooled(strengths: Sequence[Strength]) -> _Pooled | None:
    """None of fewer than two strengths, of what has none, or of what is in another channel of each, or goes another
    way."""
    if len(strengths) < 2 or strengths[0].unit == "flag":
        return None
    if len({s.unit for s in strengths}) > 1 or len({s.channel for s in strengths if not s.single}) > 1:
        return None
    values = np.array([s.value for s in strengths])
    alike = np.array([s.alike for s in strengths])
    variance = np.maximum(np.array([_error(s) for s in strengths]) ** 2 - (alike * values) ** 2, _LEAST_ERROR**2)
    weight = 1.0 / variance
    fixed = (weight @ values) / weight.sum()
    excess = weight @ (values - fixed) ** 2 - (len(values) - 1)
    spread = max(excess / (weight.sum() - (weight**2).sum() / weight.sum()), 0.0)
    weight = 1.0 / (variance + spread)
    mean = float((weight @ values) / weight.sum())
    seen = (weight @ (values - mean) ** 2) / (len(values) - 1)
    own = max(Z90, stdtrit(len(values) - 1, _TAILS[1]) * np.sqrt(seen)) * weight.sum() ** -0.5
    half = float(np.hypot(own, Z90 * alike.max() * mean))
    return _Pooled(Interval(mean, mean - half, mean + half), float(np.sqrt(spread)))


def _error(strength: Estimate) -> float:
    return max((strength.high - strength.low) / (2.0 * Z90), _LEAST_ERROR)


def _alike(members: Sequence[Member]) -> dict[frozenset[str], float]:
    """Mean cosine of every pair of causes over the members that know it."""
    known: dict[frozenset[str], list[float]] = {}
    for member in members:
        for pair, cosine in member.alike.items():
            known.setdefault(pair, []).append(cosine)
    return {pair: float(np.mean(cosines)) for pair, cosines in known.items()}
