"""Members of a cohort that share a cause with some prevalence, and what they may have in common beyond that.

    log B(e) = log int prod_i [(1 - pi) b_i + pi e_i] d pi - sum_i log b_i,     where two or more have it

with e_i the evidence of all explanations of member i that hold e, and b_i that of what it may have without.

Members have the cause each with strength and setting of its own, or, as likely, with one of the two or both in common:
strengths are then about the same one (normal about it, or on a log scale, with a spread of some share of it), settings
the same. Where there is but one setting and one strength s with error d, a refit tells e_i of what it had averaged over
strengths of its own (B(t), see `evidence`),

    e_i exp(t^2 / 2) / B(t) N(s; m, spread^2 + d^2) / N(0; 0, d^2),    t = s / d

and templates tell it elsewhere (see `profile`). So what is too weak in each, or might begin at any moment, is told by
all where they agree, and a member that shows none of a cause that is strong elsewhere does not have it weakly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.evidence import mean, one_sided, two_sided
from petkin.diagnosis.how_far import Interval
from petkin.diagnosis.profile import Profile
from petkin.diagnosis.strength import Z90, Estimate, Strength
from petkin.jit import njit

Array = NDArray[np.float64]

#: Prevalences tried, from where a cause is shared rather than chance.
_PREVALENCES = np.linspace(0.15, 0.99, 43)
#: Log evidence of one member beyond which more makes no difference, and what is too unlikely to count.
_LARGEST, _FAINT = 400.0, 25.0
_TAILS = (0.05, 0.95)
#: The least standard deviation that a strength is taken to have, in its unit.
LEAST_ERROR = 1e-6
#: A strength in common: in units of the median error, and by how much of itself it differs between members.
_COMMON, _SPREADS = np.geomspace(0.8, 80.0, 60), (0.2, 0.4)


def error_of(strength: Estimate) -> float:
    """Its standard deviation."""
    return max((strength.high - strength.low) / (2.0 * Z90), LEAST_ERROR)


@dataclass(frozen=True)
class Mixture:
    """Members that have a cause with some prevalence, or what any data set may have.

    Args:
        log_evidence: against none that has it.
        prevalence: share of the members that have it.
        carriers: probability that each member has it (N,).
        beside: log evidence of each member, whether it has it or not (Q, N): what a further cause is asked against.
        settings: probability of each setting that they may have in common (S,), the rest that of no such one.
    """

    log_evidence: float
    prevalence: Interval
    carriers: Array
    beside: Array
    settings: Array


@dataclass(frozen=True)
class Common:
    """Something that members may have in common, at some values of it.

    Args:
        evidence: of members at each (V, N).
        settings: place of the setting in each (V,), where that is in common.
    """

    evidence: Array
    settings: NDArray[np.intp] | None = None


def mixture(own: Array, common: Sequence[Common], background: Array, *, share: float = 0.5) -> Mixture:
    """Of members who have a cause with all of their own, or with something in common, any kind alike.

    Args:
        own: evidence with the cause (N,).
        common: the same at what may be in common.
        background: evidence without, for every share of members that may have a gap (Q, N).
        share: how likely they have something in common, where they can.
    """
    every = np.concatenate([own[None], *(kind.evidence for kind in common)])
    chances = [np.full(len(kind.evidence), share / len(common) / len(kind.evidence)) for kind in common]
    chance = np.log(np.concatenate([[1.0 - share if common else 1.0], *chances]))
    ratio = np.exp(np.clip(every - background[:, None], -_LARGEST, _LARGEST))
    logs = _products(ratio, _PREVALENCES) + chance[:, None] + background.sum(axis=-1)[:, None, None]
    total = float(mean(logs.ravel()) + np.log(logs.size))
    q, v, p = np.nonzero(logs > total - _FAINT)
    weight = np.exp(logs[q, v, p] - total)
    weight /= weight.sum()
    prevalence = _PREVALENCES[p]
    by_prevalence = np.bincount(p, weight, _PREVALENCES.size)
    low, high = np.interp(_TAILS, np.cumsum(by_prevalence), _PREVALENCES)
    having = prevalence[:, None] * ratio[q, v]
    either = 1.0 - prevalence[:, None] + having
    beside = np.zeros_like(background)
    for i in range(len(background)):
        mine = weight[q == i]
        beside[i] = np.log(mine @ either[q == i] / mine.sum()) if mine.sum() > 0 else 0.0
    setting = np.concatenate([np.full(1, -1, np.intp), *(_settings_of(kind) for kind in common)])[v]
    there = setting >= 0
    return Mixture(
        total - float(np.log(_PREVALENCES.size) + np.logaddexp.reduce(background.sum(axis=-1))),
        Interval(float(by_prevalence @ _PREVALENCES), float(low), float(high)),
        weight @ (having / either),
        background + beside,
        np.asarray(np.bincount(setting[there], weight[there]), np.float64),
    )


def _settings_of(kind: Common) -> NDArray[np.intp]:
    return np.full(len(kind.evidence), -1, np.intp) if kind.settings is None else kind.settings


@njit()
def _products(ratio, prevalences):
    """ln prod_i (1 - pi + pi r_i) of ratios (Q, V, N) at every prevalence (Q, V, P), less what none or one of the
    members makes, given that two or more have it."""
    count = ratio.shape[2]
    none = np.log(1.0 - prevalences)
    usual = np.exp((count - 1) * none) * (1.0 - prevalences + prevalences * count)
    found = np.empty((ratio.shape[0], ratio.shape[1], prevalences.size))
    for q in range(ratio.shape[0]):
        for v in range(ratio.shape[1]):
            total = 0.0
            for r in ratio[q, v]:
                total += r
            for p in range(prevalences.size):
                having = prevalences[p]
                log, product = 0.0, 1.0
                for r in ratio[q, v]:
                    product *= 1.0 - having + having * r
                    if not 1e-100 < product < 1e100:
                        log, product = log + np.log(product), 1.0
                log += np.log(product)
                few = (count - 1) * none[p]
                least = np.exp(min(few + np.log(1.0 - having + having * total) - log, 0.0))
                found[q, v, p] = log + np.log(max(1.0 - least, 1e-12) / (1.0 - usual[p]))
    return found


def together(
    own: Array, strengths: Sequence[Strength | None], profiles: Sequence[Profile | None]
) -> tuple[list[Common], tuple[Profile, ...]]:
    """What members may have in common: a strength, a setting, or both; and their profiles at the same settings, none
    where there is but one.

    Args:
        own: evidence with all of their own (N,).
        strengths: after refits.
        profiles: of the same effect.
    """
    known = [p for p in profiles if p is not None]
    single = all(s is not None and s.single for s in strengths)
    same = [Common(_about_the_same(own, [s for s in strengths if s is not None]))] if single else []
    if len(known) < len(profiles) or any(p.sizes.size != known[0].sizes.size for p in known):
        return same, ()
    settings = max((p.settings for p in known), key=len)
    if single and len(settings) == 1:
        return same, ()
    at = tuple(p.on(settings) for p in known)
    right = [p.reaching(float(e)) for p, e in zip(at, own, strict=True)]
    by_size, by_setting = (np.stack([getattr(p, name) for p in right], axis=-1) for name in ("by_size", "by_setting"))
    spread = _spread(by_size, known[0].sizes)
    same = same or [Common(mean(spread, axis=0).reshape(-1, own.size))]
    if len(settings) == 1:
        return same, ()
    places = np.arange(len(settings))
    both = Common(spread.reshape(-1, own.size), np.repeat(places, spread[0, ..., 0].size))
    return [*same, Common(by_setting, places), both], at


def _spread(log: Array, sizes: Array) -> Array:
    """Log evidence at sizes (S, Z, N), of sizes that are normal about each on a log scale with any of the spreads
    (S, K, Z, N)."""
    apart = np.log(np.abs(sizes)[:, None] / np.abs(sizes))
    same = np.sign(sizes)[:, None] == np.sign(sizes)
    share = same * np.exp(-0.5 * (apart / np.array(_SPREADS)[:, None, None]) ** 2)
    share /= share.sum(axis=-1, keepdims=True)
    top = log.max(axis=1, keepdims=True)
    return np.log(np.einsum("kmz,szn->skmn", share, np.exp(log - top), optimize=True) + 1e-300) + top[:, None]


def _about_the_same(own: Array, strengths: Sequence[Strength]) -> Array:
    """Members' evidence at each of the strengths and spreads that they may have in common (V, N)."""
    values, errors = np.array([s.value for s in strengths]), np.array([error_of(s) for s in strengths])
    signed, t = strengths[0].signed, values / errors
    best = own + 0.5 * t**2 - (two_sided(t) if signed else one_sided(t))
    about = _COMMON * np.median(errors)
    each = (np.concatenate([about, -about]) if signed else about)[:, None, None]
    wide = (np.array(_SPREADS)[:, None] * each) ** 2 + errors**2
    return (best - 0.5 * (np.log(wide / errors**2) + (values - each) ** 2 / wide)).reshape(-1, own.size)
