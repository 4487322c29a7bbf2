"""The covariance of noise: its size a channel, a share that a whole sample has in common, errors of what drives all.

cov(r_ck, r_dl) = s_c s_d v_ck v_dk ((1 - rho) [c = d] + rho) [k = l] + sum_m b_mck b_mdl

unless the simulator says that what a sample has in common is a factor of its values. Then s is the size of what is each
channel's own, and the first bracket is

    [c = d] + kappa u_ck u_dk,   kappa = rho / (1 - rho)

where u_ck goes as a channel's values over its own noise, with a mean u^2 of 1 over the channels of a sample: rho is the
share of the variance of a usual channel. b_m is what the channels show of one standard deviation of an error of what
drives them, where that is known with errors. Where v is not known for sure, draws of noise have

    v_ck exp(sum_m z_m e_mck),   z standard normal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: The largest rho: no noise is all in common.
MOST_SHARED = 0.9
#: Newton steps in which sizes that may be others settle, and the last of them.
_ROUNDS, _SETTLED = 40, 1e-4


@dataclass(frozen=True)
class Noise:
    """Covariance of the residuals.

    Args:
        spread: v, relative standard deviations (C, K).
        size: s (C,), of what is each channel's own where there are loads.
        share: rho.
        load: u (C, K), or (C, 1) where samples do not differ; None where all are 1.
        errors: b, what channels show of errors of what drives them (M, C, K).
        uneven: e, errors of ln v (M, C, K).
        doubt: standard deviations of ln s (C,), whose mean over the channels is known; (1,) of none where all are.
    """

    spread: Array
    size: Array
    share: float
    load: Array | None = None
    errors: Array = field(default_factory=lambda: np.zeros((0, 1, 1)))
    uneven: Array = field(default_factory=lambda: np.zeros((0, 1, 1)))
    doubt: Array = field(default_factory=lambda: np.zeros(1))

    @cached_property
    def mixing(self) -> Array:
        """R^{-1/2} of every sample (K, C, C), or (1, C, C) of all."""
        return inverse_root(len(self.size), np.array(self.share), self.load)

    @property
    def variance(self) -> Array:
        """Of every value (C, K), without errors of what drives the channels."""
        in_common = 0.0 if self.load is None else _excess(self.share) * self.load**2
        return np.asarray(self._scale**2 * (1.0 + in_common), np.float64)

    def mixed(self, alone: Array, common: Array) -> Array:
        """What is each channel's own (..., C, K) and what a sample has in common (..., 1, K), in their shares."""
        if self.load is not None:
            return np.asarray(alone + np.sqrt(_excess(self.share)) * self.load * common, np.float64)
        return np.sqrt(1.0 - self.share) * alone + np.sqrt(self.share) * common

    @cached_property
    def _scale(self) -> Array:
        return self.size[:, None] * self.spread

    @cached_property
    def _errors(self) -> tuple[Array, Array]:
        """Orthonormal directions (C K, M) of errors of what drives the channels, and their sizes (M,), in units of the
        noise beside them."""
        axes, size, _ = np.linalg.svd(self._beside(self.errors).T, full_matrices=False)
        return axes, size

    def _beside(self, values: Array) -> Array:
        """Values (..., C, K) in units in which noise is white but for errors of what drives the channels."""
        return across(self.mixing, values / self._scale).reshape(
            *values.shape[:-2], values.shape[-2] * values.shape[-1]
        )

    def _back(self, white: Array) -> Array:
        """What `_beside` makes into these."""
        each = white.reshape(*white.shape[:-1], *self.spread.shape)
        return self._scale * across(np.asarray(np.linalg.inv(self.mixing), np.float64), each)

    def whiten(self, values: Array) -> Array:
        """Values (..., C, K) in units in which noise is white, flattened to (..., C K)."""
        return self.settled(self._beside(values))

    def settled(self, white: Array) -> Array:
        """Values white but for errors of what drives the channels (..., C K), white with them."""
        return self._along(white, lambda size: 1.0 / np.sqrt(1.0 + size**2))

    def coloured(self, white: Array) -> Array:
        """What `whiten` makes into these (..., C K): values (..., C, K)."""
        return self._back(self._along(white, lambda size: np.sqrt(1.0 + size**2)))

    def erring(self, rng: np.random.Generator, count: int) -> Array:
        """Draws (count, C K) of errors of what drives the channels, in units of the noise beside them."""
        if not len(self.errors):
            return np.zeros((count, self.spread.size))
        axes, size = self._errors
        return np.asarray((rng.standard_normal((count, len(size))) * size) @ axes.T, np.float64)

    def sizes(self, rng: np.random.Generator, count: int) -> Array:
        """Draws (count, C, K) of how large v may be, relative to what it is taken for; (1, 1, 1) where it is known."""
        if not len(self.uneven):
            return np.ones((1, 1, 1))
        return np.asarray(np.exp(np.einsum("nm,mck->nck", rng.standard_normal((count, len(self.uneven))), self.uneven)))

    def spared(self, white: Array, freedom: float) -> float:
        """What a whitened residual (C K) gains in log likelihood where a channel's noise is larger, or smaller, than s.

            max_x sum_c { q_c (1 - e^{-2 x_c}) / 2 - n x_c - (x_c / doubt_c)^2 / 2 },   sum_c x_c = 0

        where q_c is a channel's sum of squares and n its degrees of freedom: what stands out in one channel alone may
        be its noise, what stands out in all is not.

        Args:
            white: as `whiten` gives it.
            freedom: degrees of freedom of all channels together.
        """
        if not self.doubt.all() or len(self.size) == 1:
            return 0.0
        squares, each = (white.reshape(len(self.size), -1) ** 2).sum(axis=1), freedom / len(self.size)
        x, hold = np.zeros(len(self.size)), self.doubt**-2.0
        for _ in range(_ROUNDS):
            left = squares * np.exp(-2.0 * x)
            slope, bend = each - left + hold * x, 2.0 * left + hold
            step = (slope - (slope / bend).sum() / (1.0 / bend).sum()) / bend
            x = x - step
            if np.abs(step).max() < _SETTLED:
                break
        gained = 0.5 * squares * -np.expm1(-2.0 * x) - each * x - 0.5 * hold * x**2
        return float(gained.sum())

    def without_errors(self, residuals: Array) -> Array:
        """Residuals (C, K) less what is likeliest to come from errors of what drives the channels."""
        if not len(self.errors):
            return residuals
        return self._back(self._along(self._beside(residuals), lambda size: 1.0 / (1.0 + size**2)))

    def _along(self, white: Array, factor: Callable[[Array], Array]) -> Array:
        """Values with those directions stretched by a factor of their size."""
        if not len(self.errors):
            return white
        axes, size = self._errors
        return white + ((white @ axes) * (factor(size) - 1.0)) @ axes.T


