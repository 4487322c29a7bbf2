"""What several data sets have in common: causes that they share, in which of them, and how strong.

Every member has a shared cause e with some prevalence, or what any data set may have: no gap, any one effect of the
catalogue, or a gap of no name (see `sharing`). That nothing is shared is as likely beforehand as that some one of n
causes is, any of them alike:

    P(nothing) = 1 / (1 + sum_e B(e) / n)

A gap of no name is one cause more. What some members share is then taken for theirs, and the others are asked again
what they share, until that is nothing; and each cause once more with all the others there.

What may be shared is B times as likely as nothing; where there is no gap it is so with a probability of at most 1 / B,
which is a p-value. So a cohort may have a gap that no member shows.

Reference: Vovk V, Wang R. E-values: calibration, combination and applications. Ann Stat 2021;49:1736-1754.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.any_gap import any_gap
from petkin.diagnosis.detect import CLAIM
from petkin.diagnosis.how_far import Interval
from petkin.diagnosis.member import Member
from petkin.diagnosis.pooling import mean_closure, mean_strength, moment
from petkin.diagnosis.profile import Profile
from petkin.diagnosis.sets import smallest_set
from petkin.diagnosis.sharing import Common, Mixture, mixture, together
from petkin.diagnosis.strength import Z90, Strength

Array = NDArray[np.float64]

_LISTED, _NEGLIGIBLE = 8, 0.005
#: Probability from which on a member's strength counts among the carriers'.
_CARRY = 0.5
#: Log evidence from which on a refit says more of a strength than a template.
_SPEAKS = 5.0
#: Share of false alarms that what members share may make, of all, and the least p-value that it is trusted with.
_OF_SHARED, _SURELY = 0.1, 1e-4
#: Log evidence below which it makes no difference whether a gap has a name.
_HARDLY_ANY = 3.0
#: How likely members have something in common, beyond the cause, beforehand.
_IN_COMMON = 0.5
#: Causes that different members share, at most, and the probability of nothing below which there is one beside others.
_GROUPS, _HARDLY = 3, 0.1
#: What a gap of no name is called among labels.
UNNAMED = ""


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
        onset: that they have in common, min; None where they have none, or rather each its own.
        closure: share of the gap that it closes, on average; None where fewer than two members tell.
        like: of a gap of no name, the name that tells what members have in common.
    """

    effects: tuple[str, ...]
    probability: float
    log_evidence: float
    prevalence: Interval
    carriers: Array
    mean: Interval | None
    between: float | None
    unit: str
    onset: Interval | None
    closure: Interval | None
    like: str = ""

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
    bare = np.stack([m.background for m in members], axis=-1)
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
    return Cohort(tuple(members), _p_value(members, first.unshared), tuple(groups))


def _p_value(members: Sequence[Member], unshared: float) -> float:
    """Of no gap in any: by what they say one by one, or by what they may share."""
    any_of_them = any_gap([m.p_value for m in members], [m.against for m in members])
    odds = unshared / max(1.0 - unshared, 1e-300)
    return min(any_of_them / (1.0 - _OF_SHARED), max(odds, _SURELY) / _OF_SHARED, 1.0)


def _most(group: Group) -> float:
    return max([group.unnamed.log_evidence, *(cause.log_evidence for cause in group.causes)])


def _asked(members: Sequence[Member], background: Array) -> Group:
    """What members share of which each may have such a background (Q, N) instead."""
    labels = list(dict.fromkeys(label for m in members for label in m.evidence))
    found = {label: _judged(label, members, background) for label in labels}
    like = max(labels, key=lambda label: found[label].log_evidence, default="")
    found[UNNAMED] = _judged(UNNAMED, members, background, like)
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
    """Log evidence of members (Q, N) who have such causes, or not."""
    for cause in causes:
        background = _shared(cause.label, members, background, cause.like)[0].beside
    return background


def _probabilities(evidence: Mapping[str, float]) -> tuple[dict[str, float], float]:
    """Of every cause that may be shared, and that none is.

    Args:
        evidence: log evidence by name, against nothing shared; a pair's holds what a second effect costs.
    """
    logs = np.array([*evidence.values()]) - np.log(sum("+" not in name for name in evidence))
    total = float(np.logaddexp.reduce([0.0, *logs]))
    return {name: float(np.exp(value - total)) for name, value in zip(evidence, logs)}, float(np.exp(-total))


def _shared(
    label: str, members: Sequence[Member], background: Array, like: str = ""
) -> tuple[Mixture, tuple[Profile, ...]]:
    """Who has a cause, and profiles of it where a setting may be in common.

    What a gap of no name has in common is told by the name that it is most like: `like` and what that lacks.
    """
    own = np.array([m.holding(_names(label)) for m in members])
    told = like if label == UNNAMED else label
    named = np.array([m.holding(_names(told)) for m in members]) if told != label else own
    common, at = together(named, [m.strengths.get(told) for m in members], [m.profiles.get(told) for m in members])
    if label != UNNAMED:
        return mixture(own, common, background, share=_IN_COMMON), at
    names = len({name for m in members for name in m.evidence if "+" not in name})
    beyond = np.maximum(own, _HARDLY_ANY) - np.maximum(named, _HARDLY_ANY)
    common = [Common(kind.evidence + beyond) for kind in common]
    return mixture(own, common, background, share=_IN_COMMON / max(names, 1)), ()


def _names(label: str) -> tuple[str, ...]:
    return tuple(label.split("+")) if label != UNNAMED else ()


def _judged(label: str, members: Sequence[Member], background: Array, like: str = "") -> SharedCause:
    """One cause with its evidence; its probability is not known yet."""
    found, at = _shared(label, members, background, like)
    carrying = [i for i, share in enumerate(found.carriers) if share > _CARRY]
    known, onset = [s for i in carrying if (s := members[i].strength(label)) is not None], None
    if at and found.settings.sum() > _CARRY:
        onset = moment([setting.get("onset") for setting in at[0].settings], found.settings)
        place = int(found.settings.argmax())
        known = [_there(members[i], label, at[i], place) for i in carrying]
    pooled = mean_strength(known)
    return SharedCause(
        _names(label),
        0.0,
        found.log_evidence,
        found.prevalence,
        found.carriers,
        None if pooled is None else pooled.interval,
        None if pooled is None else pooled.between,
        known[0].unit if known else "",
        onset,
        mean_closure([members[i].closures[label] for i in carrying if label in members[i].closures]),
        like,
    )


def _there(member: Member, label: str, at: Profile, place: int) -> Strength:
    """The strength at a setting in common of a member that says little of its own; that after a refit of the others.

    The truth lies somewhere between settings, so that a template misses a share of it, the same in all members."""
    own, missed = member.strengths[label], float(at.missed[place])
    if member.holding((label,)) > _SPEAKS or np.isnan(at.values[place]):
        return own
    value, error = (float(one[place]) / (1.0 - 0.5 * missed) for one in (at.values, at.errors))
    alike = missed / np.sqrt(12.0)
    half = Z90 * float(np.hypot(error, alike * value))
    return replace(own, value=value, low=value - half, high=value + half, alike=float(alike))


def _alike(members: Sequence[Member]) -> dict[frozenset[str], float]:
    """Mean cosine of every pair of causes over the members that know it."""
    known: dict[frozenset[str], list[float]] = {}
    for member in members:
        for pair, cosine in member.alike.items():
            known.setdefault(pair, []).append(cosine)
    return {pair: float(np.mean(cosines)) for pair, cosines in known.items()}
