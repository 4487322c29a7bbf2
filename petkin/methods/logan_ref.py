"""Logan plot against a reference region: distribution volume ratio of a tracer that comes and goes."""

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
    Quantity("BPND", "1", "binding potential relative to non-displaceable tracer, DVR - 1"),
    Quantity("DVR", "1", "distribution volume over that of the reference region"),
    Quantity("intercept", "min", "where the line meets the axis"),
)


def _read(theta):
    DVR, intercept = theta
    slopes = np.zeros((3, 2, theta.shape[1]))
    slopes[0, 0] = slopes[1, 0] = slopes[2, 1] = 1.0
    return np.stack([DVR - 1.0, DVR, intercept]), slopes


def _axes(terms: Terms) -> Axes:
    def of(design, tissue, drawn):
        positive = np.where(drawn > 0.0, drawn, np.nan)
        return terms.delayed_area / positive, tissue @ terms.integral.T / positive

    return Axes("(int C_R + C_R / k2') / C_T (min)", "int C_T / C_T (min)", of)


_LINE = Line(
    label="LoganRef",
    regression=lambda _: Regression("LoganRef", _QUANTITIES, _read),
    shared=lambda terms: (terms.delayed_area,),
    own=lambda terms: (terms.curve,),
    response=lambda terms: terms.integral,
    axes=_axes,
    one_k2prime=True,
)


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    return fit_line(_LINE, curves, given, choices, voxels)


LOGAN_REF = Method(
    label="LoganRef",
    name="Logan plot against a reference region",
    fit=_fit,
    symbols=("k2prime",),
    outcome="BPND",
    equation="int_0^t C_T ds / C_T = DVR (int_0^t C_R ds + C_R / k2') / C_T + b, t > t*; BPND = DVR - 1",
    how="Weighted linear regression over the frames whose middle comes at or after t*, in the form int C_T = DVR (int"
    " C_R + C_R / k2') + b C_T, which is not divided by C_T. k2' is held for all curves: as given by --fix "
    "k2prime, else as SRTM2 finds it. Integrals are averaged over frames, by a spline through the areas at frame "
    "ends. Standard errors count the noise of both axes, take k2' and the reference curve as known, and do not "
    "tell that noise lowers DVR.",
    reference="Logan J et al. J Cereb Blood Flow Metab 1996;16:834-840, doi:10.1097/00004647-199609000-00008",
    needs=frozenset({Need.REFERENCE}),
    share=share_k2prime,
)
