"""Multilinear reference tissue model: three unknowns a curve."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, FitResult, Given, Need
from petkin.fitting.regression import Quantity, Regression
from petkin.methods.late import Axes
from petkin.methods.method import Method
from petkin.methods.reference_line import Line, Terms, fit_line

_QUANTITIES = (
    Quantity("BPND", "1", "binding potential relative to non-displaceable tracer"),
    Quantity("R1", "1", "delivery relative to the reference region, K1 / K1'"),
    Quantity("k2", "min^-1", "rate of return from tissue to plasma"),
    Quantity("k2a", "min^-1", "apparent rate of return, k2 / (1 + BPND)"),
    Quantity("k2prime", "min^-1", "rate of return of the reference region, k2 / R1"),
)


def _read(theta):
    k2, R1, minus_k2a = theta
    zero, one = np.zeros_like(k2), np.ones_like(k2)
    values = np.stack([-k2 / minus_k2a - 1.0, R1, k2, -minus_k2a, k2 / R1])
    slopes = (
        (-1.0 / minus_k2a, zero, k2 / minus_k2a**2),
        (zero, one, zero),
        (one, zero, zero),
        (zero, zero, -one),
        (1.0 / R1, -k2 / R1**2, zero),
    )
    return values, np.stack([np.stack(row) for row in slopes])


def _axes(terms: Terms) -> Axes:
    return Axes("int C_R (kBq min/mL)", "C_T (kBq/mL)", lambda _, tissue, drawn: (terms.area + 0.0 * tissue, drawn))


_LINE = Line(
    label="MRTM1",
    regression=lambda _: Regression("MRTM1", _QUANTITIES, _read),
    shared=lambda terms: (terms.area, terms.reference),
    own=lambda terms: (terms.integral,),
    response=lambda terms: terms.curve,
    axes=_axes,
    holds_early=True,
)


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    return fit_line(_LINE, curves, given, choices, voxels)


MRTM1 = Method(
    label="MRTM1",
    name="multilinear reference tissue model",
    fit=_fit,
    symbols=(),
    outcome="BPND",
    equation="C_T = k2 int_0^t C_R ds - k2a int_0^t C_T ds + R1 C_R, t > t*; BPND = k2 / k2a - 1",
    how="Weighted multilinear regression of frame values over the frames whose middle comes at or after t*; an "
    "automatic t* is 0, since the equation holds from the start for one tissue compartment. Integrals are "
    "averaged over frames, by a spline through the areas at frame ends. Standard errors: delta method, the noise "
    "that the curve's integral carries counted; the reference curve counts as known. A region that is a multiple "
    "of the reference region's curve leaves the equation undetermined.",
    reference="Ichise M et al. J Cereb Blood Flow Metab 2003;23:1096-1112, doi:10.1097/01.WCB.0000085441.37552.CA",
    needs=frozenset({Need.REFERENCE}),
)
