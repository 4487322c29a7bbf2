"""Evidence beside the channels: contrasts that know nothing of a channel's mean, each with a noise of its own.

    c = a e + nuisance + noise,    C = cov c = diag(V_j) + N'N

for all rows j of one family at once. A template's score is e' C^{-1} c, and its evidence is averaged over settings as
that of any hypothesis. V_j is given: a row's own few samples tell it too roughly.
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
        nuisance: columns of what they may hold besides, as large as it may be (n, J, K).
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
    by_name: dict[str, list[tuple[Pattern, float, float, Array]]] = {}
    for name, family in families.items():
        mine = [pattern for pattern in patterns if pattern.family == name]
        if not mine:
            continue
        scores, information = _scores(family, np.stack([p.rows.ravel() for p in mine]), least)
        drawn = rng.standard_normal((draws, len(mine))) @ _root(information)
        for i, pattern in enumerate(mine):
            size = float(information[i, i])
            entry = (pattern, float(scores[i]), size, _evidence(pattern, drawn[:, i], size))
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


def _scores(family: Family, columns: Array, least: float) -> tuple[Array, Array]:
    """E C^{-1} c and E C^{-1} E' of columns E (m, J K), by Woodbury's identity: N has fewer rows than C."""
    weight = np.repeat(np.maximum(family.size, least) ** -2.0, family.rows.shape[1])
    nuisance = family.nuisance.reshape(len(family.nuisance), -1)
    inner = np.eye(len(nuisance)) + (nuisance * weight) @ nuisance.T
    weighted = columns * weight
    free = weighted - np.linalg.solve(inner, nuisance @ weighted.T).T @ (nuisance * weight)
    return free @ family.rows.ravel(), free @ columns.T


def _root(covariance: Array) -> Array:
    """A of A'A = covariance."""
    values, axes = np.linalg.eigh(covariance)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * axes.T


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
