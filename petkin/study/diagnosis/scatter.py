"""How frame values scatter: as counts do, or more evenly. No mean changes, so no template shows it; sizes do.

A value that is expected to scatter by v does so by v^(1 - f). Second differences e of the residuals, which gaps hardly
touch, tell the flatness f by the slope of their size,

    log |e| = const_r - f log v + log |N(0, 1)|,    v^2 = (v_(k-1)^2 + 4 v_k^2 + v_(k+1)^2) / 6,

a constant a region. A slope of logarithms does not mind heavy tails. Its own bias and error come from draws of noise
that lost to a flexible fit what the residuals did.

Reference: Harvey AC. Econometrica 1976;44:461-465 (a slope of log squared residuals tells how variance goes).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtr

from petkin.diagnosis import CLAIM, Cause, Diagnosis, Estimate, Fit, Noise
from petkin.effects.noise import NOISE_VARIANCE
from petkin.study.diagnosis.regional import RegionalSimulator

Array = NDArray[np.float64]

#: Draws of noise; one-sided p-value and log evidence from which on a law is taken for wrong: rarer than other claims,
#: since a gap of the mean may also make residuals uneven.
_DRAWS, _CLAIM, _SURE = 300, 1e-3, 5.0
#: Least size of a difference, as a share of the region's median: zero has no logarithm. The largest that counts: more
#: is the jump of a gap.
_TINY, _JUMP = 1e-3, 3.0
#: Prior odds that nothing scatters otherwise, and how often no explanation is right; as of the other effects.
_PRIOR_LOG_ODDS, _LAPSE = -3.0, 0.05
_Z90 = 1.6448536269514722


@dataclass(frozen=True)
class Scatter:
    """What residuals say of the variance law.

    Args:
        flatness: f, with its standard error.
        error: of it.
        log_evidence: of an f in its plausible range against 0.
        p_value: of none.
    """

    flatness: float
    error: float
    log_evidence: float
    p_value: float

    @property
    def claimed(self) -> bool:
        """Whether the law is taken for wrong, and a flatter one that there can be for right."""
        possible = self.flatness - _Z90 * self.error <= 1.0
        return possible and self.p_value <= _CLAIM and self.log_evidence >= _SURE


#: What `base_fit` finds: the simulator's fit, the noise, and what a flexible fit took and left.
Base = tuple[Fit, Noise, list[Array], Array]


def look_at_scatter(simulator: RegionalSimulator, base: Base, *, seed: int) -> Scatter:
    """The flatness of the noise of regional curves.

    Args:
        simulator: how counts scatter.
        base: its fit to the curves.
        seed: of the draws.
    """
    fit, noise, bases, loose = base
    spread = simulator.spread(np.maximum(fit.values, 0.0))
    left = loose * noise.spread / spread
    expected = np.log(_differenced_size(spread))
    rng = np.random.default_rng((seed, 29))
    shape = (_DRAWS, *spread.shape)
    drawn = noise.mixed(rng.standard_normal(shape), rng.standard_normal((_DRAWS, 1, spread.shape[1])))
    for r, axes in enumerate(bases):
        drawn[:, r] -= (drawn[:, r] @ axes) @ axes.T
    null = _slope(drawn * spread, expected)
    error = max(float(null.std()), 1e-6)
    flatness = float(_slope(left * spread, expected) - null.mean())
    return Scatter(flatness, error, _log_evidence(flatness, error), float(ndtr(-flatness / error)))


def _differenced_size(spread: Array) -> Array:
    before, here, after = spread[:, :-2] ** 2, spread[:, 1:-1] ** 2, spread[:, 2:] ** 2
    return np.sqrt((before + 4.0 * here + after) / 6.0)


def _slope(residuals: Array, expected: Array) -> Array:
    """-f of residuals (..., R, K) whose differences are expected to have sizes of these logarithms (R, K - 2)."""
    size = np.abs(np.diff(residuals, n=2, axis=-1)) / np.exp(expected)
    usual = np.median(size, axis=-1, keepdims=True) + 1e-300
    logs = np.log(np.clip(size, _TINY * usual, _JUMP * usual))
    x = expected - expected.mean(axis=-1, keepdims=True)
    return -(x * logs).sum(axis=(-2, -1)) / max(float((x**2).sum()), 1e-300)


def _log_evidence(flatness: float, error: float) -> float:
    """log of the mean over f in [0, 1] of N(flatness; f, error^2) / N(flatness; 0, error^2)."""
    ends = -flatness / error, (1.0 - flatness) / error
    below, above = log_ndtr(ends if ends[0] < 0 else (-ends[1], -ends[0]))  # in the lower tail, where digits are left
    inside = float(above + np.log1p(-np.exp(np.minimum(below - above, -1e-12))))
    return inside + 0.5 * np.log(2.0 * np.pi) + float(np.log(error)) + 0.5 * (flatness / error) ** 2


def scattered(found: Diagnosis, scatter: Scatter) -> Diagnosis:
    """A diagnosis together with what residuals say of the variance law.

    Where the law is wrong, that is a cause of its own if there is no other gap, and stands beside every single cause
    if there is one; the diagnosis must then have been made under the law that was found.
    """
    name, stage = NOISE_VARIANCE.name, NOISE_VARIANCE.stage
    size = _estimate(scatter)
    found = replace(
        found,
        evidence=found.evidence | {name: (stage, scatter.log_evidence)},
        strengths=found.strengths | {name: size},
    )
    if not scatter.claimed:
        return found
    p = min(found.p_value, 2.0 * scatter.p_value)
    sure = (1.0 - _LAPSE) / (1.0 + float(np.exp(-_PRIOR_LOG_ODDS - scatter.log_evidence)))
    alone = Cause((name,), (stage,), sure, scatter.log_evidence, (size,))
    if not found.present:
        return replace(
            found,
            present=True,
            p_value=min(p, CLAIM),
            causes=(alone,),
            likely=(alone, *found.likely),
            chosen=(name,),
            set_probability=sure,
            unknown=1.0 - sure,
            onset=None,
            frame=None,
        )
    likely = tuple(_beside(cause, alone) for cause in found.likely)
    alike = {frozenset(_with(label) for label in pair): c for pair, c in found.alike.items()}
    chosen = tuple(_with(label) for label in found.chosen)
    return replace(found, p_value=p, causes=likely, likely=likely, alike=alike, chosen=chosen)


def _estimate(scatter: Scatter) -> Estimate:
    low, high = (scatter.flatness + sign * _Z90 * scatter.error for sign in (-1.0, 1.0))
    value, low, high = (float(np.clip(f, 0.0, 1.0)) for f in (scatter.flatness, low, high))
    return Estimate("amplitude", "1", value, low, high)


def _with(label: str) -> str:
    """A label with the noise beside it; a pair stays as it is: a third cause has no place."""
    return label if "+" in label else "+".join(sorted((label, NOISE_VARIANCE.name)))


def _beside(cause: Cause, alone: Cause) -> Cause:
    if len(cause.effects) > 1:
        return cause
    one, two = sorted((cause, alone), key=lambda c: c.label)
    return replace(
        cause,
        effects=(*one.effects, *two.effects),
        stages=(*one.stages, *two.stages),
        log_evidence=cause.log_evidence + alone.log_evidence,
        estimates=(*one.estimates, *two.estimates),
    )
