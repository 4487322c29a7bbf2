"""What a fit leaves: how large, and whether by chance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.results import FitResult
from petkin.reporting.contents import RegionCurves

#: Fewer runs than this many standard deviations below chance (one in 700) are no chance.
_SIGNIFICANT = 3.0
#: Misfits below this many percent of the peak are rounding, whatever their signs.
_NEGLIGIBLE_PERCENT = 0.01


@dataclass(frozen=True)
class SignRuns:
    """Runs of residuals of one sign in time order, and how many are expected by chance."""

    found: int
    expected: float
    systematic: bool


def standardised_residuals(curves: RegionCurves, fit: FitResult) -> NDArray[np.float64]:
    """r_k = sqrt(w_k) (y_k - yhat_k) / sqrt(chi2), [R, K]: about N(0, 1) where the model and the weights are right.

    NaN where there is no prediction, no weight or no chi2; 0 where the fit is exact.
    """
    if fit.predicted is None:
        return np.full(curves.tacs.shape, np.nan)
    weights = np.broadcast_to(np.asarray(fit.weights, np.float64), curves.tacs.shape)
    raw = np.sqrt(np.maximum(weights, 0)) * (curves.tacs - fit.predicted)
    chi2 = np.broadcast_to(np.asarray(fit.chi2, np.float64)[:, None], raw.shape)
    scaled = raw / np.sqrt(np.where(chi2 > 0, chi2, 1.0))
    return np.where((weights > 0) & np.isfinite(chi2), np.where(chi2 == 0, 0.0, scaled), np.nan)


def sign_runs(curves: RegionCurves, fit: FitResult, region: int) -> SignRuns:
    """Runs test: with n+ and n- residuals of each sign, chance makes mu = 2 n+ n- / n + 1 runs,

    with variance (mu - 1) (mu - 2) / (n - 1). Too few runs mean that the model bends where the curve does not.

    Reference: Wald & Wolfowitz (1940) Ann Math Stat 11:147, doi:10.1214/aoms/1177731909.
    """
    residuals = standardised_residuals(curves, fit)[region]
    signs = np.sign(residuals[np.isfinite(residuals) & (residuals != 0)])
    above, below = int((signs > 0).sum()), int((signs < 0).sum())
    found = int(np.count_nonzero(np.diff(signs))) + 1 if signs.size else 0
    if min(above, below) < 2:
        return SignRuns(found, float(found), False)
    expected = 2.0 * above * below / (above + below) + 1.0
    spread = math.sqrt((expected - 1.0) * (expected - 2.0) / (above + below - 1.0))
    assert fit.predicted is not None
    matters = percent_rms(curves.tacs[region], fit.predicted[region]) > _NEGLIGIBLE_PERCENT
    return SignRuns(found, expected, matters and expected - found > _SIGNIFICANT * spread)


def percent_rms(tac: NDArray[np.floating], predicted: NDArray[np.floating]) -> float:
    """Root mean square of measured minus fitted, in percent of the curve's largest absolute value."""
    both = np.isfinite(tac) & np.isfinite(predicted)
    peak = float(np.abs(tac[both]).max()) if both.any() else 0.0
    return 100.0 * float(np.sqrt(np.mean((tac - predicted)[both] ** 2))) / peak if peak else float("nan")
