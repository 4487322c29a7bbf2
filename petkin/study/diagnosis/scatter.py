"""How frame values scatter: as counts do, with one size, with a percentage of the value, or by any law like these. No
mean changes, so no template shows it; sizes do.

    sd_rk^2 ~ value^a e^{b lambda t} / duration^c,    a = b = c = 1 of counts

Second differences e of the residuals, which gaps hardly touch, tell the exponents by the slopes of their sizes over
frames, within regions,

    1/2 ln(min(e^2 / s^2, m^2) + 1/2),    s^2 = (sd_(k-1)^2 + 4 sd_k^2 + sd_(k+1)^2) / 6,

s in the usual size of the region. The 1/2 keeps those that chance to be near 0 from counting most, m the jumps of gaps
from counting much. What slopes are without any departure from the law, how they err and how they follow the exponents
comes from draws of noise that lost to a flexible fit what the residuals did. As much as whole frames scatter more than
those of draws, slopes err more. Exponents have a prior, the slopes are taken again under the law that they tell, and so
on until they tell no other.

Reference: Harvey AC. Econometrica 1976;44:461-465 (slopes of log squared residuals tell how variance goes).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, log_ndtr, ndtr

from petkin.diagnosis import Z90, Base, Fit, medians
from petkin.study.diagnosis.noise_law import COUNTS, NoiseLaw, contrasts, terms
from petkin.study.diagnosis.regional import RegionalSimulator

Array = NDArray[np.float64]

#: Draws of noise, rounds in which the law settles, and the largest change of an exponent in one.
_DRAWS, _ROUNDS, _STRIDE = 200, 4, 0.7
#: A departure of an exponent by which slopes are followed; what it is expected to be.
_STEP, PRIOR_SD = 0.1, 1.0
#: Size of differences, in their variance, below which they count as near 0, and beyond which as a jump.
_SOFT, _JUMP = 0.5, 4.1
#: Square of the median of normal values, in their variance.
_MEDIAN = 0.455
#: Prior log odds of the law of counts against another. At 4 to 1 noise that is not that of counts seldom makes a claim
#: (4 of 120 twins of real scans instead of 33), and 102 of 108 claims of training gaps of d' 4 to 8 stay.
_COUNTS_LOG_ODDS = float(np.log(4.0))
#: One-sided p-value and log evidence from which on a more even scatter is told, where no other law is likelier: rarer
#: than other claims, since a gap of the mean may also make residuals uneven.
_CLAIM, SURE = 1e-3, 5.0
#: Share of a flatness that voxels show where it is one: of four false claims beside gaps of training images they showed
#: 0.2 to 0.4, of what `noise_variance` makes 0.9.
_AS_VOXELS = 0.5
#: What a flatness of 1 takes from every exponent.
_FLAT = np.subtract(NoiseLaw(0.0, 0.0, 0.0), COUNTS)


@dataclass(frozen=True)
class Exponents:
    """What slopes say of exponents' departures from counts: their information, and its product with the estimate."""

    information: Array
    score: Array

    def __add__(self, other: Exponents) -> Exponents:
        """What both say of one law."""
        return Exponents(self.information + other.information, self.score + other.score)

    def __rmul__(self, share: float) -> Exponents:
        """What is said with a share of the confidence."""
        return Exponents(share * self.information, share * self.score)

    @property
    def _posterior(self) -> Array:
        return self.information + np.eye(len(self.score)) / PRIOR_SD**2

    @property
    def likeliest(self) -> Array:
        return np.asarray(np.linalg.solve(self._posterior, self.score), np.float64)

    @property
    def deviations(self) -> Array:
        """Standard deviations of what they may be, one after another (3, 3)."""
        return np.asarray(np.linalg.cholesky(np.linalg.inv(self._posterior)).T, np.float64)

    @property
    def log_evidence(self) -> float:
        """Of any departures under their prior against none."""
        occam = np.linalg.slogdet(PRIOR_SD**2 * self._posterior)[1]
        return float(0.5 * self.score @ self.likeliest - 0.5 * occam)

    def along(self, direction: Array) -> tuple[float, float]:
        """How far, and with which error, where departures lie along a direction."""
        error = 1.0 / np.sqrt(max(float(direction @ self.information @ direction), 1e-12))
        return float(direction @ self.score) * float(error) ** 2, float(error)


