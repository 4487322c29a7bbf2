"""What every fit asks of its curves and weights before it starts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError

Array = NDArray[np.float64]

#: Activity (kBq/mL) from which on a value counts as infinite: its square must stay a number.
_LARGEST = 1e30


def check_shapes(curves: NDArray[np.floating], weights: Array, frames: int) -> None:
    """Curves (N, K), weights (K,) or (N, K).

    Raises:
        InputError: they do not match each other or the frames, or weights are negative or not finite.
    """
    if curves.ndim != 2 or curves.shape[1] != frames:
        raise InputError(f"Curves of shape {curves.shape} do not match {frames} frames; give one row a curve.")
    if weights.shape not in ((frames,), curves.shape):
        raise InputError(
            f"Weights of shape {weights.shape} match neither the {frames} frames nor the curves {curves.shape}."
        )
    if not np.isfinite(weights).all() or (weights < 0).any():
        raise InputError("Frame weights must be finite and not negative.")


def finite_curves(curves: NDArray[np.floating]) -> tuple[NDArray[np.bool_], Array]:
    """Which curves hold numbers alone (N,), and all of them in double precision with zeros for the others (N, K)."""
    finite = np.asarray((np.abs(curves) < _LARGEST).all(axis=1))
    return finite, np.ascontiguousarray(np.where(finite[:, None], curves, 0.0), np.float64)
