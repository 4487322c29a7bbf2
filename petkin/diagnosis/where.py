"""Where the gap lies: which channels and which samples, with the rate of false claims held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: The q-value up to which a part is claimed.
PART = 0.05


@dataclass(frozen=True)
class Place:
    """How a gap spreads over channels or samples.

    Args:
        q_values: smallest false discovery rate at which each would be claimed.
        shares: of the gap's energy; they sum to 1.
    """

    q_values: Array
    shares: Array


def over(residual: Array, draws: Array, gap: Array, axis: int) -> Place:
    """Energy of the residual along an axis against draws of noise.

    Args:
        residual: whitened and projected (C, K).
        draws: the same of noise alone (B, C, K).
        gap: whitened change that the leading explanation makes (C, K).
        axis: 0 sums over samples, for channels; 1 over channels, for samples.
    """
    across = 1 - axis
    observed, null = (residual**2).sum(axis=across), (draws**2).sum(axis=across + 1)
    p = (1 + (null >= observed).sum(axis=0)) / (1 + len(draws))
    energy = (gap**2).sum(axis=across)
    total = energy.sum()
    return Place(benjamini_hochberg(p), energy / total if total > 0 else np.full(len(energy), 1.0 / len(energy)))


def benjamini_hochberg(p: Array) -> Array:
    """q-values of p-values.

    Reference: Benjamini Y, Hochberg Y. J R Stat Soc B 1995;57:289-300.
    """
    order = np.argsort(p)
    ranked = p[order] * len(p) / np.arange(1, len(p) + 1)
    q = np.empty_like(p)
    q[order] = np.minimum(np.minimum.accumulate(ranked[::-1])[::-1], 1.0)
    return q
