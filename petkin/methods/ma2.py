"""Multilinear analysis 2: distribution volumes of two tissue compartments by linear regression."""

from __future__ import annotations

import numpy as np

from petkin.fitting import Choices, FitResult, Given
from petkin.fitting.curves import check_shapes
from petkin.fitting.integrals import curve_integrals, input_integrals
from petkin.fitting.linear import LinearDesign
from petkin.fitting.regression import Quantity, Regression, fit_linear, weights_and_noise
from petkin.methods.late import Array, without_blood
from petkin.methods.method import Method
from petkin.methods.two_tissue import two_tissue_values

_QUANTITIES = (
    Quantity("VT", "mL cm^-3", "total distribution volume"),
    Quantity("VS", "mL cm^-3", "distribution volume of specific binding"),
    Quantity("VND", "mL cm^-3", "distribution volume of nondisplaceable tracer"),
    Quantity("K1", "mL cm^-3 min^-1", "rate of delivery"),
)


def _read(theta: Array) -> tuple[Array, Array]:
    """Unknowns are a, b, -d, -c of `two_tissue`."""
    found = two_tissue_values(theta[0], theta[1], -theta[3], -theta[2])
    values, slopes = zip(*(found[quantity.symbol] for quantity in _QUANTITIES))
    by_abcd = np.array(slopes)
    return np.array(values), np.stack([by_abcd[:, 0], by_abcd[:, 1], -by_abcd[:, 3], -by_abcd[:, 2]], axis=1)


def _fit(curves, given: Given, choices: Choices, voxels: bool) -> FitResult:
    vB = choices.fixed.get("vB", 0.0)
    check_shapes(np.asarray(curves), np.asarray(given.weights), len(given.observation.frames))
    once, twice = curve_integrals(given.observation)
    area, double = input_integrals(given.input("MA2").plasma, given.observation)
    blood = without_blood(given, vB, "MA2")
    weights = weights_and_noise(given.weights, "MA2")
    design = LinearDesign(np.stack([double, area]), np.stack([once, twice]), np.eye(len(once)), *weights, *blood)
    regression = Regression("MA2", _QUANTITIES, _read)
    return fit_linear(curves, design, regression, settings={"vB": vB}, keep_predicted=not voxels)


MA2 = Method(
    label="MA2",
    name="multilinear analysis 2",
    fit=_fit,
    symbols=("vB",),
    outcome="VT",
    equation="C_T = g1 int int C_P + g2 int int C_T + g3 int C_T + g4 int C_P; VT = -g1 / g2",
    how="Weighted multilinear regression of all frame values; exact for two tissue compartments without blood. "
    "Integrals are averaged over frames, the tissue's by a spline through the areas at frame ends. Standard errors: "
    "delta method, the noise that the integrals carry counted. That noise biases K1 low and VT and VND high, by more "
    "than the error from about 5 % of noise a frame on. Blood that is left in the curve biases all: fix vB.",
    reference="Ichise M et al. J Cereb Blood Flow Metab 2002;22:1271-1281, doi:10.1097/01.WCB.0000038000.34930.4E",
)
