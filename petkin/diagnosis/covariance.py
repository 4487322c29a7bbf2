"""The covariance of noise: its size a channel, a share that a whole sample has in common, errors of what drives all.

cov(r_ck, r_dl) = s_c s_d v_ck v_dk ((1 - q_ck^2) [c = d] + q_ck q_dk) [k = l] + sum_m b_mck b_mdl

q^2 is rho, unless the simulator says that what a sample has in common is a factor of its values: then q_ck^2 is
rho u_ck^2, and no more than 0.9, where u_ck goes as a channel's values over its noise, with a mean u^2 of 1 over the
channels of a sample. b_m is what the channels show of one standard deviation of an error of what drives them, where
that is known with errors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: The largest rho, and q^2: no channel's noise is all in common.
MOST_SHARED = 0.9


@dataclass(frozen=True)
class Noise:
    """Covariance of the residuals.

    Args:
        spread: v, relative standard deviations (C, K).
        size: s (C,).
        share: rho.
        load: u (C, K), or (C, 1) where samples do not differ; None where all are 1.
        errors: b, what channels show of errors of what drives them (M, C, K).
    """

    spread: Array
    size: Array
    share: float
    load: Array | None = None
    errors: Array = field(default_factory=lambda: np.zeros((0, 1, 1)))

    @cached_property
    def mixing(self) -> Array:
        """R^{-1/2} of every sample (K, C, C), or (1, C, C) of all."""
        return inverse_root(len(self.size), np.array(self.share), self.load)

    def mixed(self, alone: Array, common: Array) -> Array:
        """What is each channel's own (..., C, K) and what a sample has in common (..., 1, K), in their shares."""
        part = self.share if self.load is None else in_common(np.array(self.share), self.load)
        return np.sqrt(1.0 - part) * alone + np.sqrt(part) * common

    def loaded(self, level: Array, size: Array) -> Array | None:
        """u of channels with such values (C, K) and sizes (..., C), where this noise has any."""
        return None if self.load is None else loads(level, size)

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


def loads(level: Array, size: Array) -> Array:
    """u (..., C, K) of channels with such values (C, K) and such noise (..., C), both in units of v."""
    ratio = level / size[..., None]
    return np.asarray(ratio / np.sqrt((ratio**2).mean(axis=-2, keepdims=True)), np.float64)


def in_common(share: Array, load: Array) -> Array:
    """q^2 (..., C, K) of a share (...) and loads (..., C, K)."""
    return np.minimum(share[..., None, None] * load**2, MOST_SHARED)


def across(mixing: Array, values: Array) -> Array:
    """Matrices of every sample (..., K, C, C), or (..., 1, C, C) of all, times values (..., C, K)."""
    if mixing.shape[-3] == 1:
        return mixing[..., 0, :, :] @ values
    by_sample = values.swapaxes(-1, -2)[..., None]
    return (mixing @ by_sample)[..., 0].swapaxes(-1, -2)


def inverse_root(count: int, share: Array, load: Array | None = None) -> Array:
    """R^{-1/2} for every share (...) and load (..., C, K): (..., K, C, C); (..., 1, C, C) by the two eigenvalues of R
    where loads are 1."""
    if load is not None:
        common = np.sqrt(in_common(share, load)).swapaxes(-1, -2)
        alone = (1.0 - common**2)[..., None] * np.eye(count)
        values, axes = np.linalg.eigh(alone + common[..., :, None] * common[..., None, :])
        return (axes / np.sqrt(values)[..., None, :]) @ axes.swapaxes(-1, -2)
    lone, common = 1.0 / np.sqrt(1.0 - share), 1.0 / np.sqrt(1.0 + (count - 1) * share)
    everywhere = np.full((count, count), 1.0 / count)
    found = lone[..., None, None] * (np.eye(count) - everywhere) + common[..., None, None] * everywhere
    return found[..., None, :, :]
