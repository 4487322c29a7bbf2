"""Logan plot: total distribution volume of a tracer that comes and goes."""

from __future__ import annotations

import numpy as np

from petkin.fitting import Choices, FitResult, Given
from petkin.fitting.integrals import curve_integrals, input_columns
from petkin.fitting.linear import LinearDesign
from petkin.fitting.regression import Quantity, Regression, weights_and_noise
from petkin.methods.late import Array, Axes, LateEquation, fit_late, without_blood
from petkin.methods.method import Method

_QUANTITIES = (
    Quantity("VT", "mL cm^-3", "total distribution volume"),
    Quantity("intercept", "min", "where the line meets the axis"),
)


def _design(given: Given, vB: float) -> LinearDesign:
    """int C_T = VT int C_P + b C_T: the plot's axes multiplied by C_T, so that a frame at or below zero is no pole.

    Weights are those of C_T: in the plot a ratio would have the weight w C_T^2, which is the same sum of squares.
    """
    plasma, observation = given.input("Logan").plasma, given.observation
    _, area = input_columns(plasma, observation)
    once, _ = curve_integrals(observation)
    weights = weights_and_noise(given.weights, "Logan")
    return LinearDesign(area[None], np.eye(len(once))[None], once, *weights, *without_blood(given, vB, "Logan"))


def _axes(design: LinearDesign, tissue: Array, values: Array) -> tuple[Array, Array]:
    positive = np.where(values > 0.0, values, np.nan)
    return design.shared[0] / positive, tissue @ design.response.T / positive


_EQUATION = LateEquation(
    Regression("Logan", _QUANTITIES), _design, Axes("int C_P / C_T (min)", "int C_T / C_T (min)", _axes)
)


def _fit(curves, given: Given, choices: Choices, voxels: bool) -> FitResult:
    return fit_late(_EQUATION, curves, given, choices, voxels)


LOGAN = Method(
    label="Logan",
    name="Logan plot",
    fit=_fit,
    symbols=("vB",),
    outcome="VT",
    equation="int_0^t C_T ds / C_T(t) = VT int_0^t C_P ds / C_T(t) + b, t > t*",
    how="Weighted linear regression over the frames whose middle comes at or after t*. Integrals are averaged over "
    "frames, the tissue's by a spline through the areas at frame ends. Standard errors count the noise of both axes, "
    "whose frames share it. Without noise VT is low as long as the plot still bends at t*; noise lowers it further "
    "(Slifstein M, Laruelle M. J Nucl Med 2000;41:2083-2088), and no error tells of either.",
    reference="Logan J et al. J Cereb Blood Flow Metab 1990;10:740-747, doi:10.1038/jcbfm.1990.127",
)
