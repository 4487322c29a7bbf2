"""Patlak plot: net influx of a tracer that stays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, FitResult, Given, GraphicalSettings, fit_patlak
from petkin.methods.method import Method


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    settings = GraphicalSettings(choices.t_star or 30.0, choices.fixed.get("vB", 0.0), keep_predicted=not voxels)
    return fit_patlak(curves, given.input("Patlak"), given.observation, given.weights, settings)


PATLAK = Method(
    label="Patlak",
    name="Patlak plot",
    fit=_fit,
    symbols=("vB",),
    outcome="Ki",
    equation="C_T(t) = Ki int_0^t C_P ds + V0 C_P(t), t > t*",
    how="Weighted linear regression over the frames whose middle comes at or after t*; standard errors are the line's.",
    reference="Patlak CS et al. J Cereb Blood Flow Metab 1983;3:1-7, doi:10.1038/jcbfm.1983.1",
)
