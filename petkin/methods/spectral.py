"""Spectral analysis: VT, K1 and Ki without a number of compartments."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import VOXELS, Choices, FitResult, Given
from petkin.fitting.spectrum import SpectrumSettings, fit_spectrum
from petkin.methods.method import Method

#: Refits a voxel for its standard errors.
_VOXEL_DRAWS = 16


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    settings = SpectrumSettings(choices.rate_bounds)
    if voxels:
        settings = SpectrumSettings(choices.rate_bounds, draws=_VOXEL_DRAWS, size=VOXELS.size, keep_predicted=False)
    return fit_spectrum(curves, given.input("SpectralAnalysis"), given.observation, given.weights, settings)


SPECTRAL = Method(
    label="SpectralAnalysis",
    name="spectral analysis",
    fit=_fit,
    symbols=(),
    outcome="VT",
    equation="C = (1 - vB) sum_j alpha_j e^(-a_j t) * C_P + vB C_B, alpha_j >= 0;  VT = sum_j alpha_j / a_j",
    how="Non-negative least squares of frame values over blood and exponentials of 100 rates, even in log(a + 0.001). "
    "Standard errors: 90 percent of refits to new noise, about a spectrum without what lies within the noise, fall "
    "inside a 90 percent interval; 200 refits for regions, 16 for voxels (whose errors are thus themselves known "
    "to a third). The estimates are no normal distribution: most lie much closer. "
    "A spectrum that reaches the slowest rate has status AT_BOUND: its VT is set by the end of the grid.",
    reference="Cunningham VJ, Jones T. J Cereb Blood Flow Metab 1993;13:15-23, doi:10.1038/jcbfm.1993.5",
)
