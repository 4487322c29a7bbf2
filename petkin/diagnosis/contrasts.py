"""Evidence beside the channels: contrasts that know nothing of a channel's mean, each with a noise of its own.

    c_j = a e_j + nuisance + noise,    cov c_j = V_j I + N_j N_j'

for rows j of one family. Rows are whitened, templates projected on them, and their evidence is averaged over settings
as that of any hypothesis. V_j is given: a row's own few samples tell it too roughly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import evidence
from petkin.diagnosis.detect import p_value

Array = NDArray[np.float64]

_Z90 = 1.6448536269514722
_TINY = 1e-300


@dataclass(frozen=True)
class Family:
    """Contrasts of one kind.

    Args:
        rows: (J, K).
        nuisance: columns of what they may hold besides, as large as it may be (J, K, n).
        size: standard deviation of their noise (J,).
    """

    rows: Array
    nuisance: Array
    size: Array


@dataclass(frozen=True)
class Pattern:
    """What an effect of unit amplitude adds to one family of contrasts.

    Args:
        name: of the hypothesis.
        family: which contrasts.
        rows: (J, K).
        setting: values of its other parameters.
        scale: amplitude that the rows belong to, where they are not proportional to it; else 1.
        signed: whether it may be negative.
        width: standard deviation of the amplitude's prior, in units of `scale`.
    """

    name: str
    family: str
    rows: Array
    setting: Mapping[str, float]
    scale: float = 1.0
    signed: bool = True
    width: float = 1.0


@dataclass(frozen=True)
class Best:
    """The pattern of a hypothesis that its contrasts like best, with its amplitude and 90 % interval."""

    pattern: Pattern
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Contrasted:
    """What contrasts say.

    Args:
        evidence: log evidence by hypothesis.
        best: by hypothesis.
        p_value: of none of them.
    """

    evidence: Mapping[str, float]
    best: Mapping[str, Best]
    p_value: float


def judge_contrasts(
    families: Mapping[str, Family],
    patterns: Sequence[Pattern],
    *,
    least: float,
    draws: int,
    rng: np.random.Generator,
) -> Contrasted:
    """Evidence of every pattern's hypothesis.

    Args:
        families: contrasts by name.
        patterns: what to look for.
        least: smallest standard deviation that noise may have.
        draws: of noise for the p-value.
        rng: randomness.
    """
    roots = {name: _roots(family, least) for name, family in families.items()}
    observed = {name: _whitened(roots[name], family.rows) for name, family in families.items()}
    drawn = {name: rng.standard_normal((draws, values.size)) for name, values in observed.items()}
    by_name: dict[str, list[tuple[Pattern, float, float, Array]]] = {}
    for pattern in patterns:
        column = _whitened(roots[pattern.family], pattern.rows)
        information = float(column @ column)
        null = _evidence(pattern, drawn[pattern.family] @ column, information)
        entry = (pattern, float(observed[pattern.family] @ column), information, null)
        by_name.setdefault(pattern.name, []).append(entry)
    found, best, nulls = {}, {}, []
    for name, entries in by_name.items():
        each = np.array([float(_evidence(p, np.asarray(score), size)) for p, score, size, _ in entries])
        found[name] = _mean(each[:, None])[0]
        nulls.append(_mean(np.stack([null for *_, null in entries])))
        pattern, score, information, _ = entries[int(np.argmax(each))]
        best[name] = _sized(pattern, score, information)
    total = _mean(np.array(list(found.values()))[:, None])[0]
    return Contrasted({n: float(v) for n, v in found.items()}, best, p_value(total, _mean(np.stack(nulls))))


def _roots(family: Family, least: float) -> Array:
    """C^{-1/2} of every row (J, K, K)."""
    variance = np.maximum(family.size, least) ** 2
    nuisance = family.nuisance @ family.nuisance.swapaxes(-1, -2)
    covariance = variance[:, None, None] * np.eye(family.rows.shape[1]) + nuisance
    values, axes = np.linalg.eigh(covariance)
    return (axes / np.sqrt(np.maximum(values, _TINY))[:, None, :]) @ axes.swapaxes(-1, -2)


def _whitened(roots: Array, rows: Array) -> Array:
    return np.einsum("jkl,jl->jk", roots, rows).ravel()


def _evidence(pattern: Pattern, score: Array, information: float) -> Array:
    t = score / np.sqrt(information + pattern.width**-2.0)
    return evidence.two_sided(t) if pattern.signed else evidence.one_sided(t)


def _mean(logs: Array) -> Array:
    """log of the mean over the first axis."""
    return np.logaddexp.reduce(logs, axis=0) - np.log(len(logs))


def _sized(pattern: Pattern, score: float, information: float) -> Best:
    value, error = score / max(information, _TINY), max(information, _TINY) ** -0.5
    low, high = value - _Z90 * error, value + _Z90 * error
    return Best(pattern, pattern.scale * value, pattern.scale * low, pattern.scale * high)
