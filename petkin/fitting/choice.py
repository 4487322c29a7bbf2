"""Which of several models a curve asks for, and estimates that do not depend on choosing one.

    weight_i = exp(-D_i / 2) / sum_j exp(-D_j / 2),   D_i = AICc_i - min AICc             Akaike weights
    g = sum_i weight_i g_i,   SE(g) = sum_i weight_i sqrt(SE_i^2 + (g_i - g)^2)     average, unconditional error

Reference: Burnham KP, Anderson DR. Model selection and multimodel inference. Springer 2002, sections 2.9 and 4.3.
doi:10.1007/b97636
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.results import Column, Estimate, FitResult

Array = NDArray[np.float64]

#: What the files call the average over models.
AVERAGE = "AICc"
#: Where models of more weight than this together have no finite value, there is no average.
_NEGLIGIBLE = 0.05
_BEST = "model with the least AICc"
_WEIGHT = "Akaike weight: probability that this is the best of the models compared, given the data"


def akaike(aicc: NDArray[np.floating]) -> tuple[Array, Array]:
    """AICc above the least of every curve, and Akaike weights, each (M, N); NaN and 0 for models without a fit."""
    known = np.isfinite(aicc)
    least = np.where(known, aicc, np.inf).min(axis=0)
    above = np.where(known, aicc - np.where(np.isfinite(least), least, np.nan), np.nan)
    likely = np.where(known, np.exp(-0.5 * np.where(known, above, 0.0)), 0.0)
    total = likely.sum(axis=0)
    return above, np.divide(likely, total, out=np.zeros_like(likely), where=total > 0)


def compare_models(results: Sequence[FitResult]) -> FitResult:
    """The models' average, and which of them is best, curve by curve.

    Args:
        results: fits of the same curves with the same weights, whose AICc may be compared; two or more.

    Returns:
        A result called "AICc": averages of what all models estimate and mean alike, with unconditional standard errors;
        chi2, AICc and status of the best model; columns `choice` (1 for the first model, 2 for the second, ...; 0 for
        none), `weight-<model>` and `delta-<model>`, and `<symbol>-spread`, how far the models' estimates lie apart.
    """
    labels = [result.model for result in results]
    above, weights = akaike(np.stack([result.aicc for result in results]))
    none = ~np.isfinite(above).any(axis=0)
    best = np.where(none, 0, np.argmax(weights, axis=0))
    averaged = [_average(symbol, results, weights) for symbol in _shared(results)]
    columns = [Column("choice", np.where(none, 0, best + 1).astype(np.uint8), _BEST, levels=dict(enumerate(labels, 1)))]
    for label, delta, weight in zip(labels, above, weights):
        columns.append(Column(f"delta-{label}", delta, f"AICc of {label} above the least", mapped=False))
        columns.append(Column(f"weight-{label}", np.where(none, np.nan, weight), f"{label}: {_WEIGHT}"))

    def of_best(name: str) -> NDArray:
        return np.choose(best, [getattr(result, name) for result in results])

    return FitResult(
        model=AVERAGE,
        estimates=tuple(estimate for estimate, _ in averaged),
        chi2=of_best("chi2"),
        aicc=of_best("aicc"),
        status=of_best("status"),
        weights=results[0].weights,
        settings={"models": labels},
        columns=(*columns, *(spread for _, spread in averaged)),
    )


def _shared(results: Sequence[FitResult]) -> list[str]:
    """What all models estimate and mean alike: not k2, k3, ..., which each model uses its own way."""
    others = [{e.symbol for e in result.estimates} for result in results[1:]]
    return [e.symbol for e in results[0].estimates if e.symbol[0] != "k" and all(e.symbol in o for o in others)]


def _average(symbol: str, results: Sequence[FitResult], weights: Array) -> tuple[Estimate, Column]:
    """A quantity over models with a value; its unconditional percent error; and how far the models lie apart."""
    unit, meaning = next((e.unit, e.meaning) for e in results[0].estimates if e.symbol == symbol)
    value = np.stack([result[symbol] for result in results]).astype(np.float64)
    error = np.stack([result.percent_se(symbol) for result in results]) * np.abs(value) / 100.0
    used = np.isfinite(value) & (weights > 0)
    share = np.where(used, weights, 0.0)
    with np.errstate(all="ignore"):
        share = share / share.sum(axis=0)
        known = np.where(used, value, 0.0)
        mean = np.where(np.where(used, 0.0, weights).sum(axis=0) > _NEGLIGIBLE, np.nan, (share * known).sum(axis=0))
        each = np.where(used, np.sqrt(error**2 + (known - mean) ** 2), 0.0)
        percent = 100.0 * (share * each).sum(axis=0) / np.abs(mean)
        apart = np.where(used, value, -np.inf).max(axis=0) - np.where(used, value, np.inf).min(axis=0)
        spread = np.where(used.any(axis=0), 100.0 * apart / np.abs(mean), np.nan)
    text = f"{meaning}: average over models by Akaike weights" if meaning else "average over models by Akaike weights"
    said = f"{symbol} of the models: largest less smallest, in percent of their average"
    return Estimate(symbol, unit, mean, percent, text), Column(
        f"{symbol}-spread", spread, said, "percent", mapped=False
    )


def agreement(results: Sequence[FitResult], names: str = "regions") -> str:
    """One sentence: how often each model is best, and on what the models agree within two standard errors."""
    above, weights = akaike(np.stack([result.aicc for result in results]))
    judged = np.isfinite(above).sum(axis=0) >= 2
    best = np.argmax(weights, axis=0)
    won = ", ".join(f"{r.model} in {int((judged & (best == m)).sum())}" for m, r in enumerate(results))
    parts = []
    for symbol in _shared(results):
        value = np.stack([r[symbol] for r in results])
        error = np.stack([r.percent_se(symbol) for r in results]) * np.abs(value) / 100.0
        apart = value.max(axis=0) - value.min(axis=0)
        known = np.isfinite(apart) & np.isfinite(error).all(axis=0)
        if known.any():
            same = int((apart[known] <= 2.0 * np.sqrt((error**2).max(axis=0)[known])).sum())
            parts.append(f"{symbol} in {same} of {int(known.sum())}")
    agreed = f" The models agree within two standard errors on {', '.join(parts)}." if parts else ""
    return f"Least AICc: {won} of {int(judged.sum())} {names}.{agreed}"
