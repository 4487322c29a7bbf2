"""Members of a cohort that share a cause with some prevalence, at strengths of their own or about the same one.

    log B(e) = log int prod_i [(1 - pi) b_i + pi e_i] d pi - sum_i log b_i

with e_i the evidence of all explanations of member i that hold e, and b_i that of what it may have without. A cause's
strength is either any in each member, or about the same in all, as likely: normal about m with a spread of some share
of it, both unknown. A member whose strength is s with error d then has, of what it had averaged over strengths of its
own (B(t), see `evidence`),

    e_i exp(t^2 / 2) / B(t) N(s; m, spread^2 + d^2) / N(0; 0, d^2),    t = s / d

So what is too weak in each is told by all where their strengths agree, and a member that shows none of a cause that is
strong elsewhere does not have it weakly. Where strengths differ between channels they have nothing in common.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.evidence import one_sided, two_sided
from petkin.diagnosis.how_far import Interval
from petkin.diagnosis.verdict import Z90, Estimate, Strength

Array = NDArray[np.float64]

#: Prevalences tried, from where a cause is shared rather than chance.
_PREVALENCES = np.linspace(0.15, 0.99, 43)
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
        beside: log evidence of each member, whether it has it or not (N,): what a further cause is asked against.
    """

    log_evidence: float
    prevalence: Interval
    carriers: Array
    beside: Array


def mixture(own: Array, common: Array, background: Array) -> Mixture:
    """Of members' evidence with strengths of their own (N,), and with each of some they have in common (S, N)."""
    every = np.concatenate([own[None], common])
    share = np.full(len(every), np.log(0.5 / max(len(common), 1)))
    share[0] = np.log(0.5 if len(common) else 1.0)
    having = np.log(_PREVALENCES)[:, None] + every[:, None]
    mixed = np.logaddexp(np.log1p(-_PREVALENCES)[:, None] + background, having)
    logs = share[:, None] + (mixed - background).sum(axis=-1)
    total = float(np.logaddexp.reduce(logs, axis=None))
    weight = np.exp(logs - total)
    by_prevalence = weight.sum(axis=0)
    low, high = np.interp(_TAILS, np.cumsum(by_prevalence), _PREVALENCES)
    return Mixture(
        total - float(np.log(_PREVALENCES.size)),
        Interval(float(by_prevalence @ _PREVALENCES), float(low), float(high)),
        np.einsum("sp,spn->n", weight, np.exp(having - mixed)),
        np.logaddexp.reduce((logs - total)[..., None] + mixed, axis=(0, 1)),
    )


def about_the_same(own: Array, strengths: Sequence[Strength | None]) -> Array:
    """Members' evidence at each of the strengths and spreads that they may have in common (S, N); no rows where there
    is no such strength."""
    known = [s for s in strengths if s is not None and s.single]
    if len(known) < len(strengths):
        return np.zeros((0, own.size))
    values, errors = np.array([s.value for s in known]), np.array([error_of(s) for s in known])
    signed, t = known[0].signed, values / errors
    best = own + 0.5 * t**2 - (two_sided(t) if signed else one_sided(t))
    mean = _COMMON * np.median(errors)
    mean = np.concatenate([mean, -mean]) if signed else mean
    each = mean[:, None, None]
    wide = (np.array(_SPREADS)[:, None] * each) ** 2 + errors**2
    return (best - 0.5 * (np.log(wide / errors**2) + (values - each) ** 2 / wide)).reshape(-1, own.size)
