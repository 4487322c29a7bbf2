"""Is there a gap: the scan's statistic against its own distribution under noise alone.

Draws have the noise's tails and its share in common, lose their size to a flexible fit as the data do, and pass the
same projection and the same templates, so that looking at many hypotheses costs what it should.

Reference: Anau Montel N, Alvey J, Weniger C. Phys Rev D 2025;111:083013. arXiv:2412.15100 (aggregated distortion tests)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.noise import (
    Noise,
    common_share,
    inverse_root,
    outlying,
    pooled,
    second_differences,
    without_jumps,
)

Array = NDArray[np.float64]

#: Tails lighter than these degrees of freedom of Student's t are taken as normal.
_LIGHT = 60.0


def tail_freedom(residuals: Array) -> float:
    """Degrees of freedom of Student's t from the kurtosis of residuals; infinite where tails are normal."""
    scaled = residuals / residuals.std()
    excess = float((scaled**4).mean() - 3.0) - 2.0 * np.sqrt(24.0 / residuals.size)
    return 4.0 + 6.0 / excess if excess > 0 else np.inf


def noise_draws(rng: np.random.Generator, count: int, noise: Noise, freedom: float, bases: list[Array]) -> Array:
    """Whitened draws (count, C K) of noise, their size and share estimated from themselves.

    Args:
        rng: randomness.
        count: draws.
        noise: whose sizes and share they have.
        freedom: of the tails.
        bases: what the flexible fit took from every channel (K, active).
    """
    (channels, samples), share = noise.spread.shape, noise.share
    alone = _tailed(rng, (count, channels, samples), freedom)
    common = _tailed(rng, (count, 1, samples), freedom)
    draws = np.sqrt(1.0 - share) * alone + np.sqrt(share) * common
    draws = draws / outlying(draws)
    left = np.stack([draws[:, c] - (draws[:, c] @ axes) @ axes.T for c, axes in enumerate(bases)], axis=1)
    left = without_jumps(left)
    degrees = np.array([max(samples - axes.shape[1], 1) for axes in bases], float)
    by_fit = np.sqrt((left**2).sum(axis=-1) / degrees)
    bends = second_differences(draws)
    by_bends = np.sqrt((bends**2).mean(axis=-1))
    smaller = (by_fit**2).sum(axis=-1) <= (by_bends**2).sum(axis=-1)
    size = pooled(np.where(smaller[:, None], by_fit, by_bends) * noise.size, degrees) / noise.size
    shares = np.where(smaller, common_share(left / size[..., None]), common_share(bends / size[..., None]))
    mixing = inverse_root(channels, shares)
    return np.einsum("bcd,bdk->bck", mixing, draws / size[..., None]).reshape(count, -1)


def _tailed(rng: np.random.Generator, shape: tuple[int, ...], freedom: float) -> Array:
    drawn = rng.standard_normal(shape)
    if freedom > _LIGHT:
        return drawn
    return drawn * np.sqrt((freedom - 2.0) / rng.chisquare(freedom, shape))


def p_value(observed: float, null: Array) -> float:
    """Share of draws that reach the observed statistic, itself counted."""
    return float((1 + np.count_nonzero(null >= observed)) / (1 + len(null)))
