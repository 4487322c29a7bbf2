"""What several data sets have in common: causes that they share, in which of them, and how strong.

Every member has a shared cause e with some prevalence, or what any data set may have: no gap, any one effect of the
catalogue, or a gap of no name (see `sharing`). That nothing is shared is as likely beforehand as that some one of n
causes is, any of them alike:

    P(nothing) = 1 / (1 + sum_e B(e) / n)

A gap of no name is one cause more. What some members share is then taken for theirs, and the others are asked again
what they share, until that is nothing; and each cause once more with all the others there.

The mean strength that is said is that of DerSimonian and Laird; its interval is theirs, or that of Student's t with the
spread that is seen (Hartung, Knapp), whichever is wider: a spread that few members tell is itself unsure. An error that
all members have alike is not averaged away.

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
from petkin.diagnosis.evidence import SECOND
from petkin.diagnosis.how_far import Interval
from petkin.diagnosis.sets import in_place_of, smallest_set
from petkin.diagnosis.sharing import LEAST_ERROR, Mixture, about_the_same, error_of, mixture
from petkin.diagnosis.verdict import Z90, Diagnosis, Strength

Array = NDArray[np.float64]

#: The chance that a member without a shared cause has no gap.
_NO_GAP = 0.5
_LISTED, _NEGLIGIBLE, _TAIL = 8, 0.005, 0.95
#: Probability from which on a member's strength counts among the carriers'.
_CARRY = 0.5
#: Causes that different members share, at most, and the probability of nothing below which there is one beside others.
_GROUPS, _HARDLY = 3, 0.1
#: What a gap of no name is called among labels.
UNNAMED = ""


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
        unnamed: log evidence of a gap of no name.
    """

    label: str
    p_value: float
    evidence: Mapping[str, float]
    strengths: Mapping[str, Strength]
    alike: Mapping[frozenset[str], float]
    against: AgainstNoise
    unnamed: float = -np.inf

    @classmethod
    def of(cls, label: str, found: Diagnosis) -> Member:
        """A diagnosis as a member of a cohort."""
        evidence = {name: value for name, (_, value) in found.evidence.items()}
        evidence |= {cause.label: cause.log_evidence for cause in found.likely}
        unnamed = in_place_of([*evidence.values()], found.unknown_evidence)
        return cls(label, found.p_value, evidence, found.strengths, found.alike, found.against, unnamed)

    def holding(self, names: Sequence[str]) -> float:
        """Log evidence of all explanations that hold these effects, averaged over the pairs a second could make; of
        none of them where there are no effects."""
        if not names:
            return self.unnamed
        within = [value for label, value in self.evidence.items() if set(names) <= set(label.split("+"))]
        if len(names) == 2 and not within:
            return max(self.evidence.get(name, 0.0) for name in names) - SECOND
        return float(np.logaddexp.reduce(within)) if within else 0.0

    @property
    def background(self) -> float:
        """Log evidence of no effect, or any one, alone or with any second, as `holding` has it of the likeliest, or a
        gap of no name."""
        causes = 1 + sum("+" not in label for label in self.evidence)
        explained = [value + np.log(1 + label.count("+")) for label, value in self.evidence.items()]
        any_cause = np.log(1 - _NO_GAP) + float(np.logaddexp.reduce([*explained, self.unnamed])) - np.log(causes)
        return float(np.logaddexp(np.log(_NO_GAP), any_cause))


@dataclass(frozen=True)
class SharedCause:
    """A cause that several members may share.

    Args:
        effects: names, one or two; none of a gap of no name.
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
class Group:
    """What some members share.

    Args:
        causes: that it may be, likeliest first.
        unnamed: a gap of no name.
        unshared: probability that it is nothing.
        chosen: names in the verdict's set; none where it is no name, or nothing.
        set_probability: of the set.
    """

    causes: tuple[SharedCause, ...]
    unnamed: SharedCause
    unshared: float
    chosen: tuple[str, ...]
    set_probability: float

    @property
    def leader(self) -> SharedCause | None:
        """What it is; None where it is rather nothing."""
        if self.unshared >= 0.5:
            return None
        return self.causes[0] if self.chosen else self.unnamed


@dataclass(frozen=True)
class Cohort:
    """What a cohort shares.

    Args:
        members: in order.
        p_value: of no gap in any of them.
        groups: what members share, that with the most evidence first; one at least, which may be nothing.
    """

    members: tuple[Member, ...]
    p_value: float
    groups: tuple[Group, ...]

    @property
    def present(self) -> bool:
        return self.p_value <= CLAIM

    @property
    def causes(self) -> tuple[SharedCause, ...]:
        """Of the first group, where there is a gap."""
        return self.groups[0].causes if self.present else ()

    @property
    def unshared(self) -> float:
        """Probability that nothing is shared."""
        return self.groups[0].unshared

    @property
    def chosen(self) -> tuple[str, ...]:
        """Names in the verdict's set."""
        return self.groups[0].chosen if self.present else ()

    @property
    def set_probability(self) -> float:
        return self.groups[0].set_probability if self.present else 0.0

    @property
    def further(self) -> tuple[Group, ...]:
        """What other members share that has a name."""
        return tuple(group for group in self.groups[1:] if group.chosen) if self.present else ()

    @property
    def unnamed(self) -> SharedCause | None:
        """The gap of no name that some share."""
        leaders = [group.leader for group in self.groups] if self.present else []
        return next((leader for leader in leaders if leader is not None and not leader.effects), None)

    @property
    def kind(self) -> str:
        """none, named, ambiguous or unknown (of no name, or gaps but nothing that they share)."""
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
    bare = np.array([m.background for m in members])
    first = _asked(members, bare)
    leaders: list[SharedCause] = []
    asked = first
    while asked.leader is not None and len(leaders) < _GROUPS and (not leaders or asked.unshared < _HARDLY):
        leaders.append(asked.leader)
        asked = _asked(members, _beside(members, bare, leaders))
    groups = [first]
    if len(leaders) > 1:
        groups = [_asked(members, _beside(members, bare, [o for o in leaders if o is not own])) for own in leaders]
        groups = sorted((group for group in groups if group.unshared < _HARDLY), key=_most, reverse=True) or [first]
    p = any_gap([m.p_value for m in members], [m.against for m in members])
    return Cohort(tuple(members), p, tuple(groups))


