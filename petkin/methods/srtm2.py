"""SRTM with one washout rate of the reference region for all curves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, FitResult, Given, Need
from petkin.fitting.one_rate_fit import OneRateModel, fit_one_rate, require_shared
from petkin.fitting.reference_tissue import (
    effort_for,
    fixed_k2prime,
    reference_table,
    share_k2prime,
    with_known_k2prime,
)
from petkin.methods.method import Method


def _model(k2prime: float) -> OneRateModel:
    return OneRateModel(
        label="SRTM2",
        quantities=(
            ("R1", "1", "delivery relative to the reference region, K1 / K1'"),
            ("k2", "min^-1", "rate of return from tissue to plasma, R1 k2'"),
            ("k2a", "min^-1", "apparent rate of return, k2 / (1 + BPND)"),
            ("BPND", "1", "binding potential relative to non-displaceable tracer"),
        ),
        read=lambda _, R1, k2a: (R1, R1 * k2prime, k2a, k2prime * R1 / k2a - 1.0),
        positive=2,
        axis=False,
    )


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    curves, weights = np.asarray(curves), np.asarray(given.weights, np.float64)
    require_shared(curves, weights, len(given.observation.frames), 2, "SRTM2")
    effort = effort_for(voxels)
    packed = reference_table("SRTM2", given, choices.rate_bounds, effort)
    shared = share_k2prime(curves, given, choices, voxels)
    k2prime = fixed_k2prime("SRTM2", choices, shared)
    known, model = with_known_k2prime(packed, k2prime), _model(k2prime)
    settings = {"reference": given.reference_curve("SRTM2").name, "fixed": {} if shared else {"k2prime": k2prime}}
    found = fit_one_rate(curves, known, weights, model, effort, settings=settings, keep_predicted=not voxels)
    return replace(found, shared=shared)


SRTM2 = Method(
    label="SRTM2",
    name="simplified reference tissue model with one k2'",
    fit=_fit,
    symbols=("k2prime",),
    outcome="BPND",
    equation="C_T = R1 (C_R + (k2' - k2a) e^(-k2a t) * C_R), k2a = R1 k2' / (1 + BPND), k2' of all curves",
    how="As SRTM, with the rate of return of the reference region k2' held for all curves: as given by --fix k2prime,"
    " else where the sum of all curves' weighted squared residuals is least (regions together; voxels together, "
    "evenly spaced ones of more than 10,000). The error of k2' is from the curvature of that sum; errors of a "
    "curve take k2' as known.",
    reference="Wu Y, Carson RE. J Cereb Blood Flow Metab 2002;22:1440-1452, doi:10.1097/01.WCB.0000033967.83623.34",
    needs=frozenset({Need.REFERENCE}),
    share=share_k2prime,
    comparable=True,
)
