"""Fitting: weights, the basis table, compartment models by voxel and region, linear regressions, delay, results."""

from petkin.fitting.bootstrap import Resampling
from petkin.fitting.choice import agreement, compare_models
from petkin.fitting.choices import Choices
from petkin.fitting.delay import Delay, estimate_delay
from petkin.fitting.device_tables import find_device
from petkin.fitting.given import Given, Need, ReferenceCurve
from petkin.fitting.nonlinear import NonlinearSettings, fit_curves, tabulate
from petkin.fitting.results import Column, Estimate, FitResult, Plot, Status, undetermined
from petkin.fitting.scrutiny import certified, looked_into
from petkin.fitting.search import REGIONS, VOXELS, Effort
from petkin.fitting.shared import fit_shared
from petkin.fitting.weights import counting_weights

__all__ = [
    "REGIONS",
    "VOXELS",
    "Choices",
    "Column",
    "Delay",
    "Effort",
    "Estimate",
    "FitResult",
    "Given",
    "Need",
    "NonlinearSettings",
    "Plot",
    "ReferenceCurve",
    "Resampling",
    "Status",
    "agreement",
    "certified",
    "compare_models",
    "counting_weights",
    "estimate_delay",
    "find_device",
    "fit_curves",
    "fit_shared",
    "looked_into",
    "tabulate",
    "undetermined",
]
