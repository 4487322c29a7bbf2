"""Inputs: the arterial input function, as a formula, from a table, or from blood samples."""

from petkin.inputs.analytic import (
    PLASMA_PRESETS,
    analytic_input,
    exponentials,
    feng,
    feng_plasma,
    linear_rise,
    paper_plasma,
)
from petkin.inputs.dispersion import dispersed, undispersed
from petkin.inputs.input_function import InputFunction
from petkin.inputs.linearise import piecewise_linear
from petkin.inputs.parent_fraction import PARENT_FRACTION_MODELS, ParentFractionFit, fit_parent_fraction
from petkin.inputs.plasma_ratio import PLASMA_RATIO_MODELS
from petkin.inputs.reference import Smoothest, smoothest
from petkin.inputs.sampled import from_blood
from petkin.inputs.table import from_table, input_table

__all__ = [
    "PARENT_FRACTION_MODELS",
    "PLASMA_PRESETS",
    "PLASMA_RATIO_MODELS",
    "InputFunction",
    "ParentFractionFit",
    "Smoothest",
    "analytic_input",
    "dispersed",
    "exponentials",
    "feng",
    "feng_plasma",
    "fit_parent_fraction",
    "from_blood",
    "from_table",
    "input_table",
    "linear_rise",
    "paper_plasma",
    "piecewise_linear",
    "smoothest",
    "undispersed",
]
