"""How far the gap shrinks: closure by held-out deviance, cross-fitted over samples and channels.

    closure = G / (G + L),   G = D_without - D_with,   L = D_with - D_floor,
    D = sum_b |(I - H_bb)^{-1} r_b|^2,   D_floor = sum_b tr (I - H_bb)^{-1}

with H the hat matrix of a fit: (I - H_bb)^{-1} r_b is, to first order, the residual of block b in a fit that never saw
it, and the trace is what it would be for the true mean: noise and the cost of the fitted parameters.

G is the difference of two sums that share their noise; L is not, and its error is as large as a weak gap, more where
noise has tails. So L is known beforehand as well: should an explanation H be true, this one leaves what its own refit
leaves of the difference to H, and a little that no fit takes; should no name be true, it may leave a visible gap. The
value is the median of closure, and the interval holds 0.9 of it, over all explanations by their probability and by what
their L makes of the held-out deviance beside that of draws of noise, whose size was found as that of the data was.
Nothing is 1 by construction: a sure name still leaves a little.

Reference: Cook RD, Weisberg S. Residuals and influence in regression. Chapman and Hall 1982.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.refit import Fit

Array = NDArray[np.float64]

#: Directions that a block determines alone are held to this much of their residual.
_LEAST = 0.4
#: What a true name leaves (d'^2): median and spread of the logarithm; mean of what no name may leave. Set on training
#: scans.
_LITTLE, _MUCH = (0.7, 1.8), 30.0
#: A claimed gap is at least this large (d'^2).
_CLAIMED = 9.0
_P = (np.arange(60) + 0.5) / 60
_LITTLE_LEFT, _MUCH_LEFT = _LITTLE[0] * np.exp(_LITTLE[1] * ndtri(_P)), -_MUCH * np.log(_P)
_SHARES = (0.08, 0.5, 0.98)
#: Width of a draw's share in the density of all, in their standard deviations, times the fifth root of their number.
_SMOOTH = 1.06


@dataclass(frozen=True)
class Interval:
    """A value and its 90 % interval."""

    value: float
    low: float
    high: float


def held_out(fit: Fit, shape: tuple[int, int]) -> tuple[float, float]:
    """Held-out deviance and its floor.

    What is left out at once is another sample in every channel, so that the rest still tells what channels share from
    their neighbours, and what is a channel's own from its other samples.

    Args:
        fit: the fit; its whitened rows run over channels, then samples.
        shape: channels, samples.
    """
    lever = Projection.of_fit(fit).axes[: fit.residual.size]
    fold = ((np.arange(shape[1]) + np.arange(shape[0])[:, None]) % shape[1]).ravel()
    rows = np.argsort(fold, kind="stable").reshape(shape[1], shape[0])
    size, axes = np.linalg.eigh(np.eye(shape[0]) - lever[rows] @ lever[rows].transpose(0, 2, 1))
    size = np.maximum(size, _LEAST)
    turned = (axes.transpose(0, 2, 1) @ fit.residual[rows][..., None])[..., 0]
    return float(((turned / size) ** 2).sum()), float((1.0 / size).sum())


def closure(
    without: Fit, with_it: Fit, shape: tuple[int, int], others: Sequence[tuple[float, Array]], noise: Array
) -> Interval:
    """Share of the gap that goes, with a 90 % interval.

    Args:
        without, with_it: the simulator's own fit, and the one with the explanation.
        shape: channels, samples.
        others: of every explanation, this one among them: its probability, and the whitened values that it predicts
            beyond those of this one (n,). What is missing to 1 is the probability of none.
        noise: chi-square of draws of noise over what it is expected to be (b,).
    """
    (before, low_before), (after, low_after) = held_out(without, shape), held_out(with_it, shape)
    projection = Projection.of_fit(with_it)
    left = projection.norms(np.stack([beyond for _, beyond in others], axis=1)) ** 2
    probability = np.array([p for p, _ in others])
    unseen = np.concatenate([*(once + _LITTLE_LEFT for once in left), _MUCH_LEFT])
    known = np.repeat(np.append(probability, max(1.0 - probability.sum(), 0.0)), _P.size)
    beside = ((after - unseen) / low_after)[:, None] - noise
    weight = known * np.exp(-0.5 * (beside / (_SMOOTH * len(noise) ** -0.2 * noise.std())) ** 2).mean(axis=1)
    weight = weight / weight.sum() if weight.sum() > 0 else known / known.sum()
    gone = max(before - low_before - (after - low_after), _CLAIMED)
    closed = gone / (gone + unseen)
    order = np.argsort(closed)
    low, value, high = (float(c) for c in np.interp(_SHARES, np.cumsum(weight[order]), closed[order]))
    return Interval(value, low, high)
