"""Frame weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.imaging import FrameSchedule

Array = NDArray[np.float64]

#: Share of the peak below which activity no longer lowers a frame's expected variance (randoms, empty first frames).
_FLOOR = 0.02


def counting_weights(mean_curve: Array, frames: FrameSchedule, decay: float) -> Array:
    """Inverse variances of decay-corrected frame means under counting noise, up to a factor that makes their mean 1.

    var_k ~ C_k e^{lambda t_k} / d_k, hence w_k ~ d_k e^{-lambda t_k} / C_k, C the mean curve of the volume.

    Args:
        mean_curve: C_k, kBq/mL (K,); frames below 2 % of its peak count as 2 %.
        frames: schedule, min.
        decay: lambda, 1/min.

    Returns:
        weights (K,).

    Raises:
        InputError: the curve holds no activity, or a value that is not a number.

    Reference: Yaqub M et al. Optimization algorithms and weighting factors for analysis of dynamic PET studies.
    Phys Med Biol 2006;51:4217-4232. doi:10.1088/0031-9155/51/17/007
    """
    peak = np.max(mean_curve)
    if not (np.isfinite(mean_curve).all() and peak > 0):
        raise InputError(
            f"The mean curve, which frame weights are made from, peaks at {peak:g} kBq/mL; it must hold activity "
            "and no NaN: check the mask and the units."
        )
    level = np.maximum(mean_curve, _FLOOR * peak)
    weights = frames.duration * np.exp(-decay * frames.mid) / level
    return weights / weights.mean()