@dataclass(frozen=True)
class Scatter:
    """What residuals say of the variance law.

    Args:
        law: the likeliest, under a prior about that of counts.
        general: log evidence of any law against that of counts.
        flatness: f of a law that is (1 - f) times that of counts, with its standard error.
        error: of it.
        log_evidence: of an f in its plausible range against 0.
        p_value: of none.
        exponents: what slopes say of the law's exponents; nothing unless given.
    """

    law: NoiseLaw
    general: float
    flatness: float
    error: float
    log_evidence: float
    p_value: float
    exponents: Exponents = field(default_factory=lambda: Exponents(np.zeros((3, 3)), np.zeros(3)))

    @classmethod
    def of(cls, told: Exponents, general: float | None = None) -> Scatter:
        """What slopes say, in evidence; `general` where more than these slopes is in it."""
        flatness, error = told.along(_FLAT)
        return cls(
            law=NoiseLaw(*map(float, np.add(COUNTS, told.likeliest))),
            general=told.log_evidence if general is None else general,
            flatness=flatness,
            error=error,
            log_evidence=_log_evidence(flatness, error),
            p_value=float(ndtr(-flatness / error)),
            exponents=told,
        )

    @property
    def errors(self) -> Array:
        """Standard deviations of what the law's exponents may be, one after another (3, 3)."""
        return self.exponents.deviations

    @property
    def claimed(self) -> bool:
        """Whether the law is taken for wrong, and a flatter one that there can be for right."""
        possible = self.flatness - Z90 * self.error <= 1.0
        sure = self.p_value <= _CLAIM and self.log_evidence >= SURE
        return possible and sure and self.log_evidence >= self.general

    @property
    def otherwise(self) -> bool:
        """Whether values are taken to scatter by another law than counts."""
        return self.odds >= 0.5

    @property
    def odds(self) -> float:
        """Probability of another law than that of counts, of any or of a flatter one."""
        either = np.logaddexp(self.general, self.log_evidence) - np.log(2.0)
        return float(expit(either - _COUNTS_LOG_ODDS))


def look_at_scatter(simulator: RegionalSimulator, base: Base, *, seed: int) -> Scatter:
    """The law by which regional curves scatter.

    Args:
        simulator: how counts scatter.
        base: its fit to the curves.
        seed: of the draws.
    """
    fit, noise, bases, loose = base
    values = np.maximum(fit.values, 0.0)
    each = terms(values, simulator.clock)
    rng = np.random.default_rng((seed, 29))
    shape = (_DRAWS, *values.shape)
    drawn = noise.mixed(rng.standard_normal(shape), rng.standard_normal((_DRAWS, 1, values.shape[1])))
    for r, axes in enumerate(bases):
        drawn[:, r] -= (drawn[:, r] @ axes) @ axes.T
    left = loose * simulator.spread(values)

    def told(apart: Array) -> Exponents:
        spread = replace(simulator, law=NoiseLaw(*np.add(COUNTS, apart))).spread(values)
        information, score = _told(left, drawn * spread, spread, each)
        return Exponents(information, score + information @ apart)

    apart = np.zeros(len(COUNTS))
    found = told(apart)
    for _ in range(_ROUNDS):
        apart = apart + np.clip(found.likeliest - apart, -_STRIDE, _STRIDE)
        found = told(apart)
    return replace(Scatter.of(found), law=NoiseLaw(*map(float, np.add(COUNTS, apart))))


def as_voxels_scatter(scatter: Scatter, simulator: RegionalSimulator, fit: Fit, by_frame: Array) -> Scatter:
    """What residuals of regions say of a flatter law, if voxels scatter by half of it at least: they know of no gap in
    a region's mean.

        ln(sd by voxels / sd of counts) = -f x,   x the sum of what exponents multiply in ln sd

    with f by least squares over frames, within regions.

    Args:
        scatter: what residuals say.
        simulator: under the law that was taken.
        fit: of it to the regions' means.
        by_frame: noise of the voxels in units of the simulator's (R, K).
    """
    values = np.maximum(fit.values, 0.0)
    counted = replace(simulator, law=COUNTS).spread(values)
    both = np.stack(
        [contrasts(values, simulator.clock).sum(axis=0), np.log(simulator.spread(values) * by_frame / counted)]
    )
    x, seen = both - both.mean(axis=-1, keepdims=True)
    flatness = -float((seen * x).sum() / (x * x).sum())
    if flatness >= _AS_VOXELS * scatter.flatness:
        return scatter
    return replace(scatter, log_evidence=min(scatter.log_evidence, 0.0), p_value=1.0)


