"""Parametric bootstrap: intervals from fits of curves made of the fitted one and fresh noise.

    y*_k = x_k + sqrt(chi2 / w_k) e_k,   e_k ~ N(0, 1),

x the fitted curve, chi2 = WRSS / (n - p) the noise scale that it left, w the frame weights. The resamples of all curves
are fitted like voxels, together; where curves share a parameter, each set of curves is fitted on its own.

Reference: Efron B, Tibshirani RJ. An introduction to the bootstrap. Chapman & Hall 1993, sections 6.5 and 13.3.
doi:10.1201/9780429246593
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting.results import Column, Estimate, FitResult, Status

Array = NDArray[np.float64]
#: Curves (N, K) and whether they may be fitted like voxels -> their fit.
Refit = Callable[[Array, bool], FitResult]

#: Ends of the interval, percent of the resamples.
_ENDS = (2.5, 97.5)
#: Fewest resamples whose 2.5th percentile is more than the extreme.
FEWEST = 100
#: Curves fitted together.
_TOGETHER = 20000
_FAILED = (Status.NOT_FINITE, Status.NO_SIGNAL, Status.NOT_CONVERGED)


@dataclass(frozen=True)
class Resampling:
    """How to resample.

    Args:
        count: resamples a curve.
        seed: of the noise; every curve has a stream of its own, so that it does not depend on its neighbours.
    """

    count: int
    seed: int = 0

    def __post_init__(self) -> None:
        if self.count < FEWEST:
            raise InputError(f"--bootstrap is {self.count}; percentile intervals need at least {FEWEST} resamples.")
        if self.seed < 0:
            raise InputError(f"--seed is {self.seed}; give a whole number, 0 or more.")


def bootstrap(
    refit: Refit, result: FitResult, curves: NDArray[np.floating], how: Resampling, progress: Callable[[float], None]
) -> FitResult:
    """The result with bootstrap intervals of every quantity.

    Args:
        refit: the fit that made the result.
        result: fit of the curves, with fitted curves in all frames that have weight.
        curves: (N, K), kBq/mL.
        how: how many, and their seed.
        progress: told how far it is, 0 to 1.

    Returns:
        The result with columns `<symbol>-bootlow`, `<symbol>-boothigh` (percentiles 2.5 and 97.5 of the resamples that
        could be fitted), `<symbol>-bias` (their median less the estimate, percent) and `bootfailed` (share of resamples
        without a fit, percent); NaN where the curve itself has no fit. Unchanged, with a remark, where the method does
        not predict all frames.
    """
    weights = np.broadcast_to(np.asarray(result.weights, np.float64), np.shape(curves))
    fitted = np.flatnonzero(
        np.isfinite(result.chi2) & np.isfinite(np.stack([e.value for e in result.estimates])).any(0)
    )
    if result.predicted is None or not np.isfinite(result.predicted[fitted][weights[fitted] > 0]).all():
        text = f"{result.model}: no bootstrap, because it does not say what all frames should hold."
        return replace(result, remarks=(*result.remarks, text))
    low, high, bias = (np.full((len(result.estimates), len(result.status)), np.nan) for _ in range(3))
    failed = np.full(len(result.status), np.nan)
    for rows, values, bad in _refits(refit, result, np.asarray(curves, np.float64), weights, fitted, how, progress):
        failed[rows] = 100.0 * bad.mean(axis=-1)
        for i, estimate in enumerate(result.estimates):
            low[i, rows], middle, high[i, rows] = _percentiles(np.where(bad, np.nan, values[i]))
            with np.errstate(all="ignore"):
                bias[i, rows] = 100.0 * (middle / estimate.value[rows] - 1.0)
    text = f"{result.model}: bootstrap of {how.count} resamples a curve, seed {how.seed}."
    return replace(
        result,
        columns=(
            *result.columns,
            *_columns(result.estimates, low, high, bias),
            Column("bootfailed", failed, _SHARE, "percent", mapped=False),
        ),
        settings=result.settings | {"bootstrap": how.count, "seed": how.seed},
        remarks=(*result.remarks, text) if np.nanmax(failed, initial=0.0) > 0 else result.remarks,
    )


_SHARE = "share of bootstrap resamples that could not be fitted"


def _refits(refit, result, curves, weights, fitted, how, progress):
    """Rows, values of every estimate (E, rows, resamples) and failures (rows, resamples), part by part."""
    if result.shared:
        every = _resampled(result, curves, weights, fitted, how)
        parts = []
        whole = np.broadcast_to(curves, (1, *curves.shape)).copy()[0]
        for b in range(how.count):
            whole[fitted] = every[:, b]
            parts.append(refit(whole, False))
            progress((b + 1) / how.count)
        values = np.stack([np.stack([e.value[fitted] for e in part.estimates]) for part in parts], axis=-1)
        yield fitted, values, np.stack([_bad(part)[fitted] for part in parts], axis=-1)
        return
    step = max(1, _TOGETHER // how.count)
    for start in range(0, len(fitted), step):
        rows = fitted[start : start + step]
        part = refit(_resampled(result, curves, weights, rows, how).reshape(-1, curves.shape[1]), True)
        shape = (len(rows), how.count)
        yield rows, np.stack([e.value.reshape(shape) for e in part.estimates]), _bad(part).reshape(shape)
        progress(min(start + step, len(fitted)) / len(fitted))


def _resampled(result: FitResult, curves: Array, weights: Array, rows: NDArray[np.intp], how: Resampling) -> Array:
    """Curves with fresh noise (rows, resamples, K); frames without weight stay as they were measured."""
    made = np.empty((len(rows), how.count, curves.shape[1]))
    assert result.predicted is not None
    for place, row in enumerate(rows):
        noise = np.random.default_rng([how.seed, int(row)]).standard_normal((how.count, curves.shape[1]))
        counted = weights[row] > 0
        sd = np.sqrt(result.chi2[row] / np.where(counted, weights[row], 1.0))
        made[place] = np.where(counted, result.predicted[row] + sd * noise, curves[row])
    return made


def _bad(part: FitResult) -> NDArray[np.bool_]:
    return np.isin(part.status, _FAILED)


def _percentiles(values: Array) -> Array:
    """Percentiles 2.5, 50 and 97.5 of every row (3, rows), infinite values at the top, NaN left out."""
    answer = np.full((3, len(values)), np.nan)
    for n, row in enumerate(values):
        known = np.sort(row[~np.isnan(row)])
        if known.size:
            places = np.rint(np.array([_ENDS[0], 50.0, _ENDS[1]]) / 100.0 * (known.size - 1)).astype(int)
            answer[:, n] = known[places]
    return answer


def _columns(estimates: tuple[Estimate, ...], low: Array, high: Array, bias: Array) -> list[Column]:
    columns = []
    for i, e in enumerate(estimates):
        ends = f"end of the 95 percent interval of {e.symbol} by parametric bootstrap"
        columns.append(Column(f"{e.symbol}-bootlow", low[i], f"lower {ends}", e.unit, mapped=False))
        columns.append(Column(f"{e.symbol}-boothigh", high[i], f"upper {ends}", e.unit, mapped=False))
        text = f"median of the resamples' {e.symbol} less the estimate: what noise does to it"
        columns.append(Column(f"{e.symbol}-bias", bias[i], text, "percent", mapped=False))
    return columns
