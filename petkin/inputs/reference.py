"""A continuous curve from frame values: of a reference region, nothing else is known.

Of all curves that start at zero and report exactly the frame values x, the smoothest is taken, in time measured as
s = ln(1 + t / 1 min), which counts the minutes of a late frame like the seconds of an early one:

    minimise int (d^2 C / ds^2)^2 ds   subject to   A C = x,   C = 0 and dC/ds = 0 at time 0,

A what frames report (their decay-weighted means). It is linear in x, C = G A' (A G A')^-1 x with G the kernel of the
roughness, and read here as straight lines between knots, so that A C = x holds to rounding, through gaps too.

References: Wahba G. Spline Models for Observational Data, SIAM 1990 (kernel and minimiser),
doi:10.1137/1.9781611970128; Boneva LI, Kendall D, Stefanov I. J R Stat Soc B 1971;33:1-71 (histosplines).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import Forcing, PiecewiseLinear

Array = NDArray[np.float64]

#: Straight lines a frame.
_PIECES = 4


@dataclass(frozen=True)
class Smoothest:
    """The smoothest curve through frame values, as a linear map of them.

    Args:
        times: knots, min (n,).
        weights: values at the knots of the curve that belongs to each unit frame value (K, n).
    """

    times: Array
    weights: Array

    @property
    def responses(self) -> PiecewiseLinear:
        """The curves of all unit frame values, a batch (K,)."""
        return PiecewiseLinear(self.times, self.weights)

    def through(self, values: Array) -> PiecewiseLinear:
        """The curve that reports these frame values (K,), kBq/mL over min."""
        return PiecewiseLinear(self.times, values @ self.weights)


def smoothest(edges: Array, report: Callable[[Forcing], Array]) -> Smoothest:
    """How frame values make a curve.

    Args:
        edges: starts and ends of the frames, min, any order.
        report: frame values (..., K) of a curve, or of a batch of them; linear.
    """
    from scipy.linalg import cho_factor, cho_solve

    edges = np.unique(np.append(edges, 0.0))
    share = np.arange(_PIECES) / _PIECES
    times = np.append((edges[:-1, None] + np.diff(edges)[:, None] * share).ravel(), edges[-1])
    reported = report(PiecewiseLinear(times, np.eye(len(times))))  # (n, K)
    spread = _kernel(np.log1p(times)) @ reported
    scale = 1.0 / np.sqrt(np.einsum("nk,nk->k", reported, spread))
    normal = scale[:, None] * (reported.T @ spread) * scale
    weights = scale[:, None] * cho_solve(cho_factor(normal), (spread * scale).T)
    # Hundreds of frames make the normal matrix nearly singular: once more on what is left restores A C = x.
    return Smoothest(times, 2.0 * weights - (weights @ reported) @ weights)


def _kernel(s: Array) -> Array:
    """G of int (C'')^2 ds with C(0) = C'(0) = 0: int_0^min (s - u)(s' - u) du."""
    low, high = np.minimum.outer(s, s), np.maximum.outer(s, s)
    return low**2 * (3.0 * high - low) / 6.0
