"""Standardised uptake value: late activity in units of dose per body weight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, FitResult, Given, Need
from petkin.fitting.uptake import fit_uptake
from petkin.methods.method import Method


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    factor = given.suv_factor("SUV")
    unit = np.full(len(given.observation.frames), 1.0 / factor)
    meaning = "standardised uptake value: mean activity in the window over injected dose per gram of body"
    result = fit_uptake("SUV", curves, unit, given, choices, ("g mL^-1", meaning), keep_predicted=not voxels)
    settings = {**result.settings, "weight_over_dose": factor, "weight_over_dose_unit": "g kBq^-1"}
    return replace(result, settings=settings)


SUV = Method(
    label="SUV",
    name="standardised uptake value",
    fit=_fit,
    symbols=(),
    outcome="SUV",
    equation="SUV = mean of C_T over the window / (injected dose / body weight)",
    how="Mean of decay-corrected activity over the frames whose middle lies in the window, weighted by their "
    "durations. Its standard error is the scatter of these frames about a constant, drift included.",
    reference="Keyes JW. J Nucl Med 1995;36:1836-1839; Boellaard R. J Nucl Med 2009;50 Suppl 1:11S-20S, "
    "doi:10.2967/jnumed.108.057182",
    needs=frozenset({Need.DOSE}),
)
