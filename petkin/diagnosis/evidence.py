"""Evidence for an amplitude: how much likelier data are with it than without, averaged over what it could be.

One amplitude: t = g'Pr / |Pg| is standard normal without the effect and normal about z with it. z is log-uniform from
barely visible to blatant, so that the answer does not hang on the unit of the amplitude:

    log B(t) = log int exp(z t - z^2 / 2) d ln z / ln(z1 / z0)

One amplitude a channel: normal about zero with a width that is log-uniform too, or else one channel alone; of an effect
that acts everywhere alike, or else the same in all channels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_WEAKEST, _STRONGEST = 0.8, 80.0
_Z = np.geomspace(_WEAKEST, _STRONGEST, 401)
_T = np.linspace(-12.0, 70.0, 1641)
#: ln int exp(-(z - t)^2 / 2) w(z): what remains of exp(t^2 / 2) after averaging.
_OCCAM = np.log(np.trapezoid(np.exp(-0.5 * (_Z[:, None] - _T[None]) ** 2), dx=1.0 / (len(_Z) - 1), axis=0) + 1e-300)
#: What a second cause costs in log evidence: most gaps have one cause. Set on training scans.
SECOND = 8.0
_WIDTHS = np.geomspace(0.5, 40.0, 8)


def one_sided(t: Array) -> Array:
    """log B(t) of an amplitude that is positive or absent."""
    return 0.5 * np.square(t) + np.interp(t, _T, _OCCAM)


def two_sided(t: Array) -> Array:
    """log B(t) of an amplitude of either sign."""
    return np.logaddexp(one_sided(t), one_sided(-np.asarray(t))) - np.log(2.0)


def mean(logs: Array, axis: int = -1) -> Array:
    """ln of the mean of e^x along an axis."""
    top = logs.max(axis=axis, keepdims=True)
    top = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        return np.log(np.exp(logs - top).mean(axis=axis)) + np.squeeze(top, axis)


@dataclass(frozen=True)
class Spread:
    """Many amplitudes, normal about zero with one width, of one effect or of several.

    Args:
        size, axes: eigenvalues (..., n) and vectors (..., n, n) of G'PG.
        diagonal: of G'PG (..., n).
        total: sum of G'PG (...), of one amplitude for all.
    """

    size: Array
    axes: Array
    diagonal: Array
    total: Array

    @classmethod
    def of(cls, information: Array) -> Spread:
        """From G'PG (..., n, n)."""
        size, axes = np.linalg.eigh(information)
        size = np.maximum(size, 1e-12 * np.maximum(size.max(axis=-1, keepdims=True), 1e-300))
        total = np.maximum(information.sum(axis=(-2, -1)), 1e-300)
        return cls(size, axes, np.maximum(np.diagonal(information, axis1=-2, axis2=-1), 1e-300), total)

    def together(self, score: Array) -> Array:
        """log B for G'Pr: (*batch, ..., n) to (*batch, ...)."""
        turned = np.einsum("...i,...ij->...j", score, self.axes) ** 2
        variance = (_WIDTHS**2 / self.size.mean(axis=-1)[..., None])[..., None]
        grown = 1.0 + variance * self.size[..., None, :]
        parts = np.einsum("...j,...wj->...w", turned, variance / grown) - np.log(grown).sum(axis=-1)
        return mean(0.5 * parts)

    def by_channel(self, score: Array, alike: NDArray[np.bool_] | bool) -> Array:
        """The same of amplitudes that differ between channels: all of them, or one alone; one for all where alike."""
        lone = mean(two_sided(score / np.sqrt(self.diagonal)))
        one = two_sided(score.sum(axis=-1) / np.sqrt(self.total))
        return np.logaddexp(self.together(score), np.where(alike, one, lone)) - np.log(2.0)
