"""Is there a gap: the scan's statistic against its own distribution under noise alone.

Draws have the noise's tails and its share in common, lose their size to a flexible fit as the data do, and pass the
same projection and the same templates, so that looking at many hypotheses costs what it should.

Reference: Anau Montel N, Alvey J, Weniger C. Phys Rev D 2025;111:083013. arXiv:2412.15100 (aggregated distortion tests)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from petkin.diagnosis.covariance import Noise, inverse_root
from petkin.diagnosis.noise import outlying, second_differences, size_and_share, without_jumps

Array = NDArray[np.float64]

#: Degrees of freedom tried for heavy tails, and the log likelihood by which they must beat normal ones; rounds in which
#: their scale settles.
_TAILS, _CLEARLY, _ROUNDS = (3.5, 5.0, 8.0), 1.0, 30


def tail_freedom(residuals: Array) -> float:
    """Degrees of freedom of Student's t, of those tried, that make residuals likeliest; infinite where normal tails do
    nearly as well."""
    squares = np.ravel(residuals) ** 2
    normal = -0.5 * squares.size * (np.log(2.0 * np.pi * squares.mean()) + 1.0)
    likelihood = {freedom: _student(squares, freedom) for freedom in _TAILS}
    best = max(likelihood, key=lambda freedom: likelihood[freedom])
    return best if likelihood[best] > normal + _CLEARLY else np.inf


def _student(squares: Array, freedom: float) -> float:
    """Log likelihood of Student's t at its likeliest scale, for squared residuals."""
    scale = max(float(np.median(squares)), 1e-300)
    for _ in range(_ROUNDS):
        scale = max(float(((freedom + 1.0) / (freedom + squares / scale) * squares).mean()), 1e-300)
    each = gammaln(0.5 * (freedom + 1.0)) - gammaln(0.5 * freedom) - 0.5 * np.log(freedom * np.pi * scale)
    return float((each - 0.5 * (freedom + 1.0) * np.log1p(squares / (freedom * scale))).sum())


def noise_draws(
    rng: np.random.Generator, count: int, noise: Noise, freedom: float, bases: list[Array], level: Array
) -> Array:
    """Whitened draws (count, C K) of noise, their size and share estimated from themselves.

    Args:
        rng: randomness.
        count: draws.
        noise: whose sizes and share they have.
        freedom: of the tails.
        bases: what the flexible fit took from every channel (K, active).
        level: typical size of the values in units of the spread (C,).
    """
    channels, samples = noise.spread.shape
    alone = _tailed(rng, (count, channels, samples), freedom)
    common = _tailed(rng, (count, 1, samples), freedom)
    draws = noise.mixed(alone, common)
    draws = draws / outlying(draws)
    left = np.stack([draws[:, c] - (draws[:, c] @ axes) @ axes.T for c, axes in enumerate(bases)], axis=1)
    left = without_jumps(left)
    degrees = np.array([max(samples - axes.shape[1], 1) for axes in bases], float)
    bends, factor = second_differences(draws), noise.load is not None
    size, shares = size_and_share(left, degrees, bends, noise.size, level, factor=factor)
    relative = (size / noise.size)[..., None]
    mixing = inverse_root(channels, shares, noise.loaded(level, size))
    white = np.einsum("bcd,bdk->bck", mixing, draws / relative).reshape(count, -1)
    return noise.settled(white + noise.erring(rng, count))


def _tailed(rng: np.random.Generator, shape: tuple[int, ...], freedom: float) -> Array:
    drawn = rng.standard_normal(shape)
    if np.isinf(freedom):
        return drawn
    return drawn * np.sqrt((freedom - 2.0) / rng.chisquare(freedom, shape))


def p_value(observed: float, null: Array) -> float:
    """Share of draws that reach the observed statistic, itself counted."""
    return float((1 + np.count_nonzero(null >= observed)) / (1 + len(null)))
