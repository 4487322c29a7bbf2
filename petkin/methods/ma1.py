"""Multilinear analysis 1: total distribution volume with the noise where a regression expects it."""

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
    Quantity("intercept", "min", "where the line of the Logan plot meets the axis"),
)


def _design(given: Given, vB: float) -> LinearDesign:
    plasma, observation = given.input("MA1").plasma, given.observation
    _, area = input_columns(plasma, observation)
    once, _ = curve_integrals(observation)
    weights = weights_and_noise(given.weights, "MA1")
    return LinearDesign(area[None], once[None], np.eye(len(once)), *weights, *without_blood(given, vB, "MA1"))


def _read(theta: Array) -> tuple[Array, Array]:
    """VT = -theta1 / theta2, b = 1 / theta2, and their derivatives."""
    first, second = theta
    none = np.zeros_like(first)
    values = np.stack([-first / second, 1.0 / second])
    return values, np.array([[-1.0 / second, first / second**2], [none, -1.0 / second**2]])


def _axes(design: LinearDesign, tissue: Array, values: Array) -> tuple[Array, Array]:
    return np.broadcast_to(design.shared[0], tissue.shape), values


_EQUATION = LateEquation(
    Regression("MA1", _QUANTITIES, _read), _design, Axes("int C_P (kBq min/mL)", "C_T (kBq/mL)", _axes)
)


def _fit(curves, given: Given, choices: Choices, voxels: bool) -> FitResult:
    return fit_late(_EQUATION, curves, given, choices, voxels)


MA1 = Method(
    label="MA1",
    name="multilinear analysis 1",
    fit=_fit,
    symbols=("vB",),
    outcome="VT",
    equation="C_T(t) = -(VT / b) int_0^t C_P ds + (1 / b) int_0^t C_T ds, t > t*",
    how="Weighted multilinear regression of frame values over the frames whose middle comes at or after t*. Integrals "
    "are averaged over frames, the tissue's by a spline through the areas at frame ends. Standard errors: delta "
    "method, the noise that the integral carries counted. Without noise VT is low as long as the Logan plot still "
    "bends at t*; noise adds little to that.",
    reference="Ichise M et al. J Cereb Blood Flow Metab 2002;22:1271-1281, doi:10.1097/01.WCB.0000038000.34930.4E",
)
