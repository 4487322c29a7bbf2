"""Noise estimated: its sizes and the share that a whole sample has in common, without booking a gap as noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from petkin.diagnosis.covariance import MOST_SHARED, Noise, common_axis, loads

Array = NDArray[np.float64]

#: Values beyond three times their median size, two standard deviations, are cut; what that takes from normal ones.
_JUMP, _CUT = 3.0, 0.957
#: The largest share where what samples have in common is a factor of values, which gains of all channels are too.
_MOST_FACTOR = 0.6
#: The flexible fit tells the noise unless second differences leave this much less of it: they are the rougher measure.
_SMALLER = 1.2
#: Variance of ln s^2 times its degrees of freedom: 2 of independent normal values, more since tails may be heavy.
_SCATTER = 3.0
#: Share of second differences that counts as degrees of freedom, 1 / (1 + 2 sum r^2): neighbours correlate by -2/3 and
#: 1/6. Reference: Bartlett MS. J R Stat Soc 1935;98:536-543.
_FREE = 1.0 / (1.0 + 2.0 * ((2.0 / 3.0) ** 2 + (1.0 / 6.0) ** 2))
#: Variance of ln s^2 between channels before any data, and as that of how many channels it counts: their noise differs
#: by a fifth, as where regions are of several volumes.
_UNLIKE, _CHANNELS = 0.16, 4.0
#: A value this many robust deviations from the other channels is wild; fewer channels than this cannot tell.
_WILD, _FEW = 3.5, 3


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


def medians(values: Array) -> Array:
    """Of the last axis (..., 1), as `np.median` has them of finite values, five times as fast where rows are short."""
    ordered, count = np.sort(values, axis=-1), values.shape[-1]
    return 0.5 * (ordered[..., (count - 1) // 2, None] + ordered[..., count // 2, None])


def without_jumps(values: Array) -> Array:
    """Values (..., K) cut where they lie far beyond most of their own channel."""
    limit = _JUMP * medians(np.abs(values))
    return np.clip(values, -limit, limit) / _CUT


def common_share(residuals: Array) -> Array:
    """rho of residuals (..., C, K) in units of their size: the variance of their mean over channels against theirs."""
    count = residuals.shape[-2]
    if count == 1:
        return np.zeros(residuals.shape[:-2])
    together = (residuals.mean(axis=-2) ** 2).mean(axis=-1)
    alone = (residuals**2).mean(axis=(-2, -1))
    return np.clip((count * together / np.maximum(alone, 1e-300) - 1.0) / (count - 1.0), 0.0, MOST_SHARED)


def with_factor(residuals: Array, freedom: float, load: Array) -> tuple[Array, Array]:
    """Size of what is each channel's own (...), and rho of a factor (...), of residuals (..., C, K) of one own size.

    Across u every sample has the variance s^2, along it s^2 (1 + kappa |u|^2); both are the likeliest of normal values.

    Args:
        residuals: in units of v.
        freedom: degrees of freedom of a channel.
        load: u (C, K).

    Reference: Tipping ME, Bishop CM. J R Stat Soc B 1999;61:611-622 (a factor beside equal noise; here u is known).
    """
    count = residuals.shape[-2]
    squares = (residuals**2).sum(axis=(-2, -1))
    if count == 1:
        return np.sqrt(squares / freedom), np.zeros(residuals.shape[:-2])
    axis = common_axis(count, load)
    along = ((residuals * axis).sum(axis=-2) ** 2).sum(axis=-1)
    own = np.maximum(np.minimum((squares - along) / (count - 1.0), squares / count), 1e-300)
    kappa = np.maximum(along / own - 1.0, 0.0) / count
    return np.sqrt(own / freedom), np.minimum(kappa / (1.0 + kappa), _MOST_FACTOR)


def outlying(residuals: Array) -> Array:
    """Factor >= 1 on the spread of values that lie far from their own sample in other channels (..., C, K).

    A single wild value is heavy-tailed noise: no effect changes one channel in one sample alone. One that a neighbour
    in time shares is not wild.
    """
    if residuals.shape[-2] < _FEW:
        return np.ones_like(residuals)
    beyond = residuals - medians(residuals.swapaxes(-1, -2)).swapaxes(-1, -2)
    apart = np.abs(beyond)
    own = 0.5 * np.abs(residuals)  # a quiet channel is itself the median of most samples, and never apart
    usual = np.maximum(*map(medians, (apart, own))) / 0.6745
    jumps = np.abs(np.diff(beyond, axis=-1))
    ends = np.full((*jumps.shape[:-1], 1), np.inf)
    alone = np.minimum(np.concatenate([ends, jumps], axis=-1), np.concatenate([jumps, ends], axis=-1))
    return np.maximum(np.minimum(apart, alone) / (_WILD * np.maximum(usual, 1e-300)), 1.0)


def levels(values: Array, spread: Array) -> Array:
    """Size of values in units of v (C, K), above 0."""
    found = np.abs(values) / spread
    return np.asarray(np.maximum(found, 1e-12 * max(float(found.max()), 1e-300)), np.float64)


def pooled(sizes: Array, freedom: Array, level: Array) -> tuple[Array, Array]:
    """Sizes (..., C) drawn to what is common to them, all the more the less they differ beyond their own errors.

    That is one size in units of v or one share of the channels' values, whichever they differ less from. ln s^2 varies
    by _SCATTER / freedom about its channel's, and channels differ by what is left of its variance, with a prior.

    Args:
        sizes: each channel's own.
        freedom: degrees of freedom (..., C).
        level: size of the values in units of v (C, K), which counts as it is in the later half of the samples.

    Returns:
        the sizes; standard deviations of ln s, with what is common to them known.

    Reference: Efron B, Morris C. J Am Stat Assoc 1973;68:117-130 (sizes drawn to each other).
    """
    error = _SCATTER / freedom
    if sizes.shape[-1] == 1:
        return sizes, 0.5 * np.sqrt(error)
    own = np.log(np.maximum(sizes, 1e-300) ** 2)
    level = np.median(level[:, level.shape[1] // 2 :], axis=1)
    each = own[..., None, :] - np.stack([np.zeros_like(level), 2.0 * np.log(level)])
    nearest = each.var(axis=-1).argmin(axis=-1)[..., None, None]
    logs = np.take_along_axis(each, nearest, axis=-2)[..., 0, :]
    others = sizes.shape[-1] - 1.0
    found = np.maximum(logs.var(axis=-1, ddof=1, keepdims=True) - error.mean(axis=-1, keepdims=True), 0.0)
    between = (others * found + _CHANNELS * _UNLIKE) / (others + _CHANNELS)
    trust, weight = between / (between + error), 1.0 / (between + error)
    common = (weight * logs).sum(axis=-1, keepdims=True) / weight.sum(axis=-1, keepdims=True)
    return np.exp(0.5 * (own + (1.0 - trust) * (common - logs))), 0.5 * np.sqrt(trust * error)


def size_and_share(
    loose: Array, freedom: Array, bends: Array, scale: Array, level: Array, load: Array | None
) -> tuple[Array, Array, Array]:
    """Size of the noise (..., C), its share in common (...) and how unsure ln s is (..., C).

    From a flexible fit or from second differences.

    Args:
        loose: what the flexible fit left, jumps cut (..., C, K).
        freedom: its degrees of freedom (C,).
        bends: second differences of the simulator's residuals (..., C, K - 2).
        scale: of both, in units of v (C,).
        level: size of the values in units of v (C, K).
        load: u (C, K) where what samples have in common is a factor of values.
    """
    by_fit, by_bends = np.sqrt((loose**2).sum(axis=-1) / freedom), np.sqrt((bends**2).mean(axis=-1))
    fitted = (by_fit**2).sum(axis=-1) <= _SMALLER * (by_bends**2).sum(axis=-1)
    if load is not None:
        told = with_factor(loose, float(freedom.mean()), load)
        size, share = np.where(fitted, told, with_factor(bends, bends.shape[-1], load[:, 1:-1]))
        return size[..., None] * scale, share, 0.5 * np.sqrt(_SCATTER / freedom / len(freedom))
    free = np.where(fitted[..., None], freedom, _FREE * bends.shape[-1])
    size, doubt = pooled(np.where(fitted[..., None], by_fit, by_bends) * scale, free, level)
    relative = (size / scale)[..., None]
    return size, np.where(fitted, common_share(loose / relative), common_share(bends / relative)), doubt


def first_floor(
    residuals: Array,
    spread: Array,
    flexible: tuple[Array, Array, list[Array]],
    level: Array,
    least: Array,
    *,
    factor: bool = False,
) -> Noise:
    """The noise after the flexible fit or, where they leave clearly less, from second differences.

    Args:
        residuals: of the simulator, in units of v (C, K).
        spread: v.
        flexible: as `from_flexible` gives it.
        level: size of the values in units of v (C, K).
        least: size below which the simulator's own numerical errors count (C,).
        factor: whether what a sample has in common is a factor of its values.
    """
    loose, freedom, bends = without_jumps(flexible[0]), flexible[1], second_differences(residuals)
    load = loads(level) if factor else None
    size, share, doubt = size_and_share(loose, freedom, bends, np.ones(len(spread)), level, load)
    return Noise(spread, np.maximum(size, least), float(share), load, doubt=doubt)


def lowered(noise: Noise, residuals: Array, parameters: int, level: Array, least: Array) -> Noise:
    """Noise estimated again from residuals (C, K, as the data) of a fit; as it was where that is more on the whole."""
    scaled = without_jumps(residuals / noise.spread)
    freedom = max(scaled.size - parameters, scaled.size // 3) / len(scaled)
    load, even = None if noise.load is None else loads(level), np.ones(len(scaled))
    if load is None:
        size, _ = pooled(np.sqrt((scaled**2).sum(axis=1) / freedom), freedom * even, level)
        share = common_share(scaled / np.maximum(size, least)[:, None])
    else:
        own, share = with_factor(scaled, freedom, load)
        size = own * even
    size = np.maximum(size, least)
    if np.log(size / noise.size).mean() >= 0:
        return noise
    return replace(noise, size=size, share=float(min(noise.share, share)), load=load)
