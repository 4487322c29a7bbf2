"""Multilinear reference tissue model with one k2': two unknowns a curve."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, FitResult, Given, Need
from petkin.fitting.reference_tissue import share_k2prime
from petkin.fitting.regression import Quantity, Regression
from petkin.methods.late import Axes
from petkin.methods.method import Method
from petkin.methods.reference_line import Line, Terms, fit_line

_QUANTITIES = (
    Quantity("BPND", "1", "binding potential relative to non-displaceable tracer"),
    Quantity("R1", "1", "delivery relative to the reference region, k2 / k2'"),
    Quantity("k2", "min^-1", "rate of return from tissue to plasma"),
    Quantity("k2a", "min^-1", "apparent rate of return, k2 / (1 + BPND)"),
)


def _regression(k2prime: float) -> Regression:
    def read(theta):
        k2, minus_k2a = theta
        zero, one = np.zeros_like(k2), np.ones_like(k2)
        values = np.stack([-k2 / minus_k2a - 1.0, k2 / k2prime, k2, -minus_k2a])
        slopes = (
            (-1.0 / minus_k2a, k2 / minus_k2a**2),
            (one / k2prime, zero),
            (one, zero),
            (zero, -one),
        )
        return values, np.stack([np.stack(row) for row in slopes])

    return Regression("MRTM2", _QUANTITIES, read)


def _axes(terms: Terms) -> Axes:
    return Axes(
        "int C_R + C_R / k2' (kBq min/mL)",
        "C_T (kBq/mL)",
        lambda _, tissue, drawn: (terms.delayed_area + 0.0 * tissue, drawn),
    )


_LINE = Line(
    label="MRTM2",
    regression=_regression,
    shared=lambda terms: (terms.delayed_area,),
    own=lambda terms: (terms.integral,),
    response=lambda terms: terms.curve,
    axes=_axes,
    holds_early=True,
    one_k2prime=True,
)


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    return fit_line(_LINE, curves, given, choices, voxels)


MRTM2 = Method(
    label="MRTM2",
    name="multilinear reference tissue model with one k2'",
    fit=_fit,
    symbols=("k2prime",),
    outcome="BPND",
    equation="C_T = k2 (int_0^t C_R ds + C_R / k2') - k2a int_0^t C_T ds, t > t*; BPND = k2 / k2a - 1",
    how="As MRTM1, with the rate of return of the reference region k2' held for all curves: as given by --fix "
    "k2prime, else as SRTM2 finds it, where the sum of all curves' weighted squared residuals is least. Errors of"
    " a curve take k2' as known.",
    reference="Ichise M et al. J Cereb Blood Flow Metab 2003;23:1096-1112, doi:10.1097/01.WCB.0000085441.37552.CA",
    needs=frozenset({Need.REFERENCE}),
    share=share_k2prime,
)
