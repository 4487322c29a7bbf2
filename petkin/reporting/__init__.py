"""Reporting: what a fit found, on one page that opens anywhere."""

from petkin.reporting.contents import (
    BloodSamples,
    FitReport,
    InputCurves,
    MapSet,
    ModelSection,
    ParameterMap,
    RegionCurves,
    TruthRow,
    curve_times,
)
from petkin.reporting.html import render_fit_report, write_fit_report

__all__ = [
    "BloodSamples",
    "FitReport",
    "InputCurves",
    "MapSet",
    "ModelSection",
    "ParameterMap",
    "RegionCurves",
    "TruthRow",
    "curve_times",
    "render_fit_report",
    "write_fit_report",
]
