"""Evidence for an amplitude: how much likelier data are with it than without, averaged over what it could be.

One amplitude: t = g'Pr / |Pg| is standard normal without the effect and normal about z with it. z is log-uniform from
barely visible to blatant, so that the answer does not hang on the unit of the amplitude:

    log B(t) = log int exp(z t - z^2 / 2) d ln z / ln(z1 / z0)

One amplitude a channel: normal about zero with a width that is log-uniform too, or else one channel alone. Of an effect
that acts everywhere alike: one amplitude in all channels, or amplitudes that differ from it by a share of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from petkin.jit import njit

Array = NDArray[np.float64]

_WEAKEST, _STRONGEST = 0.8, 80.0
_Z = np.geomspace(_WEAKEST, _STRONGEST, 401)
_T = np.linspace(-12.0, 70.0, 1641)
_STEP = float(_T[1] - _T[0])
#: ln int exp(-(z - t)^2 / 2) w(z): what remains of exp(t^2 / 2) after averaging.
_OCCAM = np.log(np.trapezoid(np.exp(-0.5 * (_Z[:, None] - _T[None]) ** 2), dx=1.0 / (len(_Z) - 1), axis=0) + 1e-300)
#: What a second cause costs in log evidence: most gaps have one cause. Set on training scans.
SECOND = 8.0
#: Widths that many amplitudes of one effect may have, in units of their usual error.
WIDTHS = np.geomspace(0.5, 40.0, 8)
#: By how much of itself an amplitude differs between channels where it is about the same, and sizes of it that are
#: averaged.
_DIFFERS, _ABOUT = 0.5, np.geomspace(_WEAKEST, _STRONGEST, 48)


def one_sided(t: Array) -> Array:
    """log B(t) of an amplitude that is positive or absent."""
    t = np.asarray(t, np.float64)
    return _one_sided(t.ravel(), _OCCAM).reshape(t.shape)


def two_sided(t: Array, above: Array | None = None) -> Array:
    """log B(t) of an amplitude of either sign.

    Args:
        t: of one below zero, and of one above as well.
        above: of one above, where its prior has another width.
    """
    t = np.asarray(t, np.float64)
    above = t if above is None else np.asarray(above, np.float64)
    return _two_sided(t.ravel(), above.ravel(), _OCCAM).reshape(t.shape)


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
        standard: G'Pr (..., n) to amplitudes in units of their errors (..., n, n).
    """

    size: Array
    axes: Array
    diagonal: Array
    total: Array
    standard: Array

    @classmethod
    def of(cls, information: Array) -> Spread:
        """From G'PG (..., n, n)."""
        size, axes = np.linalg.eigh(information)
        size = np.maximum(size, np.maximum(1e-12 * size.max(axis=-1, keepdims=True), 1e-300))
        total = np.maximum(information.sum(axis=(-2, -1)), 1e-300)
        inverse = (axes / size[..., None, :]) @ axes.swapaxes(-1, -2)
        standard = inverse / np.sqrt(np.diagonal(inverse, axis1=-2, axis2=-1))[..., None, :]
        return cls(size, axes, np.maximum(np.diagonal(information, axis1=-2, axis2=-1), 1e-300), total, standard)

    def together(self, score: Array) -> Array:
        """log B for G'Pr: (*batch, ..., n) to (*batch, ...)."""
        turned, size, _ = self._turned(score)
        return _together(turned, size).reshape(score.shape[:-1])

    def by_channel(self, score: Array, alike: bool, signed: bool) -> Array:
        """The same of amplitudes that differ between channels: all of them, or one alone; where alike, by a share of
        themselves or not at all. One amplitude is positive or absent unless it is signed."""
        if alike:
            one = _of_sign(score.sum(axis=-1) / np.sqrt(self.total), signed)
            return np.logaddexp(self.about(score, signed), one) - np.log(2.0)
        return np.logaddexp(self._each(score, signed), mean(self._lone(score, signed))) - np.log(2.0)

    def at_sizes(self, score: Array, sizes: Array, signed: bool) -> Array:
        """log B for one G'Pr (n,) of amplitudes of given sizes (Z,): normal about zero, as wide in all channels, or as
        large in one alone."""
        turned, variance = (score @ self.axes) ** 2, sizes[:, None] ** 2
        grown = 1.0 + variance * self.size
        every = 0.5 * (turned * variance / grown - np.log(grown)).sum(axis=-1) + self._positive(score, signed)
        lone = sizes[:, None] * score - 0.5 * variance * self.diagonal
        if signed:
            lone = np.logaddexp(lone, lone - 2.0 * sizes[:, None] * score) - np.log(2.0)
        return np.logaddexp(every, mean(lone)) - np.log(2.0)

    def about(self, score: Array, signed: bool) -> Array:
        """log B of amplitudes that are normal about one of them all, as wide as a share of it."""
        turned, size, axes = self._turned(score)
        along, signs = axes.sum(axis=1), (1.0, -1.0) if signed else (1.0,)
        each = [_about(sign * turned, size, along) for sign in signs]
        return np.asarray(np.logaddexp.reduce(each).reshape(score.shape[:-1]) - np.log(len(each)), np.float64)

    def alone(self, score: Array, signed: bool) -> Array:
        """Probability of every channel (..., n) that it alone has an amplitude, and not all of them."""
        lone = self._lone(score, signed)
        every = self._each(score, signed)[..., None] + np.log(lone.shape[-1])
        top = np.maximum(lone.max(axis=-1, keepdims=True), every)
        share = np.exp(lone - top)
        return np.asarray(share / (share.sum(axis=-1, keepdims=True) + np.exp(every - top)), np.float64)

    def apart(self, score: Array) -> Array:
        """Every channel's amplitude in units of its error (..., n)."""
        return np.asarray((score[..., None, :] @ self.standard)[..., 0, :], np.float64)

    def _turned(self, score: Array) -> tuple[Array, Array, Array]:
        """G'Pr along the axes (draws, effects, n), and sizes and axes by effect."""
        count = self.size.shape[-1]
        size, axes = self.size.reshape(-1, count), self.axes.reshape(-1, count, count)
        turned = np.matmul(score.reshape(-1, *size.shape).swapaxes(0, 1), axes)
        return np.ascontiguousarray(turned.swapaxes(0, 1)), np.ascontiguousarray(size), axes

    def _lone(self, score: Array, signed: bool) -> Array:
        return _of_sign(score / np.sqrt(self.diagonal), signed)

    def _each(self, score: Array, signed: bool) -> Array:
        return self.together(score) + self._positive(score, signed)

    def _positive(self, score: Array, signed: bool) -> Array | float:
        """What it adds that amplitudes cannot be negative: twice the chance of each that it is positive, as if that of
        one told nothing of another's."""
        return 0.0 if signed else (np.log(2.0) + log_ndtr(self.apart(score))).sum(axis=-1)


