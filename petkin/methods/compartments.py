"""A compartment model as a method: weighted non-linear least squares of frame values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import REGIONS, VOXELS, Choices, FitResult, Given, NonlinearSettings, fit_curves
from petkin.kinetics import CompartmentModel
from petkin.methods.method import Method

_HOW = (
    "Weighted least squares of frame values. Every curve is searched over all pairs of rates within their interval and "
    "polished by variable projection (Golub GH, Pereyra V. SIAM J Numer Anal 1973;10:413-432, doi:10.1137/0710036). "
    "Standard errors: Gauss-Newton covariance scaled by WRSS / (n - p), delta method for macro-parameters; a parameter "
    "on a bound counts as known."
)


def compartments(model: CompartmentModel) -> Method:
    """The method that fits this model."""

    def fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
        mine = model.parameters.symbols
        box = model.parameters.with_bounds({s: b for s, b in choices.bounds.items() if s in mine})
        box = box.with_fixed({s: v for s, v in choices.fixed.items() if s in mine})
        settings = NonlinearSettings(
            model,
            parameters=box,
            rate_bounds=choices.rate_bounds,
            effort=VOXELS if voxels else REGIONS,
            keep_predicted=not voxels,
        )
        return fit_curves(curves, given.input(model.label), given.observation, given.weights, settings)

    return Method(
        label=model.label,
        name=model.name,
        fit=fit,
        symbols=model.parameters.symbols,
        outcome=model.macros[0].symbol,
        equation=model.equation,
        how=_HOW,
        reference=model.reference,
        comparable=True,
    )
