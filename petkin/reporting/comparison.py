"""Which model the curves ask for: Akaike's criterion, region by region."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.results import FitResult
from petkin.reporting.contents import FitReport
from petkin.reporting.wording import joined

#: Differences below this say nothing (Burnham & Anderson 2002, Model Selection and Multimodel Inference, section 2.6).
UNDECIDED = 2.0


@dataclass(frozen=True)
class Comparison:
    """AICc of M comparable models over R regions.

    Args:
        models: labels of the models compared.
        fits: their regional fits.
        delta: AICc minus the region's smallest, [M, R], NaN where a model has none.
        left_out: models that were fitted to other data or other weights.
    """

    models: tuple[str, ...]
    fits: tuple[FitResult, ...]
    delta: NDArray[np.float64]
    left_out: tuple[str, ...]

    def preferred(self, region: int) -> str:
        """The model with the smallest AICc, "undecided" where the next one is less than 2 behind, "" without values."""
        delta = self.delta[:, region]
        if np.isfinite(delta).sum() < 2:
            return ""
        best = int(np.nanargmin(delta))
        rivals = np.delete(delta, best)
        return self.models[best] if np.nanmin(rivals) >= UNDECIDED else "undecided"

    @property
    def summary(self) -> str:
        """One sentence."""
        votes = [self.preferred(r) for r in range(self.delta.shape[1])]
        judged = [v for v in votes if v]
        if not judged:
            return "AICc cannot be compared: no region has it for two models."
        parts = [f"{m} in {votes.count(m)}" for m in (*self.models, "undecided") if votes.count(m)]
        return f"AICc prefers {joined(parts)} of {len(judged)} regions.".replace("undecided in", "neither (Δ < 2) in")


def compare(report: FitReport) -> Comparison | None:
    """Compare the models that share curves and weights; None for fewer than two of them."""
    sections = [s for s in report.models if s.regional is not None]
    if len(sections) < 2 or not any(s.comparable for s in sections):
        return None
    first = next(s.regional for s in sections if s.comparable)
    kept = [s for s in sections if s.comparable and _same_weights(s.regional, first)]
    if len(kept) < 2:
        return None
    fits = tuple(s.regional for s in kept if s.regional is not None)
    aicc = np.stack([np.where(np.isfinite(f.aicc), f.aicc, np.nan).astype(np.float64) for f in fits])
    smallest = np.where(np.isfinite(aicc), aicc, np.inf).min(axis=0)
    delta = aicc - np.where(np.isfinite(smallest), smallest, np.nan)
    left_out = tuple(s.model for s in sections if s not in kept)
    return Comparison(tuple(s.model for s in kept), fits, delta, left_out)


def _same_weights(fit: FitResult | None, other: FitResult | None) -> bool:
    return fit is not None and other is not None and np.array_equal(fit.weights, other.weights, equal_nan=True)
