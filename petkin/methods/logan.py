"""Logan plot: total distribution volume of a tracer that comes and goes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, FitResult, Given, GraphicalSettings, fit_logan
from petkin.methods.method import Method


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    settings = GraphicalSettings(choices.t_star or 30.0, choices.fixed.get("vB", 0.0), keep_predicted=not voxels)
    return fit_logan(curves, given.input("Logan"), given.observation, given.weights, settings)


LOGAN = Method(
    label="Logan",
    name="Logan plot",
    fit=_fit,
    symbols=("vB",),
    outcome="VT",
    equation="int_0^t C_T ds / C_T(t) = VT int_0^t C_P ds / C_T(t) + b, t > t*",
    how="Weighted linear regression over the frames whose middle comes at or after t*; standard errors are the line's.",
    reference="Logan J et al. J Cereb Blood Flow Metab 1990;10:740-747, doi:10.1038/jcbfm.1990.127",
)
