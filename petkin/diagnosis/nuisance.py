"""Projection: what a refit of the nuisance parameters leaves of a residual or a template.

P = I - J (J'J + L)^{-1} J',  taken on data and prior rows together, where it is a projector

A refit leaves r = P_dd y + P_dp z of data y and of the prior's residual z = (m - x) / sd: where the prior is off, it
pulls, and r is not zero without any noise. A template g sees g'P_dd r, which is g'r less what the pull of the fit puts
there, and noise is drawn with that pull.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.refit import Fit

Array = NDArray[np.float64]

#: How much wider than it says a prior may be, in variance.
_MOST_OFF = 2.0


@dataclass(frozen=True)
class Projection:
    """Orthonormal columns of the nuisance (n + p, p): data rows, then the rows of their prior."""

    axes: Array
    rows: int

    @classmethod
    def of(cls, jacobian: Array, penalty: Array) -> Projection:
        """From whitened derivatives (n, p) and 1 / sd^2 of every parameter."""
        stacked = np.concatenate([jacobian, np.diag(np.sqrt(penalty))])
        scale = np.linalg.norm(stacked, axis=0)
        left, size, _ = np.linalg.svd(stacked / np.where(scale > 0, scale, 1.0), full_matrices=False)
        return cls(left[:, size > 1e-9 * size[0]], len(jacobian))

    @classmethod
    def of_fit(cls, fit: Fit) -> Projection:
        return cls.of(fit.jacobian, fit.penalty)

    def left(self, data: Array, prior: Array) -> Array:
        """What a refit leaves of data rows (..., n) and of the prior's residual (..., p)."""
        mine, theirs = self.axes[: self.rows], self.axes[self.rows :]
        return data - (data @ mine + prior @ theirs) @ mine.T

    def priors(self, rng: np.random.Generator, count: int, fit: Fit) -> Array:
        """Draws of the prior's residual (count, p) at the truth, as far as data and prior tell.

        Of the truth's residual o the fit shows (1 - h) (o + e) along each axis of H = S (J'J + S'S)^{-1} S, the hat
        matrix of the prior S, with e of variance h / (1 - h). o has the variance that the fit's residuals ask for by
        their moments, 1 at least: a prior that is off is off by more than the fit shows, since it pulls at the fit. A
        gap pulls as well; so that it is not taken for such a prior, the variance has a limit.

        Reference: Efron B, Morris C. J Am Stat Assoc 1973;68:117-130 (a prior's variance from what it is for).
        """
        theirs = self.axes[self.rows :]
        h, axes = np.linalg.eigh(theirs @ theirs.T)
        h = np.clip(h, 0.0, 1.0 - 1e-9)
        shown, kept = axes.T @ fit.pulled, 1.0 - h
        asked = float((shown**2 - h * kept).sum() / (kept**2).sum())
        variance, error = float(np.clip(asked, 1.0, _MOST_OFF)), h / kept
        mean, spread = variance / (variance + error) * shown / kept, np.sqrt(variance * error / (variance + error))
        return (mean + spread * rng.standard_normal((count, len(h)))) @ axes.T

    def left_of(self, fit: Fit) -> Array:
        """What the last step of a refit would leave of its residual (n,)."""
        return self.left(fit.residual, fit.pulled)

    def inner(self, left: Array, right: Array) -> Array:
        """a' P b for data columns a (n, i) and b (n, j)."""
        data = self.axes[: self.rows]
        return left.T @ right - (left.T @ data) @ (data.T @ right)

    def norms(self, columns: Array) -> Array:
        """sqrt(a' P a) of columns (n, i)."""
        through = self.axes[: self.rows].T @ columns
        return np.sqrt(np.maximum((columns**2).sum(axis=0) - (through**2).sum(axis=0), 0.0))
