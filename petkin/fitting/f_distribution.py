"""The F distribution, for who needs it: what holds it takes longer to load than most fits of regions take."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def quantile(chance: float, numerator: float, denominator: float) -> float:
    """The value that F with so many degrees of freedom stays below with this chance."""
    from scipy.special import fdtri

    return float(fdtri(numerator, denominator, chance))


def exceeded(value: ArrayLike, numerator: float, denominator: float) -> NDArray:
    """The chance that F with so many degrees of freedom exceeds a value; 1 below zero, as rounding leaves."""
    from scipy.special import fdtrc

    return fdtrc(numerator, denominator, np.maximum(value, 0.0))
