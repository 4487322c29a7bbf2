"""Point spread of the scanner: a Gaussian of given full width at half maximum."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float

#: FWHM = 2 sqrt(2 ln 2) sigma of a Gaussian.
FWHM_PER_SIGMA = 2.0 * math.sqrt(2.0 * math.log(2.0))
_REACH = 5.0  # sigmas; the mass beyond is below 1e-6


def gaussian_kernel(fwhm: float, voxel: float) -> Float[NDArray, " taps"]:
    """The discrete Gaussian: mass 1 and variance sigma^2 exactly, however coarse the voxels are.

        w_j = e^{-s} I_j(s),  s = (sigma / voxel)^2, I_j the modified Bessel function

    A sampled Gaussian loses a third of its variance where FWHM and voxel are alike.

    Args:
        fwhm: full width at half maximum, mm.
        voxel: voxel size along the axis, mm.

    Reference: Lindeberg T. Scale-space for discrete signals. IEEE Trans PAMI 1990;12:234-254. doi:10.1109/34.49051
    """
    from scipy.special import ive

    sigma = fwhm / FWHM_PER_SIGMA / voxel
    reach = math.ceil(_REACH * sigma) + 2
    weights = ive(np.abs(np.arange(-reach, reach + 1)), sigma**2)
    return weights / weights.sum()


def blur(volume: NDArray[np.floating], fwhm: float, voxel_size: Sequence[float]) -> NDArray[np.floating]:
    """Gaussian point spread on the leading, spatial axes; axes beyond them (frames, regions) stay apart.

    Activity spreads into the empty space outside the grid, so the sum is kept as long as the object stays about
    one FWHM away from the edge. An axis of one voxel, as a 2-D phantom has, is left alone.

    Args:
        volume: (x, y, [z], ...), any unit.
        fwhm: full width at half maximum, mm; 0 returns the volume itself.
        voxel_size: mm, one value a spatial axis.

    Raises:
        InputError: negative width, or a voxel size that is not positive.
    """
    from scipy.ndimage import convolve1d

    if not (math.isfinite(fwhm) and fwhm >= 0):
        raise InputError(f"A point spread of {fwhm:g} mm cannot be; give its FWHM, 0 mm or more.")
    if not all(v > 0 for v in voxel_size):
        raise InputError(f"Voxel sizes must be above 0 mm; got {', '.join(f'{v:g}' for v in voxel_size)}.")
    if fwhm == 0:
        return volume
    blurred = volume
    for axis, voxel in enumerate(voxel_size):
        if volume.shape[axis] > 1:
            blurred = convolve1d(blurred, gaussian_kernel(fwhm, voxel), axis=axis, mode="constant")
    return blurred