def evidence_without_gap(simulator: RegionalSimulator, fit: Fit) -> float:
    """Log evidence of any other law against that of counts if nothing but noise is in the residuals, gaps included.

    Of whitened residuals z all that a law could explain, in place of any cause: with x what the exponents' departures d
    multiply in ln sd, less the region's mean, and d as above beforehand,

        ln int N(d; 0, 1) exp(sum 1/2 z^2 (1 - e^{-2 d x})) dd,   by Laplace's approximation.

    Args:
        simulator: how counts scatter.
        fit: of it, without any cause.

    Reference: Kass RE, Raftery AE. J Am Stat Assoc 1995;90:773-795 (Laplace's approximation of evidence).
    """
    each = contrasts(np.maximum(fit.values, 0.0), simulator.clock)
    x = (each - each.mean(axis=-1, keepdims=True)).reshape(len(COUNTS), -1)
    squares = fit.residual**2

    def less(apart: Array) -> tuple[float, Array]:
        left = squares * np.exp(np.clip(-2.0 * apart @ x, -50.0, 50.0))
        value = 0.5 * (left - squares).sum() + 0.5 * apart @ apart / PRIOR_SD**2
        return float(value), -x @ left + apart / PRIOR_SD**2

    best = minimize(less, np.zeros(len(COUNTS)), jac=True, method="BFGS")
    occam = np.linalg.slogdet(np.eye(len(COUNTS)) + 2.0 * PRIOR_SD**2 * x @ x.T)[1]
    return float(-best.fun - 0.5 * occam)


def _told(left: Array, drawn: Array, spread: Array, each: Array) -> tuple[Array, Array]:
    """Information of the exponents' departures from the law of a spread (R, K), and its product with their estimate.

    Args:
        left: residuals (R, K).
        drawn: of noise with that spread (n, R, K).
        spread: sd by region and frame.
        each: what exponents multiply in its logarithm (3, R, K).
    """
    variance = _differenced(spread**2)
    x = _differenced(spread**2 * each) / variance
    x -= x.mean(axis=-1, keepdims=True)

    def slopes(logs: Array) -> Array:
        return np.einsum("tri,...ri->...t", x, logs)

    seen, null = _logs(left, variance), _logs(drawn, variance)
    bent = [[slopes(_logs(drawn * np.exp(sign * _STEP * t), variance)).mean(axis=0) for sign in (1, -1)] for t in each]
    follows = np.stack([(up - down) / (2.0 * _STEP) for up, down in bent], axis=1)
    drawn_slopes = slopes(null)
    error = np.cov(drawn_slopes.T) + _of_frames(seen, null, x) + 1e-9 * np.eye(len(each))
    weighed = np.asarray(np.linalg.solve(error, follows).T, np.float64)
    return weighed @ follows, weighed @ (slopes(seen) - drawn_slopes.mean(axis=0))


def _of_frames(seen: Array, null: Array, x: Array) -> Array:
    """Covariance (3, 3) of slopes by how much more whole frames scatter than draws: a jump is in all regions."""
    apart, usual = (seen - null.mean(axis=0)).mean(axis=-2), null.mean(axis=-2).var(axis=0).mean()
    more = max(float((apart**2).mean() - usual), 0.0)
    lag = np.abs(np.subtract.outer(np.arange(x.shape[-1]), np.arange(x.shape[-1])))
    together = x.sum(axis=1)
    return np.asarray(more * together @ np.maximum(1.0 - lag / 3.0, 0.0) @ together.T)


def _logs(residuals: Array, variance: Array) -> Array:
    """Sizes of differences of residuals (..., R, K - 2) as the top of the page has them, less their region's mean."""
    squares = np.diff(residuals, n=2, axis=-1) ** 2 / variance
    usual = medians(squares) / _MEDIAN + 1e-300
    logs = 0.5 * np.log(np.minimum(squares / usual, _JUMP) + _SOFT)
    return np.asarray(logs - logs.mean(axis=-1, keepdims=True))


def _differenced(values: Array) -> Array:
    """Of what adds up in quadrature: that of second differences, of unit size where it is even."""
    return (values[..., :-2] + 4.0 * values[..., 1:-1] + values[..., 2:]) / 6.0


def _log_evidence(flatness: float, error: float) -> float:
    """log of the mean over f in [0, 1] of N(flatness; f, error^2) / N(flatness; 0, error^2)."""
    ends = -flatness / error, (1.0 - flatness) / error
    below, above = log_ndtr(ends if ends[0] < 0 else (-ends[1], -ends[0]))  # in the lower tail, where digits are left
    inside = float(above + np.log1p(-np.exp(np.minimum(below - above, -1e-12))))
    return inside + 0.5 * np.log(2.0 * np.pi) + float(np.log(error)) + 0.5 * (flatness / error) ** 2
