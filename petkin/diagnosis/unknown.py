"""A gap of no name: a smooth discrepancy in every channel, orthogonal to what a refit can do.

    delta_c(t) = f_c(t) sum_j w_j phi_j(x) (a_j + b_cj),   x = log(t + 1) rescaled to 0..1,  phi_j = cos(pi j x)

a Gaussian process with a cosine basis, of which a part is common to all channels; only what the projection leaves of it
counts, so that it can never take what the simulator's own parameters explain.

Reference: Plumlee M. Bayesian calibration of inexact computer models. J Am Stat Assoc 2017;112:1274-1285.
doi:10.1080/01621459.2016.1211016
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Cosines, and the power by which they fade: rougher discrepancies are less likely.
_COUNT, _FADING = 10, 1.0


def discrepancies(values: Array, times: Array) -> Array:
    """Columns (n, C, K) of the discrepancy: one block common to all channels, then one a channel.

    Args:
        values: predicted (C, K).
        times: of the samples (K,).
    """
    x = np.log(times + 1.0)
    x = (x - x[0]) / (x[-1] - x[0])
    j = np.arange(_COUNT)
    cosines = np.cos(np.pi * j[:, None] * x) * (1.0 + j[:, None]) ** -_FADING
    level = values.mean(axis=1, keepdims=True)
    common = cosines[:, None, :] * values[None]
    alone = np.eye(len(values))[None, :, :, None] * (
        cosines[:, None, None, :] * (0.5 * values + 0.5 * level)[None, None]
    )
    return np.concatenate([common, alone.reshape(-1, *values.shape)])
