"""Linear least squares of the two-tissue model: its rate constants and the blood volume without a search."""

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

_TISSUE = (
    Quantity("K1", "mL cm^-3 min^-1", "rate of delivery"),
    Quantity("k2", "min^-1", "rate of return to plasma"),
    Quantity("k3", "min^-1", "rate of binding"),
    Quantity("k4", "min^-1", "rate of release"),
    Quantity("VT", "mL cm^-3", "total distribution volume"),
)
_BLOOD = Quantity("vB", "1", "blood volume fraction")
_VT = len(_TISSUE) - 1


def _read_tissue(theta: Array) -> tuple[Array, Array]:
    """Unknowns are a, b, -d, -c of `two_tissue`."""
    found = two_tissue_values(theta[0], theta[1], -theta[3], -theta[2])
    values, slopes = zip(*(found[quantity.symbol] for quantity in _TISSUE))
    by_abcd = np.array(slopes)
    return np.array(values), np.stack([by_abcd[:, 0], by_abcd[:, 1], -by_abcd[:, 3], -by_abcd[:, 2]], axis=1)


def _read(theta: Array) -> tuple[Array, Array]:
    """Unknowns are (1 - vB) a + vB c, (1 - vB) b + vB d, vB, -d, -c."""
    first, second, vB, minus_d, minus_c = theta
    share = 1.0 / (1.0 - vB)
    a, b = (first + vB * minus_c) * share, (second + vB * minus_d) * share
    values, slopes = _read_tissue(np.stack([a, b, minus_d, minus_c]))
    by_a, by_b, by_d, by_c = slopes.transpose(1, 0, 2)
    by_theta = [
        by_a * share,
        by_b * share,
        by_a * (minus_c + a) * share + by_b * (minus_d + b) * share,
        by_d + by_b * vB * share,
        by_c + by_a * vB * share,
    ]
    of_blood = np.zeros((1, 5, len(vB)))
    of_blood[0, 2] = 1.0
    return np.concatenate([values, vB[None]]), np.concatenate([np.stack(by_theta, axis=1), of_blood])


def _fit(curves, given: Given, choices: Choices, voxels: bool) -> FitResult:
    observation, plasma = given.observation, given.input("LS2TCM").plasma
    known = choices.fixed.get("vB")
    check_shapes(np.asarray(curves), np.asarray(given.weights), len(given.observation.frames))
    once, twice = curve_integrals(observation)
    area, double = input_integrals(plasma, observation)
    shared, quantities, read = [double, area], _TISSUE, _read_tissue
    if known is None:
        shared, quantities, read = [*shared, np.asarray(observation.of_forcing(plasma))], (*_TISSUE, _BLOOD), _read
    blood = without_blood(given, known or 0.0, "LS2TCM")
    weights = weights_and_noise(given.weights, "LS2TCM")
    design = LinearDesign(np.stack(shared), np.stack([once, twice]), np.eye(len(once)), *weights, *blood)
    settings = {"vB": "fitted" if known is None else known}
    return fit_linear(
        curves, design, Regression("LS2TCM", quantities, read, _VT), settings=settings, keep_predicted=not voxels
    )


LS2TCM = Method(
    label="LS2TCM",
    name="two tissue compartments, linear least squares",
    fit=_fit,
    symbols=("vB",),
    outcome="VT",
    equation="C = p1 int int C_P + p2 int C_P + p3 C_P - p4 int int C - p5 int C; vB = p3, K1 = (p2 - p3 p5) / (1 - vB)"
    ", VT = (p1 / p4 - p3) / (1 - vB), k2 = p5 - (p1 - p3 p4) / (p2 - p3 p5), k4 = p4 / k2, k3 = p5 - k2 - k4",
    how="Weighted multilinear regression of all frame values; exact for two tissue compartments. Blood in the voxel is "
    "taken to follow the plasma; with a fixed vB whole blood is taken off beforehand instead. Integrals are averaged "
    "over frames, the tissue's by a spline through the areas at frame ends. Standard errors: delta method, the noise "
    "that the integrals carry counted. That noise biases K1, k2 and k3 low and VT and vB high, by as much as the "
    "error from about 5 % of noise a frame on. Nothing keeps a rate constant positive.",
    reference="Evans AC. J Cereb Blood Flow Metab 1987;7:214-226, doi:10.1038/jcbfm.1987.46; Oikonen V. Multilinear "
    "solution for 4-compartment model: I. Tissue compartments in series. Turku PET Centre Modelling Report TPCMOD0023, "
    "2003",
)