def _of_sign(t: Array, signed: bool) -> Array:
    return two_sided(t) if signed else one_sided(t)


@njit()
def _averaged(t, occam):
    """log B(t), what remains of exp(t^2 / 2) read between the even steps of its table."""
    place = (t - _T[0]) / _STEP
    i = min(max(int(place), 0), occam.size - 2)
    return 0.5 * t * t + occam[i] + min(max(place - i, 0.0), 1.0) * (occam[i + 1] - occam[i])


@njit()
def _one_sided(t, occam):
    found = np.empty_like(t)
    for i in range(t.size):
        found[i] = _averaged(t[i], occam)
    return found


@njit()
def _two_sided(below, above, occam):
    found = np.empty_like(below)
    for i in range(below.size):
        one, other = _averaged(above[i], occam), _averaged(-below[i], occam)
        more, less = max(one, other), min(one, other)
        found[i] = more + np.log1p(np.exp(less - more)) - np.log(2.0)
    return found


@njit()
def _about(turned, size, along):
    """The same as `_together`, averaged over how large the amplitudes are about; `along` each axis one of them all."""
    draws, effects, count = turned.shape
    found, parts = np.empty((draws, effects)), np.empty(_ABOUT.size)
    mean, volume, share = np.empty(_ABOUT.size), np.empty(_ABOUT.size), np.empty((_ABOUT.size, count))
    for e in range(effects):
        total = 0.0
        for j in range(count):
            total += size[e, j] * along[e, j] ** 2
        for k in range(_ABOUT.size):
            mean[k] = _ABOUT[k] / np.sqrt(max(total, 1e-300))
            variance, volume[k] = (_DIFFERS * mean[k]) ** 2, 0.0
            for j in range(count):
                grown = 1.0 + variance * size[e, j]
                share[k, j] = variance / grown
                volume[k] += np.log(grown)
        for b in range(draws):
            for k in range(_ABOUT.size):
                parts[k] = -0.5 * volume[k] - 0.5 * _ABOUT[k] ** 2
            for j in range(count):
                seen, one = turned[b, e, j], along[e, j]
                for k in range(_ABOUT.size):
                    left = seen - mean[k] * size[e, j] * one
                    parts[k] += mean[k] * seen * one + 0.5 * left * left * share[k, j]
            top = parts.max()
            found[b, e] = top + np.log(np.exp(parts - top).mean())
    return found


@njit()
def _together(turned, size):
    """log B of every draw and every effect (draws, effects), averaged over the widths, of scores along the axes."""
    draws, effects, count = turned.shape
    found = np.empty((draws, effects))
    share, volume, parts = np.empty((WIDTHS.size, count)), np.empty(WIDTHS.size), np.empty(WIDTHS.size)
    for e in range(effects):
        for w in range(WIDTHS.size):
            variance, volume[w] = WIDTHS[w] ** 2 / size[e].mean(), 0.0
            for j in range(count):
                grown = 1.0 + variance * size[e, j]
                share[w, j] = variance / grown
                volume[w] += np.log(grown)
        for b in range(draws):
            for w in range(WIDTHS.size):
                parts[w] = -volume[w]
            for j in range(count):
                square = turned[b, e, j] ** 2
                for w in range(WIDTHS.size):
                    parts[w] += square * share[w, j]
            top = parts.max()
            total = 0.0
            for w in range(WIDTHS.size):
                total += np.exp(0.5 * (parts[w] - top))
            found[b, e] = 0.5 * top + np.log(total / WIDTHS.size)
    return found
