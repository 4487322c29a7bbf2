"""The law by which frame values scatter, as the scans of one study tell it together.

One scan seldom tells its law well; scans of one scanner and one reconstruction have about the same. With d_i what the
slopes of scan i say of its exponents' departures from counts, and C_i how that errs,

    d_i ~ N(m, C_i + t^2 I),    m ~ N(0, 1),    t one of a few spreads between scans,

against m = 0, t = 0 of counts. Where one is far likelier than the other, each scan has the law that all tell of it, as
surely as they do; else every scan is asked alone.

Reference: DerSimonian R, Laird N. Control Clin Trials 1986;7:177-188 (effects that vary between studies).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from petkin.study.diagnosis.noise_law import COUNTS, NoiseLaw
from petkin.study.diagnosis.scatter import PRIOR_SD, SURE, Scatter

Array = NDArray[np.float64]

#: Spreads of the exponents between scans, any as likely beforehand.
_SPREADS = (0.0, 0.15, 0.3, 0.6)
#: Information of an exponent that a scan says nothing of.
_LITTLE = 1e-6


@dataclass(frozen=True)
class SharedLaw:
    """What all scans say of the law of one.

    Args:
        law: that of the scan.
        errors: standard deviations of its exponents, one after another (m, 3); none of counts.
        flatter: whether it is one that is more even than that of counts, and no other.
        scans: how many say so.
    """

    law: NoiseLaw
    errors: Array
    flatter: bool
    scans: int

    def __str__(self) -> str:
        return f"as {self.scans} scans tell together"


def of_all(laws: Sequence[SharedLaw | None]) -> str:
    """How the noise of several scans goes, in words; where it varies between them, their mean law."""
    told = [one for one in laws if one is not None]
    if not told:
        return "These scans do not tell together how their noise goes with value, time and frame: each is asked alone."
    mean = NoiseLaw(*map(float, np.array([one.law for one in told]).mean(axis=0)))
    return f"Noise {told[0]}: {mean}."


def shared_law(looks: Sequence[Scatter]) -> tuple[SharedLaw, ...] | None:
    """The law of every scan as all of them tell it, in their order; None where they do not tell counts from others.

    Args:
        looks: what every scan says by itself.
    """
    told = [look.exponents for look in looks]
    errs = np.asarray(
        np.linalg.inv(np.stack([one.information for one in told]) + _LITTLE * np.eye(len(COUNTS))), np.float64
    )
    apart = np.einsum("nij,nj->ni", errs, np.stack([one.score for one in told]))
    means = [_mean(apart, errs, spread) for spread in _SPREADS]
    counts = _log_normal(apart, errs)
    evidence = float(logsumexp([mean.log_evidence for mean in means]) - np.log(len(_SPREADS)) - counts)
    if abs(evidence) < SURE:
        return None
    if evidence < 0.0:
        return (SharedLaw(COUNTS, np.zeros((0, len(COUNTS))), False, len(looks)),) * len(looks)
    best = max(range(len(means)), key=lambda i: means[i].log_evidence)
    all_alike = Scatter.of(sum(told[1:], told[0]), evidence)
    return tuple(
        SharedLaw(*means[best].of_one(one, err, _SPREADS[best]), all_alike.claimed, len(looks))
        for one, err in zip(apart, errs, strict=True)
    )


@dataclass(frozen=True)
class _Mean:
    """The mean law of all scans: departures of its exponents, their covariance, and log evidence of the spread."""

    apart: Array
    covariance: Array
    log_evidence: float

    def of_one(self, apart: Array, error: Array, spread: float) -> tuple[NoiseLaw, Array]:
        """The law of one scan with its deviations, from what it says itself and what all say."""
        own = spread**2 * np.linalg.inv(error + spread**2 * np.eye(len(apart)))
        rest = np.eye(len(apart)) - own
        covariance = spread**2 * rest + rest @ self.covariance @ rest.T
        law = np.add(COUNTS, own @ apart + rest @ self.apart)
        return NoiseLaw(*map(float, law)), np.asarray(np.linalg.cholesky(covariance).T, np.float64)


def _mean(apart: Array, errs: Array, spread: float) -> _Mean:
    varies = errs + spread**2 * np.eye(apart.shape[1])
    weights = np.linalg.inv(varies)
    precision = weights.sum(axis=0) + np.eye(apart.shape[1]) / PRIOR_SD**2
    score = np.einsum("nij,nj->i", weights, apart)
    mean = np.linalg.solve(precision, score)
    occam = np.linalg.slogdet(PRIOR_SD**2 * precision)[1]
    return _Mean(mean, np.linalg.inv(precision), _log_normal(apart, varies) + float(0.5 * score @ mean - 0.5 * occam))


def _log_normal(apart: Array, varies: Array) -> float:
    """Log density of departures about nought, but for what it has whatever the covariance."""
    squares = np.einsum("ni,nij,nj->", apart, np.linalg.inv(varies), apart)
    return float(-0.5 * (squares + np.linalg.slogdet(varies)[1].sum()))
