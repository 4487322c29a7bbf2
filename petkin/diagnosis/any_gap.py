"""Is there a gap in any of several data sets: what each says of any cause, and what all say of the same ones.

    F = -2 sum_i ln p_i,    S = mean_e int prod_i [1 - pi + pi B_ie] d pi

with p_i the p-value of data set i and B_ie the evidence of hypothesis e in it, S less what noise seldom gives a
hypothesis (see `statistic`). F is Fisher's, which sees that many gaps are a little likely; S sees that a few hold the
same, or one a large one, which F loses among many that hold none. The smaller of both p-values is taken against its own
distribution over draws, one of every data set at a time; that of S, which one data set may settle, is no smaller than
its draws can tell. The answer counts as often as the most doubtful evidence has it (`AgainstNoise.times`).

Reference: Fisher RA. Statistical methods for research workers. Edinburgh: Oliver and Boyd; 1932.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import evidence
from petkin.diagnosis.detect import AgainstNoise, reached, statistic

Array = NDArray[np.float64]

#: Draws of all data sets; prevalences tried; the largest log evidence whose exponential is kept.
_DRAWS, _PREVALENCES, _LARGEST = 4000, np.linspace(0.15, 0.99, 12), 600.0


def any_gap(p_values: Sequence[float], against: Sequence[AgainstNoise]) -> float:
    """P-value of no gap in any.

    Args:
        p_values: of no gap in each.
        against: what speaks for one in each, in the same order.
    """
    rng = np.random.default_rng(0)
    names = list(dict.fromkeys(name for one in against for name in one.names))
    many = np.zeros(1 + _DRAWS)
    same = np.zeros((len(_PREVALENCES), 1 + _DRAWS, len(names)))
    for p, one in zip(p_values, against, strict=True):
        picked = rng.integers(len(one.drawn), size=_DRAWS)
        many -= 2.0 * np.log(np.append(p, one.p_values[picked]))
        gained = np.expm1(np.minimum(one.of(names)[np.append(0, 1 + picked)], _LARGEST))
        for held, prevalence in zip(same, _PREVALENCES, strict=True):
            held += np.log1p(prevalence * gained)
    shared = evidence.mean(same, axis=0)
    seldom = len(many) / (1 + min(len(one.drawn) for one in against))
    least = np.minimum(reached(many), np.maximum(reached(statistic(shared, shared[1:])), seldom))
    times = max(one.times for one in against)
    return min(1.0, times * float(reached(-least)[0] / len(least)))
