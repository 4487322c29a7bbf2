"""What members that share a cause say of it together: its mean strength, how far it closes gaps, when it begins.

The mean is that of DerSimonian and Laird; its interval is theirs, or that of Student's t with the spread that is seen
(Hartung, Knapp), whichever is wider: a spread that few members tell is itself unsure. An error that all members have
alike is not averaged away.

Reference: DerSimonian R, Laird N. Meta-analysis in clinical trials. Control Clin Trials 1986;7:177-188; Knapp G,
Hartung J. Stat Med 2003;22:2693-2710.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from petkin.diagnosis.how_far import Interval
from petkin.diagnosis.sharing import LEAST_ERROR, error_of
from petkin.diagnosis.strength import Z90, Strength

Array = NDArray[np.float64]

_TAIL = 0.95
#: The least error of a closure.
_SURE = 0.02


@dataclass(frozen=True)
class Pooled:
    """Values together: their mean with its 90 % interval, and the spread between members beyond their own errors."""

    interval: Interval
    between: float


def mean_strength(strengths: Sequence[Strength]) -> Pooled | None:
    """None of fewer than two strengths, of what has none, or of what is in another channel of each, or goes another
    way."""
    if len(strengths) < 2 or strengths[0].unit == "flag":
        return None
    if len({s.unit for s in strengths}) > 1 or len({s.channel for s in strengths if not s.single}) > 1:
        return None
    values = np.array([s.value for s in strengths])
    alike = np.array([s.alike for s in strengths])
    errors = np.maximum(np.array([error_of(s) for s in strengths]) ** 2 - (alike * values) ** 2, LEAST_ERROR**2) ** 0.5
    return _pooled(values, errors, float(alike.max()))


def mean_closure(closures: Sequence[Interval]) -> Interval | None:
    """None of fewer than two."""
    if len(closures) < 2:
        return None
    values = np.array([c.value for c in closures])
    errors = np.array([c.high - c.low for c in closures]) / (2.0 * Z90)
    found = _pooled(values, np.maximum(errors, _SURE)).interval
    return Interval(min(found.value, 1.0), found.low, min(found.high, 1.0))


def moment(times: Sequence[float | None], probability: Array) -> Interval | None:
    """With the times between which 0.9 of it lies: halfway to those next to them that were asked."""
    if any(time is None for time in times):
        return None
    asked, place = np.unique([float(time or 0.0) for time in times], return_inverse=True)
    share = np.bincount(place[: probability.size], probability, asked.size) / probability.sum()
    low, high = (int(np.searchsorted(np.cumsum(share), tail)) for tail in (1.0 - _TAIL, _TAIL))
    halfway = np.concatenate([asked[:1], 0.5 * (asked[1:] + asked[:-1]), asked[-1:]])
    return Interval(float(share @ asked), float(halfway[low]), float(halfway[min(high, asked.size - 1) + 1]))


def _pooled(values: Array, errors: Array, alike: float = 0.0) -> Pooled:
    """Values (N,) with their errors, and the share of them that all err by together."""
    weight = errors**-2.0
    fixed = (weight @ values) / weight.sum()
    excess = weight @ (values - fixed) ** 2 - (len(values) - 1)
    spread = max(excess / (weight.sum() - (weight**2).sum() / weight.sum()), 0.0)
    weight = 1.0 / (errors**2 + spread)
    mean = float((weight @ values) / weight.sum())
    seen = (weight @ (values - mean) ** 2) / (len(values) - 1)
    own = max(Z90, stdtrit(len(values) - 1, _TAIL) * np.sqrt(seen)) * weight.sum() ** -0.5
    half = float(np.hypot(own, Z90 * alike * mean))
    return Pooled(Interval(mean, mean - half, mean + half), float(np.sqrt(spread)))
