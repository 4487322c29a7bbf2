"""Reporting: what a fit found, on one page that opens anywhere."""

from petkin.reporting.cohort_report import CohortReport, render_cohort_report
from petkin.reporting.contents import (
    FitReport,
    MapSet,
    ModelSection,
    ParameterMap,
    RegionCurves,
    TruthRow,
)
from petkin.reporting.gap_report import GapReport, render_gap_report
from petkin.reporting.html import render_fit_report, write_fit_report
from petkin.reporting.input_curves import BloodSamples, InputCurves, curve_times
from petkin.reporting.state_figures import LackingTerm

__all__ = [
    "BloodSamples",
    "CohortReport",
    "FitReport",
    "GapReport",
    "InputCurves",
    "LackingTerm",
    "MapSet",
    "ModelSection",
    "ParameterMap",
    "RegionCurves",
    "TruthRow",
    "curve_times",
    "render_cohort_report",
    "render_fit_report",
    "render_gap_report",
    "write_fit_report",
]
