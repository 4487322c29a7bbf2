"""Noise: its size a channel, and the share that a whole sample has in common, without booking a gap as noise.

cov(r_ck, r_dk) = s_c s_d v_ck v_dk ((1 - rho) [c = d] + rho)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

Array = NDArray[np.float64]

#: Values beyond three times their median size, two standard deviations, are cut; what that takes from normal ones.
_JUMP, _CUT = 3.0, 0.957
_MOST_SHARED = 0.9
#: A value this many robust deviations from the other channels is wild; fewer channels than this cannot tell.
_WILD, _FEW = 3.5, 3


@dataclass(frozen=True)
class Noise:
    """Covariance of the residuals.

    Args:
        spread: v, relative standard deviations (C, K).
        size: s (C,).
        share: rho.
    """

    spread: Array
    size: Array
    share: float

    @cached_property
    def mixing(self) -> Array:
        """R^{-1/2} of R = (1 - rho) I + rho 11' (C, C)."""
        return inverse_root(len(self.size), np.array(self.share))

    def whiten(self, values: Array) -> Array:
        """Values (..., C, K) in units in which noise is white, flattened to (..., C K)."""
        scaled = values / (self.size[:, None] * self.spread)
        return (self.mixing @ scaled).reshape(*values.shape[:-2], values.shape[-2] * values.shape[-1])


def inverse_root(count: int, share: Array) -> Array:
    """R^{-1/2} for every share (..., C, C), by the two eigenvalues of R."""
    lone, common = 1.0 / np.sqrt(1.0 - share), 1.0 / np.sqrt(1.0 + (count - 1) * share)
    everywhere = np.full((count, count), 1.0 / count)
    return lone[..., None, None] * (np.eye(count) - everywhere) + common[..., None, None] * everywhere


def from_flexible(curves: Array, spread: Array, dictionary: Array) -> tuple[Array, Array, list[Array]]:
    """Residuals in units of v after the best non-negative mixture of a dictionary's curves.

    Args:
        curves: (C, K).
        spread: v (C, K).
        dictionary: (M, K).

    Returns:
        residuals (C, K); degrees of freedom (C,); orthonormal bases (K, active) of what was fitted, one a channel.
    """
    residuals, freedom, bases = np.empty_like(curves), np.empty(len(curves)), []
    for c, (curve, v) in enumerate(zip(curves, spread)):
        design = (dictionary / v).T
        weights, _ = nnls(design, curve / v)
        active = weights > 0
        residuals[c] = curve / v - design @ weights
        freedom[c] = max(curve.size - active.sum(), 1)
        bases.append(np.linalg.qr(design[:, active])[0] if active.any() else np.zeros((curve.size, 0)))
    return residuals, freedom, bases


def second_differences(residuals: Array) -> Array:
    """d2 / sqrt 6 of residuals (..., K), jumps cut: what is left of smooth gaps and of single steps is noise."""
    return without_jumps(np.diff(residuals, n=2, axis=-1) / np.sqrt(6.0))


def without_jumps(values: Array) -> Array:
    """Values (..., K) cut where they lie far beyond most of their own channel."""
    limit = _JUMP * np.median(np.abs(values), axis=-1, keepdims=True)
    return np.clip(values, -limit, limit) / _CUT


def common_share(residuals: Array) -> Array:
    """rho of residuals (..., C, K) in units of their size: the variance of their mean over channels against theirs."""
    count = residuals.shape[-2]
    if count == 1:
        return np.zeros(residuals.shape[:-2])
    together = (residuals.mean(axis=-2) ** 2).mean(axis=-1)
    alone = (residuals**2).mean(axis=(-2, -1))
    return np.clip((count * together / np.maximum(alone, 1e-300) - 1.0) / (count - 1.0), 0.0, _MOST_SHARED)


def outlying(residuals: Array) -> Array:
    """Factor >= 1 on the spread of values that lie far from their own sample in other channels (..., C, K).

    A single wild value is heavy-tailed noise: no effect changes one channel in one sample alone. One that a neighbour
    in time shares is not wild.
    """
    if residuals.shape[-2] < _FEW:
        return np.ones_like(residuals)
    beyond = residuals - np.median(residuals, axis=-2, keepdims=True)
    apart = np.abs(beyond)
    own = 0.5 * np.abs(residuals)  # a quiet channel is itself the median of most samples, and never apart
    usual = np.maximum(*(np.median(size, axis=-1, keepdims=True) for size in (apart, own))) / 0.6745
    jumps = np.abs(np.diff(beyond, axis=-1))
    ends = np.full((*jumps.shape[:-1], 1), np.inf)
    alone = np.minimum(np.concatenate([ends, jumps], axis=-1), np.concatenate([jumps, ends], axis=-1))
    return np.maximum(np.minimum(apart, alone) / (_WILD * np.maximum(usual, 1e-300)), 1.0)


def pooled(sizes: Array, freedom: Array) -> Array:
    """Sizes (..., C) drawn to their common value, all the more the less they differ beyond their own errors.

    ln s^2 varies by 4 / freedom about its channel's (twice what independent normal values would give: bends overlap,
    tails may be heavy), and channels differ by what is left of its variance.

    Reference: Efron B, Morris C. J Am Stat Assoc 1973;68:117-130 (sizes drawn to each other).
    """
    if sizes.shape[-1] == 1:
        return sizes
    logs = np.log(np.maximum(sizes, 1e-300) ** 2)
    error = 4.0 / freedom
    between = np.maximum(logs.var(axis=-1, ddof=1, keepdims=True) - error.mean(), 0.0)
    trust = between / (between + error)
    common = np.log(np.maximum((freedom * sizes**2).sum(axis=-1, keepdims=True) / freedom.sum(), 1e-300))
    return np.exp(0.5 * (trust * logs + (1.0 - trust) * common))


def first_floor(residuals: Array, spread: Array, flexible: tuple[Array, Array, list[Array]], least: Array) -> Noise:
    """The smaller of two floors: after the flexible fit, and from second differences of the simulator's residuals.

    Args:
        residuals: of the simulator, in units of v (C, K).
        spread: v.
        flexible: as `from_flexible` gives it.
        least: size below which the simulator's own numerical errors count (C,).
    """
    loose, freedom = without_jumps(flexible[0]), flexible[1]
    bends = second_differences(residuals)
    by_fit, by_bends = np.sqrt((loose**2).sum(axis=1) / freedom), np.sqrt((bends**2).mean(axis=1))
    which = loose if (by_fit**2).sum() <= (by_bends**2).sum() else bends
    size = pooled(by_fit if which is loose else by_bends, freedom)
    return Noise(spread, np.maximum(size, least), float(common_share(which / size[:, None])))


def lowered(noise: Noise, residuals: Array, parameters: int, least: Array) -> Noise:
    """Noise estimated again from residuals (C, K, as the data) of a fit; as it was where that is more on the whole."""
    scaled = without_jumps(residuals / noise.spread)
    freedom = max(scaled.size - parameters, scaled.size // 3) / len(scaled)
    size = np.maximum(pooled(np.sqrt((scaled**2).sum(axis=1) / freedom), np.full(len(scaled), freedom)), least)
    if np.log(size / noise.size).mean() >= 0:
        return noise
    return replace(noise, size=size, share=float(min(noise.share, common_share(scaled / size[:, None]))))
