"""A gap of no name: a smooth discrepancy in every channel, orthogonal to what a refit can do.

    delta_c(t) = f_c(t) sum_j w_j phi_j(x) (a_j + b_cj),   x = log(t + 1) or t, rescaled to 0..1,  phi_j = cos(pi j x)

a Gaussian process with a cosine basis, common to all channels, in each for itself, both, or in one of them; only what
the projection leaves of it counts, so that it can never take what the simulator's own parameters, or a named effect's,
explain.

Reference: Plumlee M. Bayesian calibration of inexact computer models. J Am Stat Assoc 2017;112:1274-1285.
doi:10.1080/01621459.2016.1211016
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import evidence
from petkin.diagnosis.noise import Noise
from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.refit import Fit

Array = NDArray[np.float64]

#: Cosines, and the power by which they fade: rougher discrepancies are less likely.
_COUNT, _FADING = 12, 0.5
#: Beside a name: what it costs in log evidence, as a second cause does, and which share of the name's own it may add;
#: where more is left than that, the name is not what the gap is. Beside how many explanations it is looked for.
_STRANGER, _SMALL, _BESIDE = evidence.SECOND, 0.2, 6


class Explanation(Protocol):
    """A named explanation with its evidence and its fit."""

    @property
    def fit(self) -> Fit | None: ...

    @property
    def log_evidence(self) -> float: ...


@dataclass(frozen=True)
class Smooth:
    """The discrepancy around a fit, whitened and projected.

    Args:
        columns: P G of every time scale (n, m).
        kinds: by time scale: which columns may be there at once (g, k), and their spread; any of the g is as likely.
    """

    columns: tuple[Array, ...]
    kinds: tuple[tuple[tuple[NDArray[np.intp], evidence.Spread], ...], ...]

    @classmethod
    def around(cls, values: Array, times: Array, noise: Noise, projection: Projection) -> Smooth:
        """Around predicted values (C, K)."""
        axes = projection.axes[: projection.rows]
        found, kinds = [], []
        for scale in (np.log(times + 1.0), times):
            columns = noise.whiten(discrepancies(values, scale)).T
            projected = columns - axes @ (axes.T @ columns)
            information = columns.T @ projected
            spreads = (evidence.Spread.of(information[g[:, :, None], g[:, None, :]]) for g in _groups(len(values)))
            found.append(projected)
            kinds.append(tuple(zip(_groups(len(values)), spreads)))
        return cls(tuple(found), tuple(kinds))

    def evidence(self, residuals: Array) -> Array:
        """log evidence of a discrepancy for what a refit left of whitened data (..., n)."""
        found = []
        for columns, kinds in zip(self.columns, self.kinds):
            scores = residuals @ columns
            found += [evidence.mean(spread.together(scores[..., group])) for group, spread in kinds]
        return evidence.mean(np.stack(found), 0)


def _groups(channels: int) -> list[NDArray[np.intp]]:
    """Columns of a discrepancy common to all channels, in each for itself, both, and in one channel alone."""
    every = np.arange(_COUNT * (1 + channels))
    common, alone = every[None, :_COUNT], every[None, _COUNT:]
    return [common] if channels == 1 else [common, alone, every[None], alone.reshape(_COUNT, channels).T]


def discrepancies(values: Array, scale: Array) -> Array:
    """Columns (n, C, K) of the discrepancy: one block common to all channels, then one a channel.

    Args:
        values: predicted (C, K).
        scale: x of the samples, in any unit (K,).
    """
    x = (scale - scale[0]) / (scale[-1] - scale[0])
    j = np.arange(_COUNT)
    cosines = np.cos(np.pi * j[:, None] * x) * (1.0 + j[:, None]) ** -_FADING
    level = values.mean(axis=1, keepdims=True)
    common = cosines[:, None, :] * values[None]
    alone = np.eye(len(values))[None, :, :, None] * (
        cosines[:, None, None, :] * (0.5 * values + 0.5 * level)[None, None]
    )
    return np.concatenate([common, alone.reshape(-1, *values.shape)])


def beside(times: Array, noise: Noise, ranked: Sequence[Explanation]) -> list[float]:
    """log evidence of each explanation with what it leaves explained by a gap of no name beside it; ranked as they are.

    A name that a smooth discrepancy cannot stand in for keeps its claim, whatever else is in the data.

    Args:
        times: of the samples.
        noise: its covariance.
        ranked: explanations, best first; those far down, or without a fit, keep their own evidence.
    """
    found, looked = [], 0
    for candidate in ranked:
        fit, value = candidate.fit, candidate.log_evidence
        if fit is not None and looked < _BESIDE:
            projection = Projection.of_fit(fit)
            smooth = Smooth.around(fit.values, times, noise, projection)
            more = min(float(smooth.evidence(projection.left_of(fit))), _SMALL * max(value, 0.0))
            value = float(np.logaddexp(value, value + more - _STRANGER))
            looked += 1
        found.append(value)
    return found
