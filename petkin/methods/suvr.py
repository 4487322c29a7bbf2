"""Uptake ratio: late activity over that of a reference region."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, FitResult, Given, Need
from petkin.fitting.uptake import fit_uptake
from petkin.methods.method import Method


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    reference = given.reference_curve("SUVR")
    meaning = "mean activity in the window over that of the reference region"
    result = fit_uptake("SUVR", curves, reference.values, given, choices, ("1", meaning), keep_predicted=not voxels)
    return replace(result, settings={**result.settings, "reference": reference.name})


SUVR = Method(
    label="SUVR",
    name="uptake ratio to a reference region",
    fit=_fit,
    symbols=(),
    outcome="SUVR",
    equation="SUVR = mean of C_T over the window / mean of C_R over the window",
    how="Ratio of mean decay-corrected activities over the frames whose middle lies in the window, weighted by their "
    "durations. Its standard error is the scatter of these frames about a constant ratio, drift included; the "
    "reference curve counts as known.",
    reference="Lopresti BJ et al. J Nucl Med 2005;46:1959-1972; Carson RE et al. J Cereb Blood Flow Metab "
    "1993;13:24-42, doi:10.1038/jcbfm.1993.6",
    needs=frozenset({Need.REFERENCE}),
)
