"""What a diagnosis says: causes with their estimates, and everything about the gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.design import Visible
from petkin.diagnosis.detect import CLAIM, AgainstNoise
from petkin.diagnosis.how_far import Interval
from petkin.diagnosis.profile import Profile
from petkin.diagnosis.refit import Fit
from petkin.diagnosis.strength import Estimate, Strength
from petkin.diagnosis.where import PART, Place

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Cause:
    """One explanation.

    Args:
        effects: names, one or two.
        stages: of each.
        probability: of this and no other.
        log_evidence: against no effect.
        estimates: amplitude first.
        closure: share of the gap that it closes, held out.
        fit: with it.
        left: log evidence of a gap of no name in what it leaves, where somebody looked.
    """

    effects: tuple[str, ...]
    stages: tuple[str, ...]
    probability: float
    log_evidence: float
    estimates: tuple[Estimate, ...] = ()
    closure: Interval | None = None
    fit: Fit | None = None
    left: float | None = None

    @property
    def label(self) -> str:
        return "+".join(self.effects)


@dataclass(frozen=True)
class Diagnosis:
    """All that was found.

    Args:
        channels: names.
        present: whether there is a gap beyond noise.
        p_value: of no gap.
        chi2_per_dof: of the simulator alone.
        noise: covariance used.
        base: the simulator's fit.
        causes: likeliest first; of a gap of no name, the nearest.
        unknown: probability of none of the catalogue.
        chosen: names in the verdict's set.
        set_probability: of the set.
        regions, frames: where.
        onset: time of it, or None.
        frame: the one sample that the leader concerns, or None.
        evidence: stage and log evidence of every single effect.
        strengths: amplitude of every single effect.
        unknown_evidence: of a gap of no name.
        unknown_place: where that would be, as in `unknown`.
        visible: what this design could tell.
        alike: cosines by pair of causes.
        likely: the likeliest causes whether or not there is a gap, for what several data sets have in common.
        against: what speaks for a gap in the data and in noise, for the same.
        profiles: of single effects, for the same.
        shown: effects that other data show, whatever this design could tell.
    """

    channels: tuple[str, ...]
    present: bool
    p_value: float
    chi2_per_dof: float
    noise: Noise
    base: Fit
    causes: tuple[Cause, ...]
    unknown: float
    chosen: tuple[str, ...]
    set_probability: float
    regions: Place
    frames: Place
    onset: float | None
    frame: int | None
    evidence: dict[str, tuple[str, float]]
    strengths: dict[str, Strength]
    unknown_evidence: float
    unknown_place: str
    visible: tuple[Visible, ...]
    alike: dict[frozenset[str], float]
    likely: tuple[Cause, ...]
    against: AgainstNoise
    profiles: dict[str, Profile]
    shown: frozenset[str] = frozenset()

    @property
    def kind(self) -> str:
        """none, named, ambiguous or unknown."""
        if not self.present:
            return "none"
        if not self.chosen:
            return "unknown"
        return "named" if len(self.chosen) == 1 else "ambiguous"

    def claims(self, place: Place) -> Array:
        """q-values of parts: none is surer than that there is a gap at all."""
        return np.maximum(place.q_values, min(self.p_value * PART / CLAIM, 1.0))

    @property
    def stages(self) -> dict[str, float]:
        """Probability of every stage, of the named causes."""
        found: dict[str, float] = {}
        for cause in self.causes:
            for stage in cause.stages:
                found[stage] = found.get(stage, 0.0) + cause.probability / len(cause.stages)
        total = sum(found.values())
        return {s: p / total for s, p in sorted(found.items(), key=lambda e: -e[1])} if total > 0 else {}
