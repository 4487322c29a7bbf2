"""One data set of several, with what it says of every explanation by itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.detect import AgainstNoise
from petkin.diagnosis.evidence import SECOND
from petkin.diagnosis.how_far import Interval
from petkin.diagnosis.profile import Profile
from petkin.diagnosis.sets import in_place_of
from petkin.diagnosis.strength import Strength
from petkin.diagnosis.verdict import Diagnosis

Array = NDArray[np.float64]

#: Chances, as likely, that a member without a shared cause has no gap.
_NO_GAP = np.array([0.5, 0.95])


@dataclass(frozen=True)
class Member:
    """One data set.

    Args:
        label: its name.
        p_value: of no gap.
        evidence: log evidence by explanation, "a" or "a+b".
        strengths: of single effects, each at the setting that suits it best.
        alike: cosines by pair of explanations.
        against: what speaks for a gap, against draws of noise.
        unnamed: log evidence of a gap of no name.
        profiles: how evidence goes with setting and size, of single effects.
        closures: share of the gap that the likeliest explanations close.
    """

    label: str
    p_value: float
    evidence: Mapping[str, float]
    strengths: Mapping[str, Strength]
    alike: Mapping[frozenset[str], float]
    against: AgainstNoise
    unnamed: float = -np.inf
    profiles: Mapping[str, Profile] = field(default_factory=dict)
    closures: Mapping[str, Interval] = field(default_factory=dict)

    @classmethod
    def of(cls, label: str, found: Diagnosis) -> Member:
        """A diagnosis as a member of a cohort."""
        evidence = {name: value for name, (_, value) in found.evidence.items()}
        evidence |= {cause.label: cause.log_evidence for cause in found.likely}
        unnamed = in_place_of([*evidence.values()], found.unknown_evidence)
        closures = {cause.label: cause.closure for cause in found.likely if cause.closure is not None}
        return cls(
            label=label,
            p_value=found.p_value,
            evidence=evidence,
            strengths=found.strengths,
            alike=found.alike,
            against=found.against,
            unnamed=unnamed,
            profiles=found.profiles,
            closures=closures,
        )

    def holding(self, names: Sequence[str]) -> float:
        """Log evidence of all explanations that hold these effects, averaged over the pairs a second could make; of
        none of them where there are no effects."""
        if not names:
            return self.unnamed
        within = [value for label, value in self.evidence.items() if set(names) <= set(label.split("+"))]
        if len(names) == 2 and not within:
            return max(self.evidence.get(name, 0.0) for name in names) - SECOND
        return float(np.logaddexp.reduce(within)) if within else 0.0

    def strength(self, name: str) -> Strength | None:
        """Of an effect, with the interval that it has where its setting is not known; None of what has none."""
        own, profile = self.strengths.get(name), self.profiles.get(name)
        return own if own is None or profile is None else profile.over_settings(own)

    @property
    def background(self) -> Array:
        """Log evidence of no effect, or any one, alone or with any second, as `holding` has it of the likeliest, or a
        gap of no name; for every chance of no gap (Q,)."""
        causes = 1 + sum("+" not in label for label in self.evidence)
        explained = [value + np.log(1 + label.count("+")) for label, value in self.evidence.items()]
        any_cause = np.log(1 - _NO_GAP) + float(np.logaddexp.reduce([*explained, self.unnamed])) - np.log(causes)
        return np.asarray(np.logaddexp(np.log(_NO_GAP), any_cause), np.float64)
