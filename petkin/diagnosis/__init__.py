"""Diagnosis: where a simulator departs from data, which effect it misses, and how far that closes the gap."""

from petkin.diagnosis.cohort import Cohort, Member, SharedCause, in_common
from petkin.diagnosis.design import Visible, indistinct
from petkin.diagnosis.diagnose import diagnose, foresee_design
from petkin.diagnosis.effect import Coordinates, Hypothesis, Shape, Simulator, Term
from petkin.diagnosis.refit import State
from petkin.diagnosis.verdict import Cause, Diagnosis

__all__ = [
    "Cause",
    "Cohort",
    "Coordinates",
    "Diagnosis",
    "Hypothesis",
    "Member",
    "Shape",
    "SharedCause",
    "Simulator",
    "State",
    "Term",
    "Visible",
    "diagnose",
    "foresee_design",
    "in_common",
    "indistinct",
]
