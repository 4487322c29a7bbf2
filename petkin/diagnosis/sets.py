"""From evidence to probabilities, and to the set of explanations that the data cannot split."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.nuisance import Projection

Array = NDArray[np.float64]

#: Mass that a set must hold, and the cosine above which two explanations are one.
_MASS, ALIKE = 0.9, 0.95
#: Log odds of a gap of no name per unit of its log evidence against all names, and that evidence at even odds; how
#: often no explanation that was looked at is right, however likely it seems, and where what channels are means of was
#: looked at too. The first two were chosen by how many unnamed and named training causes are then called unknown, all
#: by how often sets hold what they say.
_STEEPNESS, _EVEN = 0.7, -2.5
LAPSE, LAPSE_WITHIN = 0.05, 0.03


def probabilities(
    evidence: Mapping[str, float], unknown: float, *, lapse: float = 0.0
) -> tuple[dict[str, float], float]:
    """Probabilities of named explanations and of none of them, which sum to 1.

    Args:
        evidence: log evidence by name.
        unknown: log evidence of a gap of no name.
        lapse: probability that none of them is right beyond what their evidence says.
    """
    values = np.array([*evidence.values()])
    odds = _STEEPNESS * (unknown - np.logaddexp.reduce(values) - _EVEN)
    none = lapse + (1.0 - lapse) * float(0.5 * (1.0 + np.tanh(0.5 * odds)))
    share = np.exp(values - np.logaddexp.reduce(values))
    return {name: float(p) for name, p in zip(evidence, (1.0 - none) * share)}, none


def in_place_of(named: Sequence[float], unknown: float) -> float:
    """Log evidence of a gap of no name beside that of names, as much beyond or below them as it has proven to mean."""
    together = float(np.logaddexp.reduce(named))
    return together + _STEEPNESS * (unknown - together)


def confusability(effects: Sequence[Array], projection: Projection) -> Array:
    """|cosine| between what effects add to the whitened data, after the projection (n, n)."""
    columns = np.stack(effects, axis=1)
    inner = projection.inner(columns, columns)
    size = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    return np.abs(inner) / np.outer(size, size)


def smallest_set(probability: Mapping[str, float], alike: Mapping[frozenset[str], float]) -> tuple[str, ...]:
    """Fewest explanations that hold the mass among the named, with all that are alike to the likeliest.

    An explanation and the same with a second effect look alike wherever the first is strong; whether the second is
    there is what their evidence says, so that neither stands in for the other.

    Args:
        probability: by name.
        alike: cosines by pair of names; absent ones count as distinct.
    """
    total = sum(probability.values())
    ranked = sorted(probability, key=lambda name: -probability[name])
    chosen, held = [], 0.0
    for name in ranked:
        if chosen and held >= _MASS * total:
            break
        chosen.append(name)
        held += probability[name]
    leader = chosen[0]
    others = [n for n in ranked if n not in chosen and not _nested(leader, n)]
    partners = [n for n in others if alike.get(frozenset((leader, n)), 0.0) >= ALIKE]
    return (*chosen, *partners)


def _nested(one: str, other: str) -> bool:
    """Whether all effects of one are among those of the other."""
    mine, theirs = set(one.split("+")), set(other.split("+"))
    return mine <= theirs or theirs <= mine
