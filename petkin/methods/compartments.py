"""A compartment model as a method: weighted non-linear least squares of frame values."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting import (
    REGIONS,
    VOXELS,
    Choices,
    FitResult,
    Given,
    NonlinearSettings,
    certified,
    fit_curves,
    fit_shared,
    looked_into,
    tabulate,
)
from petkin.kinetics import CompartmentModel, with_ratio
from petkin.methods.method import Method

_HOW = (
    "Weighted least squares of frame values. Every curve is searched over all pairs of rates within their interval and "
    "polished by variable projection (Golub GH, Pereyra V. SIAM J Numer Anal 1973;10:413-432, doi:10.1137/0710036). "
    "Standard errors: Gauss-Newton covariance scaled by WRSS / (n - p), delta method for macro-parameters; a parameter "
    "on a bound counts as known."
)


def compartments(model: CompartmentModel) -> Method:
    """The method that fits this model."""

    shareable = (*model.parameters.symbols, *(m.symbol for m in model.macros if m.symbol == "VND"))

    def fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
        arterial, seen, weights = given.input(model.label), given.observation, given.weights
        shared = [symbol for symbol in choices.share if symbol in shareable]
        if not shared:
            chosen = nonlinear_settings(model, choices, voxels)
            result = fit_curves(curves, arterial, seen, weights, chosen)
            if not (choices.certify if voxels else choices.scrutiny):
                return result
            table = tabulate(arterial, seen, chosen)
            return certified(result, curves, table, chosen) if voxels else looked_into(result, curves, table, chosen)
        if voxels:
            raise InputError(f"{shared[0]} is shared by the regions of a scan; fit voxels without --share.")
        symbol = shared[0]
        form = model if symbol in model.parameters.symbols else with_ratio(model)
        return fit_shared(symbol, curves, arterial, seen, weights, nonlinear_settings(form, choices, voxels))

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
        shareable=shareable,
        nonlinear=partial(nonlinear_settings, model),
    )


def nonlinear_settings(model: CompartmentModel, choices: Choices, voxels: bool) -> NonlinearSettings:
    """What the user chose, for one model.

    Raises:
        InputError: K1 is bounded or held where VND takes its place.
    """
    mine = model.parameters.symbols
    for symbol in (*choices.bounds, *choices.fixed):
        if symbol in (m.symbol for m in model.macros):
            raise InputError(f"{symbol} follows from others of {model.label} here and can be neither bounded nor held.")
    box = model.parameters.with_bounds({s: b for s, b in choices.bounds.items() if s in mine})
    box = box.with_fixed({s: v for s, v in choices.fixed.items() if s in mine})
    return NonlinearSettings(
        model,
        parameters=box,
        rate_bounds=choices.rate_bounds,
        effort=VOXELS if voxels else REGIONS,
        keep_predicted=not voxels,
        device=choices.device if voxels else None,
    )
