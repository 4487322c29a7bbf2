"""Is there a gap: the evidence of all hypotheses together against its own distribution under noise alone.

What one hypothesis makes of noise is no matter of the others: each counts by what it has beyond what noise seldom gives
it. Where tails may be heavy and few channels are there to deny it, a wild value looks like one wrong sample, and would
else raise the bar for every hypothesis.

Draws have the noise's tails and its share in common, lose their size to a flexible fit as the data do, and pass the
same projection and the same templates, so that looking at many hypotheses costs what it should.

Reference: Anau Montel N, Alvey J, Weniger C. Phys Rev D 2025;111:083013. arXiv:2412.15100 (aggregated distortion tests)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from petkin.diagnosis import evidence
from petkin.diagnosis.covariance import Noise, across, inverse_root
from petkin.diagnosis.noise import outlying, second_differences, size_and_share, without_jumps

Array = NDArray[np.float64]

#: The p-value up to which a gap is claimed: of 308 training scans of noise alone 0.026 lie below it, 0.039 below 0.05.
CLAIM = 0.03
#: Degrees of freedom that tails may have, infinite for normal ones; rounds in which their scale settles, and in which
#: wild values are found, as often as those of the data.
_TAILS, _ROUNDS, _LOOKS = (np.inf, 8.0, 5.0, 3.5), 30, 2
#: Share of draws that give a hypothesis no more than it is denied, if that speaks for it at all: fewer exceed it than a
#: claim takes.
_SELDOM = 0.985


@dataclass(frozen=True)
class AgainstNoise:
    """What speaks for a gap, against what speaks for one in noise.

    Args:
        names: of the hypotheses; "" of a smooth discrepancy.
        found: log evidence of each for the data (H,).
        drawn: the same for draws of noise (n, H).
        times: what a p-value of it counts, where evidence is found in noise more often than in draws.
    """

    names: tuple[str, ...]
    found: Array
    drawn: Array
    times: float = 1.0

    @property
    def p_value(self) -> float:
        """Of no gap."""
        return p_value(float(statistic(self.found, self.drawn)), statistic(self.drawn, self.drawn))

    @property
    def p_values(self) -> Array:
        """Of every draw among all (n,)."""
        own = statistic(self.drawn, self.drawn)
        return reached(own) / len(own)

    def witnessed(self, told: Mapping[str, Array], rng: np.random.Generator, *, times: float) -> AgainstNoise:
        """With what a witness of other data says: added to the evidence of its own hypotheses, beside them of others.

        Args:
            told: log evidence for the data, then for draws of the witness's own noise (1 + m,), by hypothesis.
            rng: which of those draws goes with which of its own.
            times: what a p-value counts then.
        """
        if not told:
            return self
        names = (*self.names, *(name for name in told if name not in self.names))
        every = self.of(names)
        which = np.append(0, 1 + rng.integers(len(next(iter(told.values()))) - 1, size=len(self.drawn)))
        for name, logs in told.items():
            every[:, names.index(name)] += logs[which]
        return AgainstNoise(names, every[0], every[1:], times)

    def of(self, names: Sequence[str]) -> Array:
        """Log evidence of some hypotheses for the data, then for the draws (1 + n, names); nought of those that are not
        among its own."""
        place = {name: i for i, name in enumerate(self.names)}
        every = np.vstack([self.found, self.drawn])
        return np.stack([every[:, place[n]] if n in place else np.zeros(len(every)) for n in names], axis=-1)


def tails(residuals: Array) -> dict[float, float]:
    """Probability of every number of degrees of freedom of Student's t, as residuals tell it, any as likely beforehand.

    A scan has some hundred values, which seldom say for sure whether a few large ones are its tails or chance.
    """
    squares = np.ravel(residuals) ** 2
    logs = np.array([_student(squares, freedom) for freedom in _TAILS])
    shares = np.exp(logs - logs.max())
    return {freedom: float(share) for freedom, share in zip(_TAILS, shares / shares.sum())}


def _student(squares: Array, freedom: float) -> float:
    """Log likelihood of Student's t at its likeliest scale, for squared residuals."""
    if np.isinf(freedom):
        return float(-0.5 * squares.size * (np.log(2.0 * np.pi * max(squares.mean(), 1e-300)) + 1.0))
    scale = max(float(np.median(squares)), 1e-300)
    for _ in range(_ROUNDS):
        scale = max(float(((freedom + 1.0) / (freedom + squares / scale) * squares).mean()), 1e-300)
    each = gammaln(0.5 * (freedom + 1.0)) - gammaln(0.5 * freedom) - 0.5 * np.log(freedom * np.pi * scale)
    return float((each - 0.5 * (freedom + 1.0) * np.log1p(squares / (freedom * scale))).sum())


