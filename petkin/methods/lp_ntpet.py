"""Linear parametric neurotransmitter PET: a passing change of binding within one scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, FitResult, Given, Need
from petkin.fitting.transient import fit_transient
from petkin.methods.method import Method


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    return fit_transient(curves, given, keep_predicted=not voxels)


LP_NTPET = Method(
    label="lpntPET",
    name="linear parametric neurotransmitter PET (lp-ntPET)",
    fit=_fit,
    symbols=(),
    outcome="gamma",
    equation="C_T = R1 C_R + k2 int C_R - k2a int C_T - gamma int C_T h;  "
    "h = ((t - tD)/(tP - tD))^alpha exp(alpha (1 - (t - tD)/(tP - tD))), t > tD",
    how="Weighted linear regression at every (tD, tP, alpha) of a grid; the best with gamma > 0. The response is "
    "tested against none by F with four unknowns (column p): status 5 where p >= 0.05. Standard errors of gamma, R1, "
    "k2, k2a and BPND take the times for known; those of the times are half the range of all shapes within one error, "
    "half a step of the grid at least.",
    reference="Normandin MD, Schiffer WK, Morris ED. NeuroImage 2012;59:2689-2699, "
    "doi:10.1016/j.neuroimage.2011.07.002",
    needs=frozenset({Need.REFERENCE}),
)
