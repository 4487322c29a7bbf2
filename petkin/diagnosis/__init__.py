"""Diagnosis: where a simulator departs from data, which effect it misses, and how far that closes the gap."""

from petkin.diagnosis.cohort import Cohort, Member, SharedCause, in_common
from petkin.diagnosis.contrasts import Contrasted, Pattern, judge_contrasts
from petkin.diagnosis.design import Visible, indistinct
<<<<<<< HEAD
from petkin.diagnosis.diagnose import diagnose, foresee_design
from petkin.diagnosis.effect import Coordinates, Hypothesis, Shape, Simulator, Term
from petkin.diagnosis.refit import State
from petkin.diagnosis.verdict import Cause, Diagnosis
=======
from petkin.diagnosis.diagnose import CLAIM, Cause, Diagnosis, Estimate, diagnose, foresee_design
from petkin.diagnosis.effect import Coordinates, Hypothesis, Shape, Simulator, Term
from petkin.diagnosis.noise import Noise, second_differences
from petkin.diagnosis.refit import Fit, State, linearised
from petkin.diagnosis.sets import smallest_set
>>>>>>> 2c15950 (wip2)

__all__ = [
    "CLAIM",
    "Cause",
    "Cohort",
    "Contrasted",
    "Coordinates",
    "Diagnosis",
    "Estimate",
    "Fit",
    "Hypothesis",
    "Member",
    "Noise",
    "Pattern",
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
    "judge_contrasts",
    "linearised",
    "second_differences",
    "smallest_set",
]
