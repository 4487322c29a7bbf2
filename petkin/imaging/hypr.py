"""HYPR-LR: frames that take their edges from the sum of all frames, and only their contrast over time from themselves.

Reference: Christian BT et al. Dynamic PET denoising with HYPR processing. J Nucl Med 2010;51:1147-1154.
doi:10.2967/jnumed.109.073999
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.imaging.point_spread import blur

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

#: Where the smoothed composite is below this share of its maximum there is no activity to take a ratio to.
_NOTHING = 1e-3


def composite_image(
    frames: Iterable[Float[NDArray, "x y z"]], weights: Float[NDArray, " frames"]
) -> Float[NDArray, "x y z"]:
    """The weighted mean of all frames, as sharp as they are and with the least noise.

        C = sum_k w_k I_k / sum_k w_k

    With w_k = int_k e^(-lambda t) dt, C of decay-corrected frames is the image of all counts: the sum of the frames
    before their decay correction, each weighted by its duration, as the method was published.

    Args:
        frames: decay-corrected frames, read once.
        weights: w_k, min.

    Returns:
        C, float64; not finite where any frame is not.

    Raises:
        InputError: no frames, or not one weight a frame.
    """
    total = None
    with np.errstate(invalid="ignore"):  # inf - inf is NaN, as it should be
        for frame, weight in zip(frames, weights, strict=True):
            total = np.zeros(frame.shape) if total is None else total
            total += np.float64(weight) * frame
    if total is None:
        raise InputError("There are no frames to take a composite image of.")
    return total / weights.sum()


def hypr_lr(
    frames: Iterable[Float[NDArray, "x y z"]],
    composite: Float[NDArray, "x y z"],
    inside: Bool[NDArray, "x y z"],
    *,
    fwhm: float,
    voxel_size: Sequence[float],
) -> Iterator[Float[NDArray, "x y z"]]:
    """Frames denoised one after the other.

        H_k = C (F * I_k) / (F * C),   F a Gaussian

    Both convolutions leave out the same voxels: those outside the mask or the grid, and those that are not finite. So
    nothing leaks in from there, edges do not darken, and a series whose voxels all have the same curve up to a factor
    comes back as it was. Voxels left out, and those where F * C holds nothing, keep their values. The composite of the
    result is C itself. Voxels of the result share their noise over about one FWHM: a fit's standard errors, which take
    the scatter of a curve for all of its noise, do not hold for them.

    Args:
        frames: I_k, read once.
        composite: C, see `composite_image`: it needs all frames before the first can be denoised.
        inside: the mask.
        fwhm: full width at half maximum of F, mm.
        voxel_size: mm, one value an axis.

    Yields:
        H_k, of the frames' own type.
    """
    used = inside & np.isfinite(composite)
    smooth = blur(np.where(used, composite, 0.0), fwhm, voxel_size)
    held = used & (smooth > _NOTHING * smooth.max())
    detail = np.divide(composite, smooth, out=np.zeros_like(smooth), where=held)
    for frame in frames:
        low = blur(np.where(used, frame, 0.0), fwhm, voxel_size)
        yield np.where(held, detail * low, frame).astype(frame.dtype)
