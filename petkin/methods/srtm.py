"""Simplified reference tissue model: binding potential without blood."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, FitResult, Given, Need
from petkin.fitting.one_rate_fit import OneRateModel, fit_one_rate, require_shared
from petkin.fitting.reference_tissue import effort_for, reference_table
from petkin.methods.method import Method


def _read(R1, lasting, k2a):
    k2 = lasting + R1 * k2a
    return R1, k2, k2a, k2 / R1, lasting / k2a + (R1 - 1.0)


_MODEL = OneRateModel(
    label="SRTM",
    quantities=(
        ("R1", "1", "delivery relative to the reference region, K1 / K1'"),
        ("k2", "min^-1", "rate of return from tissue to plasma"),
        ("k2a", "min^-1", "apparent rate of return, k2 / (1 + BPND)"),
        ("k2prime", "min^-1", "rate of return of the reference region, k2 / R1"),
        ("BPND", "1", "binding potential relative to non-displaceable tracer"),
    ),
    read=_read,
    positive=2,
)


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    curves, weights = np.asarray(curves), np.asarray(given.weights, np.float64)
    require_shared(curves, weights, len(given.observation.frames), _MODEL.free, "SRTM")
    effort = effort_for(voxels)
    packed = reference_table("SRTM", given, choices.rate_bounds, effort)
    settings = {"reference": given.reference_curve("SRTM").name}
    return fit_one_rate(curves, packed, weights, _MODEL, effort, settings=settings, keep_predicted=not voxels)


SRTM = Method(
    label="SRTM",
    name="simplified reference tissue model",
    fit=_fit,
    symbols=(),
    outcome="BPND",
    equation="C_T = R1 C_R + (k2 - R1 k2a) e^(-k2a t) * C_R, k2a = k2 / (1 + BPND)",
    how="Weighted least squares of frame values: the reference curve is the smoothest that reports its frame values, "
    "its exponentials are tabulated exactly over the interval of rates, and every curve is looked up over all of them "
    "and polished by variable projection (Gunn RN et al. NeuroImage 1997;6:279-287, doi:10.1006/nimg.1997.0303). "
    "Standard errors: Gauss-Newton covariance scaled by WRSS / (n - 3), delta method; the reference curve counts as "
    "known.",
    reference="Lammertsma AA, Hume SP. NeuroImage 1996;4:153-158, doi:10.1006/nimg.1996.0066",
    needs=frozenset({Need.REFERENCE}),
    comparable=True,
)