def noise_draws(
    rng: np.random.Generator,
    count: int,
    noise: Noise,
    likely: Mapping[float, float],
    bases: list[Array],
    level: Array,
) -> Array:
    """Whitened draws (count, C K) of noise, their wild values, size and share found in themselves as in the data.

    Args:
        rng: randomness.
        count: draws.
        noise: whose sizes and share they have.
        likely: degrees of freedom of each channel's own, each in its share of the draws. What a sample has in common
            is normal: one that is off in all channels is a gap, not a tail.
        bases: what the flexible fit took from every channel (K, active).
        level: size of the values in units of the spread (C, K).
    """
    channels, samples = noise.spread.shape
    held = np.cumsum([*likely.values()])
    freedom = np.array([*likely])[np.searchsorted(held, (np.arange(count) + 0.5) / count * held[-1])]
    alone = _tailed(rng, (count, channels, samples), freedom)
    draws = noise.mixed(alone, rng.standard_normal((count, 1, samples))) * noise.sizes(rng, count)
    wild = np.ones_like(draws)
    for _ in range(_LOOKS):
        wild = outlying(_beyond(draws / wild, bases) * wild)
    draws = draws / wild
    left = without_jumps(_beyond(draws, bases))
    degrees = np.array([max(samples - axes.shape[1], 1) for axes in bases], float)
    size, shares, _ = size_and_share(left, degrees, second_differences(draws), noise.size, level, noise.load)
    relative = (size / noise.size)[..., None]
    white = across(inverse_root(channels, shares, noise.load), draws / relative).reshape(count, -1)
    return noise.settled(white + noise.erring(rng, count))


def _beyond(draws: Array, bases: list[Array]) -> Array:
    """What the flexible fit leaves of draws (n, C, K)."""
    return np.stack([draws[:, c] - (draws[:, c] @ axes) @ axes.T for c, axes in enumerate(bases)], axis=1)


def _tailed(rng: np.random.Generator, shape: tuple[int, ...], freedom: Array) -> Array:
    """Draws of unit variance, each with its own degrees of freedom (n,) along the first axis."""
    drawn = rng.standard_normal(shape)
    heavy = np.isfinite(freedom)
    own = freedom[heavy][:, None, None]
    drawn[heavy] *= np.sqrt((own - 2.0) / rng.chisquare(own, drawn[heavy].shape))
    return drawn


def statistic(logs: Array, null: Array) -> Array:
    """One number that grows with any gap: evidence averaged over hypotheses, each less what noise seldom gives it.

    Args:
        logs: log evidence of every hypothesis (..., H).
        null: the same of draws of noise (b, H).
    """
    return evidence.mean(logs - np.maximum(np.quantile(null, _SELDOM, axis=0), 0.0))


def reached(values: Array) -> NDArray[np.intp]:
    """How many of these values (n,) are as large as each of them, itself counted."""
    return len(values) - np.searchsorted(np.sort(values), values, side="left")


def p_value(observed: float, null: Array) -> float:
    """Share of draws that reach the observed statistic, itself counted."""
    return float((1 + np.count_nonzero(null >= observed)) / (1 + len(null)))
