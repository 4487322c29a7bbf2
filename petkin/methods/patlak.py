"""Patlak plot: net influx of a tracer that stays."""

from __future__ import annotations

import numpy as np

from petkin.fitting import Choices, FitResult, Given
from petkin.fitting.integrals import input_columns
from petkin.fitting.linear import LinearDesign
from petkin.fitting.regression import Quantity, Regression, weights_and_noise
from petkin.methods.late import Array, Axes, LateEquation, fit_late, without_blood
from petkin.methods.method import Method

_QUANTITIES = (
    Quantity("Ki", "mL cm^-3 min^-1", "net influx rate"),
    Quantity("V0", "mL cm^-3", "initial volume: tracer in blood and in fast exchange with it"),
)


def _design(given: Given, vB: float) -> LinearDesign:
    """C = Ki int C_P + V0 C_P: the plot's axes multiplied by C_P, so that no noisy plasma value divides."""
    plasma, observation = given.input("Patlak").plasma, given.observation
    values, area = input_columns(plasma, observation)
    count = len(area)
    weights, blood = weights_and_noise(given.weights, "Patlak"), without_blood(given, vB, "Patlak")
    return LinearDesign(np.stack([area, values]), np.empty((0, count, count)), np.eye(count), *weights, *blood)


def _axes(design: LinearDesign, tissue: Array, values: Array) -> tuple[Array, Array]:
    area, plasma = design.shared
    return np.broadcast_to(area / plasma, tissue.shape), values / plasma


_EQUATION = LateEquation(
    Regression("Patlak", _QUANTITIES), _design, Axes("int C_P / C_P (min)", "C_T / C_P (mL/cm3)", _axes)
)


def _fit(curves, given: Given, choices: Choices, voxels: bool) -> FitResult:
    return fit_late(_EQUATION, curves, given, choices, voxels)


PATLAK = Method(
    label="Patlak",
    name="Patlak plot",
    fit=_fit,
    symbols=("vB",),
    outcome="Ki",
    equation="C_T(t) = Ki int_0^t C_P ds + V0 C_P(t), t > t*",
    how="Weighted linear regression of frame values over the frames whose middle comes at or after t*; the input's "
    "integral is averaged over frames exactly. Standard errors are the regression's and hold where the equation does. "
    "Known bias: blood that is left in the curve lowers Ki by the share vB (take it off with a fixed vB), tracer that "
    "leaves lowers it further.",
    reference="Patlak CS et al. J Cereb Blood Flow Metab 1983;3:1-7, doi:10.1038/jcbfm.1983.1",
)