def _most(group: Group) -> float:
    return max([group.unnamed.log_evidence, *(cause.log_evidence for cause in group.causes)])


def _asked(members: Sequence[Member], background: Array) -> Group:
    """What members share of which each may have such a background (N,) instead."""
    labels = list(dict.fromkeys(label for m in members for label in m.evidence))
    found = {label: _judged(label, members, background) for label in (*labels, UNNAMED)}
    probability, unshared = _probabilities({label: c.log_evidence for label, c in found.items()})
    ranked = sorted(labels, key=lambda label: -found[label].log_evidence)
    listed = [name for name in ranked if probability[name] > _NEGLIGIBLE and found[name].log_evidence > 0][:_LISTED]
    chosen: tuple[str, ...] = ()
    if unshared < 0.5 and probability[UNNAMED] < 0.5 * (1.0 - unshared) and listed:
        chosen = smallest_set({name: probability[name] for name in listed}, _alike(members))
    said = {label: replace(found[label], probability=probability[label]) for label in (*listed, UNNAMED)}
    total = sum(probability[name] for name in chosen)
    return Group(tuple(said[name] for name in listed), said[UNNAMED], unshared, chosen, total)


def _beside(members: Sequence[Member], background: Array, causes: Sequence[SharedCause]) -> Array:
    """Log evidence of members (N,) who have such causes, or not."""
    for cause in causes:
        background = _shared(cause.label, members, background).beside
    return background


def _probabilities(evidence: Mapping[str, float]) -> tuple[dict[str, float], float]:
    """Of every cause that may be shared, and that none is.

    Args:
        evidence: log evidence by name, against nothing shared; a pair's holds what a second effect costs.
    """
    logs = np.array([*evidence.values()]) - np.log(sum("+" not in name for name in evidence))
    total = float(np.logaddexp.reduce([0.0, *logs]))
    return {name: float(np.exp(value - total)) for name, value in zip(evidence, logs)}, float(np.exp(-total))


def _shared(label: str, members: Sequence[Member], background: Array) -> Mixture:
    own = np.array([m.holding(_names(label)) for m in members])
    return mixture(own, about_the_same(own, [m.strengths.get(label) for m in members]), background)


def _names(label: str) -> tuple[str, ...]:
    return tuple(label.split("+")) if label != UNNAMED else ()


def _judged(label: str, members: Sequence[Member], background: Array) -> SharedCause:
    """One cause with its evidence; its probability is not known yet."""
    found = _shared(label, members, background)
    known = [m.strengths[label] for m, s in zip(members, found.carriers) if label in m.strengths and s > _CARRY]
    pooled = _pooled(known)
    return SharedCause(
        _names(label),
        0.0,
        found.log_evidence,
        found.prevalence,
        found.carriers,
        None if pooled is None else pooled.interval,
        None if pooled is None else pooled.between,
        known[0].unit if known else "",
    )


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
    variance = np.maximum(np.array([error_of(s) for s in strengths]) ** 2 - (alike * values) ** 2, LEAST_ERROR**2)
    weight = 1.0 / variance
    fixed = (weight @ values) / weight.sum()
    excess = weight @ (values - fixed) ** 2 - (len(values) - 1)
    spread = max(excess / (weight.sum() - (weight**2).sum() / weight.sum()), 0.0)
    weight = 1.0 / (variance + spread)
    mean = float((weight @ values) / weight.sum())
    seen = (weight @ (values - mean) ** 2) / (len(values) - 1)
    own = max(Z90, stdtrit(len(values) - 1, _TAIL) * np.sqrt(seen)) * weight.sum() ** -0.5
    half = float(np.hypot(own, Z90 * alike.max() * mean))
    return _Pooled(Interval(mean, mean - half, mean + half), float(np.sqrt(spread)))


def _alike(members: Sequence[Member]) -> dict[frozenset[str], float]:
    """Mean cosine of every pair of causes over the members that know it."""
    known: dict[frozenset[str], list[float]] = {}
    for member in members:
        for pair, cosine in member.alike.items():
            known.setdefault(pair, []).append(cosine)
    return {pair: float(np.mean(cosines)) for pair, cosines in known.items()}