def loads(level: Array) -> Array:
    """u (C, K) of channels with such values in units of v (C, K)."""
    return np.asarray(level / np.sqrt((level**2).mean(axis=0)), np.float64)


def common_axis(count: int, load: Array | None) -> Array:
    """Direction of length 1 of what samples have in common, (C, K), or (C, 1) where they do not differ."""
    load = np.ones((count, 1)) if load is None else load
    return np.asarray(load / np.sqrt((load**2).sum(axis=0)), np.float64)


def _excess(share: Any) -> Any:
    """kappa of rho."""
    return share / (1.0 - share)


def across(mixing: Array, values: Array) -> Array:
    """Matrices of every sample (..., K, C, C), or (..., 1, C, C) of all, times values (..., C, K)."""
    if mixing.shape[-3] == 1:
        return mixing[..., 0, :, :] @ values
    by_sample = values.swapaxes(-1, -2)[..., None]
    return (mixing @ by_sample)[..., 0].swapaxes(-1, -2)


def inverse_root(count: int, share: Array, load: Array | None = None) -> Array:
    """R^{-1/2} for every share (...) by the two eigenvalues of R: (..., 1, C, C); (..., K, C, C) for loads (C, K)."""
    if load is not None:
        axis = common_axis(count, load).T
        along = 1.0 / np.sqrt(1.0 + count * _excess(share[..., None]) * (load**2).mean(axis=0)) - 1.0
        return np.eye(count) + along[..., None, None] * axis[..., :, None] * axis[..., None, :]
    lone, common = 1.0 / np.sqrt(1.0 - share), 1.0 / np.sqrt(1.0 + (count - 1) * share)
    everywhere = np.full((count, count), 1.0 / count)
    found = lone[..., None, None] * (np.eye(count) - everywhere) + common[..., None, None] * everywhere
    return found[..., None, :, :]
