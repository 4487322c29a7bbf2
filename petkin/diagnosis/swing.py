"""A swing that all channels share, at any pace, told from noise that they share, whose size the swing may have raised.

    c_k = sum_j a_j cos(pi j x_k) f_k + e_k,   j = i, i + 1, i + 2,   e ~ N(0, s^2 V),   a ~ N(0, w^2 s^2 / m)

c is what whitened residuals have in common, V what the projection leaves of its covariance, f the simulator's values,
x the place among the samples or the time, in shares of all. Noise that samples share has every pace alike, a swing
three rhythms that follow on each other; so s need not be known. With any size of noise as likely on a log scale,

    B = mean over i and w of |1 + w^2 M / m|^{-1/2} (1 - q / S)^{-n/2},   q = t'(m / w^2 + M)^{-1} t

of S = c'c, t = G'c and M = G'G in units of V, m the mean of M's eigenvalues and n the rank of V.

Reference: Liang F, Paulo R, Molina G, Clyde MA, Berger JO. J Am Stat Assoc 2008;103:410-423 (noise of unknown size).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import evidence
from petkin.diagnosis.covariance import Noise, common_axis
from petkin.diagnosis.noise import without_jumps
from petkin.diagnosis.nuisance import Projection

Array = NDArray[np.float64]

#: Rhythms of a swing, of which the last is the first of the next, and half periods of the slowest one; by what share of
#: all the time even samples may differ.
BAND, _SLOWEST, _UNEVEN = 3, 3, 1e-6
#: Of the common course of residuals, what the projection leaves less of in variance tells no pace.
_LEFT = 0.3
#: The largest q / S.
_MOST = 0.9999


@dataclass(frozen=True)
class Swing:
    """Swings around a fit.

    Args:
        axis: direction of what samples have in common (C, K).
        root: c to units in which what is left of its noise is white (K, n).
        columns: G in those units, along the eigenvectors of M (g, 3, n).
        size: eigenvalues of M, in units of m (g, 3).
    """

    axis: Array
    root: Array
    columns: Array
    size: Array

    @classmethod
    def around(cls, values: Sequence[Array], times: Array, noise: Noise, projection: Projection) -> Swing | None:
        """Around what is predicted; None of too few samples.

        Args:
            values: f (C, K), any of them.
            times: of the samples (K,).
            noise: its covariance.
            projection: what is refitted.
        """
        bands = _bands(times)
        if not len(bands):
            return None
        shape = noise.spread.shape
        axis = np.broadcast_to(common_axis(shape[0], noise.load), shape)
        axes = projection.axes[: projection.rows]

        def common(white: Array) -> Array:
            return np.asarray((white.reshape(*white.shape[:-1], *shape) * axis).sum(axis=-2), np.float64)

        refitted = common(axes.T)
        left, vectors = np.linalg.eigh(np.eye(shape[1]) - refitted.T @ refitted)
        root = vectors[:, left > _LEFT] / np.sqrt(left[left > _LEFT])
        rhythms = bands.reshape(-1, 1, shape[1])
        white = np.concatenate([noise.whiten(rhythms * each) for each in values])
        columns = ((common(white) - (white @ axes) @ refitted) @ root).reshape(-1, BAND, root.shape[1])
        size, turned = np.linalg.eigh(columns @ columns.swapaxes(-1, -2))
        size = np.maximum(size, np.maximum(1e-12 * size[:, -1:], 1e-300))
        scale = size.mean(axis=-1, keepdims=True)
        along = turned.swapaxes(-1, -2) @ columns / np.sqrt(scale)[..., None]
        return cls(axis, root, along, size / scale)

    def log_evidence(self, residuals: Array) -> Array:
        """log B for what a refit left of whitened data (..., C K)."""
        each = without_jumps(residuals.reshape(*residuals.shape[:-1], *self.axis.shape))
        common = (each * self.axis).sum(axis=-2) @ self.root
        total = np.maximum((common**2).sum(axis=-1, keepdims=True), 1e-300)
        score = common @ self.columns.reshape(-1, common.shape[-1]).T
        share = score.reshape(*score.shape[:-1], *self.size.shape) ** 2 / total[..., None]
        found = []
        for variance in evidence.WIDTHS**2:
            grown = 1.0 + variance * self.size
            explained = np.minimum((share * (variance / grown)).sum(axis=-1), _MOST)
            found.append(-0.5 * self.root.shape[1] * np.log1p(-explained) - 0.5 * np.log(grown).sum(axis=-1))
        return evidence.mean(evidence.mean(np.stack(found, axis=-1)))


def _bands(times: Array) -> Array:
    """Cosines that follow on each other (g, 3, K), by place and, of uneven samples, by time, the quickest that samples
    can show and slower ones."""
    if times.size < _SLOWEST + BAND:
        return np.zeros((0, BAND, times.size))
    places, later, found = np.arange(float(times.size)), times - times.min(), []
    for x in (places, later)[: 1 + int(np.ptp(np.diff(times)) > _UNEVEN * np.ptp(times))]:
        step = float(np.median(np.diff(x)[times.size // 2 :]))
        quickest = min(int(x.max() / step + _UNEVEN), times.size - 1)
        firsts = np.arange(quickest - BAND + 1, _SLOWEST - 1, 1 - BAND)
        rhythms = firsts[:, None] + np.arange(BAND)
        found.append(np.cos(np.pi * rhythms[..., None] * x / x.max()))
    return np.concatenate(found)
