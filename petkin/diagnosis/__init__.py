"""Diagnosis: where a simulator departs from data, which effect it misses, and how far that closes the gap."""

from petkin.diagnosis.alone import each_alone
from petkin.diagnosis.cohort import Cohort, Group, SharedCause, in_common
from petkin.diagnosis.contrasts import Best, Contrasted, Pattern, judge_contrasts
from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.departures import Departure
from petkin.diagnosis.design import ABSORBED, Visible, indistinct, witnessed
from petkin.diagnosis.detect import CLAIM
from petkin.diagnosis.diagnose import DRAWS, Detected, Progress, detect, diagnose, draws_left, foresee_design, silent
from petkin.diagnosis.effect import Coordinates, Hypothesis, Profiles, Shape, Sighting, Simulator, Term
from petkin.diagnosis.families import Family
from petkin.diagnosis.how_far import Interval
from petkin.diagnosis.member import Member
from petkin.diagnosis.noise import medians, second_differences
from petkin.diagnosis.nominal import Base, base_fit
from petkin.diagnosis.refit import Fit, State, of_nuisance
from petkin.diagnosis.sets import ALIKE, smallest_set
from petkin.diagnosis.state_map import StateMap, Witness, map_states
from petkin.diagnosis.strength import Z90, Estimate, Strength
from petkin.diagnosis.unknown import DRIVE, ONE, SWINGING, WITHIN, Elsewhere
from petkin.diagnosis.verdict import Cause, Diagnosis
from petkin.diagnosis.where import PART

__all__ = [
    "ABSORBED",
    "ALIKE",
    "CLAIM",
    "DRAWS",
    "DRIVE",
    "ONE",
    "PART",
    "SWINGING",
    "WITHIN",
    "Z90",
    "Base",
    "Best",
    "Cause",
    "Cohort",
    "Contrasted",
    "Coordinates",
    "Departure",
    "Detected",
    "Diagnosis",
    "Elsewhere",
    "Estimate",
    "Family",
    "Fit",
    "Group",
    "Hypothesis",
    "Interval",
    "Member",
    "Noise",
    "Pattern",
    "Profiles",
    "Progress",
    "Shape",
    "SharedCause",
    "Sighting",
    "Simulator",
    "State",
    "StateMap",
    "Strength",
    "Term",
    "Visible",
    "Witness",
    "base_fit",
    "detect",
    "diagnose",
    "draws_left",
    "each_alone",
    "foresee_design",
    "in_common",
    "indistinct",
    "judge_contrasts",
    "map_states",
    "medians",
    "of_nuisance",
    "second_differences",
    "silent",
    "smallest_set",
    "witnessed",
]
