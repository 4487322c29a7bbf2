"""How far the gap shrinks: closure by held-out deviance, cross-fitted over blocks of samples and channels.

    closure = (D_without - D_with) / (D_without - D_floor),   D = sum_b |(I - H_bb)^{-1} r_b|^2,
    D_floor = sum_b tr (I - H_bb)^{-1}

with H the hat matrix of a fit: (I - H_bb)^{-1} r_b is, to first order, the residual of block b in a fit that never saw
it, and the trace is what it would be for the true mean: noise and the cost of the fitted parameters.

Reference: Cook RD, Weisberg S. Residuals and influence in regression. Chapman and Hall 1982.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.refit import Fit

Array = NDArray[np.float64]

#: Blocks of neighbouring samples; directions that a block determines alone are held to this much of their residual.
_BLOCKS, _LEAST = 6, 0.15
_DRAWS = 400
#: Relative error of the noise's variance, which the floor is proportional to.
_FLOOR_ERROR = 0.12
_TAILS = (0.05, 0.95)


@dataclass(frozen=True)
class Interval:
    """A value and its 90 % interval."""

    value: float
    low: float
    high: float


def held_out(fit: Fit, shape: tuple[int, int]) -> tuple[Array, Array]:
    """Held-out deviance and its floor, by block and channel (B, C).

    What is left out at once are other blocks of samples in every channel, so that the rest still tells what channels
    share from their neighbours, and what is a channel's own from its other blocks.

    Args:
        fit: the fit; its whitened rows run over channels, then samples.
        shape: channels, samples.
    """
    lever = Projection.of_fit(fit).axes[: fit.residual.size]
    samples = np.arange(shape[1]) * _BLOCKS // shape[1]
    fold = ((samples + np.arange(shape[0])[:, None]) % _BLOCKS).ravel()
    deviance, floor = np.empty(fit.residual.size), np.empty(fit.residual.size)
    for rows in (np.flatnonzero(fold == f) for f in range(_BLOCKS)):
        size, axes = np.linalg.eigh(np.eye(rows.size) - lever[rows] @ lever[rows].T)
        size = np.maximum(size, _LEAST)
        deviance[rows] = (axes @ ((axes.T @ fit.residual[rows]) / size)) ** 2
        floor[rows] = (axes**2 / size).sum(axis=1)
    by_block = (samples == np.arange(_BLOCKS)[:, None]).astype(float)
    return by_block @ deviance.reshape(shape).T, by_block @ floor.reshape(shape).T


def closure(without: Fit, with_it: Fit, shape: tuple[int, int], rng: np.random.Generator) -> Interval:
    """Share of the gap that goes, with an interval from resampling blocks and channels and from the floor's error."""
    cells = [cell.ravel() for cell in (*held_out(without, shape), *held_out(with_it, shape))]
    picks = rng.integers(0, cells[0].size, (_DRAWS, cells[0].size))
    before, low_before, after, low_after = (cell[picks].sum(axis=1) for cell in cells)
    error = 1.0 + _FLOOR_ERROR * rng.standard_normal(_DRAWS)
    drawn = _closure(before - error * low_before, after - error * low_after)
    sums = [cell.sum() for cell in cells]
    value = float(_closure(sums[0] - sums[1], sums[2] - sums[3]))
    low, high = np.quantile(drawn, _TAILS)
    return Interval(value, min(float(low), value), max(float(high), value))


def _closure(before: Array, after: Array) -> Array:
    return np.clip(1.0 - np.maximum(after, 0.0) / np.maximum(before, 1e-12), 0.0, 1.0)
