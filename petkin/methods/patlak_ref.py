"""Patlak plot against a reference region: influx of a tracer that stays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, FitResult, Given, Need
from petkin.fitting.regression import Quantity, Regression
from petkin.methods.late import Axes
from petkin.methods.method import Method
from petkin.methods.reference_line import Line, Terms, fit_line

_QUANTITIES = (
    Quantity("Ki", "min^-1", "net influx rate relative to the reference region, K1 k3 / (k2 + k3) over its K1' / k2'"),
    Quantity("V0", "1", "initial volume relative to the reference region"),
)


def _axes(terms: Terms) -> Axes:
    positive = np.where(terms.reference > 0.0, terms.reference, np.nan)
    x = terms.area / positive
    return Axes("int C_R / C_R (min)", "C_T / C_R", lambda _, tissue, drawn: (x + 0.0 * tissue, drawn / positive))


_LINE = Line(
    label="PatlakRef",
    regression=lambda _: Regression("PatlakRef", _QUANTITIES),
    shared=lambda terms: (terms.area, terms.reference),
    own=lambda terms: (),
    response=lambda terms: terms.curve,
    axes=_axes,
)


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    return fit_line(_LINE, curves, given, choices, voxels)


PATLAK_REF = Method(
    label="PatlakRef",
    name="Patlak plot against a reference region",
    fit=_fit,
    symbols=(),
    outcome="Ki",
    equation="C_T = Ki int_0^t C_R ds + V0 C_R, t > t*",
    how="Weighted linear regression over the frames whose middle comes at or after t*, in the form that is not "
    "divided by C_R; standard errors are those of the regression, the reference curve counting as known.",
    reference="Patlak CS, Blasberg RG. J Cereb Blood Flow Metab 1985;5:584-590, doi:10.1038/jcbfm.1985.87",
    needs=frozenset({Need.REFERENCE}),
)
