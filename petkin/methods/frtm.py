"""Full reference tissue model: two tissue compartments without blood."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import Parameter, ParameterSet
from petkin.fitting import Choices, FitResult, Given, Need
from petkin.fitting.one_rate_fit import require_shared
from petkin.fitting.reference_tissue import effort_for, reference_table
from petkin.fitting.two_rate_reference import fit_two_rates
from petkin.methods.method import Method

_PARAMETERS = ParameterSet(
    (
        Parameter("R1", "1", 1.0, 0.0, 10.0, meaning="delivery relative to the reference region, K1 / K1'"),
        Parameter("k2", "min^-1", 0.1, 0.0, 2.0, meaning="rate of return from tissue to plasma"),
        Parameter("k3", "min^-1", 0.05, 0.0, 2.0, meaning="rate into the bound compartment"),
        Parameter("k4", "min^-1", 0.05, 0.0, 2.0, meaning="rate out of the bound compartment"),
    )
)


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    curves, weights = np.asarray(curves), np.asarray(given.weights, np.float64)
    mine = _PARAMETERS.symbols
    box = _PARAMETERS.with_bounds({s: b for s, b in choices.bounds.items() if s in mine})
    box = box.with_fixed({s: v for s, v in choices.fixed.items() if s in mine})
    require_shared(curves, weights, len(given.observation.frames), len(box.free), "FRTM")
    effort = effort_for(voxels)
    packed = reference_table("FRTM", given, (0.0, float(np.sum(box.upper[1:]))), effort)
    settings = {
        "reference": given.reference_curve("FRTM").name,
        "fixed": {p.symbol: p.start for p in box if p.fixed},
    }
    return fit_two_rates(curves, packed, weights, box, effort, settings=settings, keep_predicted=not voxels)


FRTM = Method(
    label="FRTM",
    name="full reference tissue model",
    fit=_fit,
    symbols=_PARAMETERS.symbols,
    outcome="BPND",
    equation="C_T = R1 C_R + sum_i p_i (k2 - R1 a_i) e^(-a_i t) * C_R, a_1 + a_2 = k2 + k3 + k4, a_1 a_2 = k2 k4, "
    "p_i the 2TCM's shares, BPND = k3 / k4",
    how="Weighted least squares of frame values inside the bounds of R1, k2, k3 and k4, by projected "
    "Levenberg-Marquardt from the best points of a grid. Standard errors: Gauss-Newton covariance scaled by "
    "WRSS / (n - p), delta method; a parameter on a bound counts as known, and so does the reference curve.",
    reference="Lammertsma AA et al. J Cereb Blood Flow Metab 1996;16:42-52, doi:10.1097/00004647-199601000-00005",
    needs=frozenset({Need.REFERENCE}),
    comparable=True,
)
