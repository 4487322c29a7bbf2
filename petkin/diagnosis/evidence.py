"""Evidence for an amplitude: how much likelier data are with it than without, averaged over what it could be.

One amplitude: t = g'Pr / |Pg| is standard normal without the effect and normal about z with it. z is log-uniform from
barely visible to blatant, so that the answer does not hang on the unit of the amplitude:

    log B(t) = log int exp(z t - z^2 / 2) d ln z / ln(z1 / z0)

One amplitude a channel: normal about zero with a width that is log-uniform too, or one channel alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

Array = NDArray[np.float64]

_WEAKEST, _STRONGEST = 0.8, 80.0
_Z = np.geomspace(_WEAKEST, _STRONGEST, 401)
_T = np.linspace(-12.0, 70.0, 1641)
#: ln int exp(-(z - t)^2 / 2) w(z): what remains of exp(t^2 / 2) after averaging.
_OCCAM = np.log(np.trapezoid(np.exp(-0.5 * (_Z[:, None] - _T[None]) ** 2), dx=1.0 / (len(_Z) - 1), axis=0) + 1e-300)
#: What a second cause costs in log evidence, whether it has a name or not: most gaps have one cause.
SECOND = 6.0
_WIDTHS = np.geomspace(0.5, 40.0, 8)


def one_sided(t: Array) -> Array:
    """log B(t) of an amplitude that is positive or absent."""
    return 0.5 * np.square(t) + np.interp(t, _T, _OCCAM)


def two_sided(t: Array) -> Array:
    """log B(t) of an amplitude of either sign."""
    return np.logaddexp(one_sided(t), one_sided(-np.asarray(t))) - np.log(2.0)


def by_channel(score: Array, information: Array) -> Array:
    """log B of amplitudes that differ between channels.

    Args:
        score: G'Pr (..., C).
        information: G'PG (C, C).
    """
    together = spread(score, information)
    alone = two_sided(score / np.sqrt(np.maximum(np.diag(information), 1e-300)))
    lone = logsumexp(alone, axis=-1) - np.log(score.shape[-1])
    return np.logaddexp(together, lone) - np.log(2.0)


def spread(score: Array, information: Array) -> Array:
    """log B of many amplitudes, normal about zero with one width.

    Args:
        score: G'Pr (..., n).
        information: G'PG (n, n).
    """
    size, axes = np.linalg.eigh(information)
    size = np.maximum(size, 1e-12 * max(float(size.max()), 1e-300))
    turned = score @ axes
    variance = (_WIDTHS**2 / size.mean())[:, None]
    grown = 1.0 + variance * size
    parts = 0.5 * (turned[..., None, :] ** 2 * variance / grown - np.log(grown)).sum(axis=-1)
    return logsumexp(parts, axis=-1) - np.log(len(_WIDTHS))
