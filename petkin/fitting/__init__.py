"""Fitting: weights, the basis table, compartment models by voxel and region, graphical methods, delay, results."""

from petkin.fitting.delay import Delay, estimate_delay
from petkin.fitting.graphical import GraphicalSettings, fit_logan, fit_patlak
from petkin.fitting.methods import METHODS, Choices, Method, check_choices, find_method, with_delay
from petkin.fitting.nonlinear import NonlinearSettings, fit_curves
from petkin.fitting.results import Estimate, FitResult, Status, undetermined
from petkin.fitting.search import REGIONS, VOXELS, Effort
from petkin.fitting.weights import counting_weights

__all__ = [
    "METHODS",
    "REGIONS",
    "VOXELS",
    "Choices",
    "Delay",
    "Effort",
    "Estimate",
    "FitResult",
    "GraphicalSettings",
    "Method",
    "NonlinearSettings",
    "Status",
    "check_choices",
    "counting_weights",
    "estimate_delay",
    "find_method",
    "fit_curves",
    "fit_logan",
    "fit_patlak",
    "undetermined",
    "with_delay",
]
