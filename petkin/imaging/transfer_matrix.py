"""Partial volume: how the point spread mixes the activity of regions, and how to undo it.

Reference: Rousset OG, Ma Y, Evans AC. Correction for partial volume effects in PET: principle and validation.
J Nucl Med 1998;39:904-911.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.imaging.point_spread import blur, gaussian_kernel

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

#: An unlabelled voxel belongs to the background if blurred labels put this share into it, about one FWHM away.
_EXCHANGES = 0.01
#: From this condition number on, an error of one part in ten thousand in image or labels is as large as the result.
_SINGULAR = 1e4
#: Regions named as the cause have at least this share of the largest weight in the direction that is lost.
_TAKES_PART = 0.5


@dataclass(frozen=True)
class TransferMatrix:
    """What share of each region's observed mean comes from which region.

        t_i = sum_j w_ij T_j,   w_ij = 1/n_i sum over voxels of i of (h * 1_j)

    t observed, T true means, h the point spread, 1_j the indicator of region j, n_i voxels in region i.

    Args:
        names: of the regions, (R,).
        weights: w, (R, R).
        voxels: n, (R,).
    """

    names: tuple[str, ...]
    weights: Float[NDArray, "R R"]
    voxels: Int[NDArray, " R"]

    @property
    def condition(self) -> float:
        """Condition number of w: the largest factor by which a relative error of all means can grow."""
        return float(np.linalg.cond(self.weights))

    @property
    def noise_factor(self) -> Float[NDArray, " R"]:
        """By how much the correction raises the standard deviation of each region's curve.

            f_i^2 = sum_j (w^-1)_ij^2 n_i / n_j

        for means over n_j voxels that all have the same variance and do not know of each other.
        """
        inverse = np.linalg.inv(self.weights)
        return np.sqrt((inverse**2 * self.voxels[:, None] / self.voxels).sum(axis=1))

    def corrected(self, curves: Float[NDArray, "R frames"]) -> Float[NDArray, "R frames"]:
        """True means T of the regions from observed ones, frame by frame.

        Raises:
            InputError: some regions cannot be told apart, or one has no value in some frame.
        """
        missing = np.flatnonzero(~np.isfinite(curves).all(axis=1))
        if missing.size:
            raise InputError(
                f"Region {self.names[missing[0]]!r} holds no finite values in some frame, so that what it spills into "
                "its neighbours is unknown: take it out of the segmentation, or leave the correction out."
            )
        if self.condition > _SINGULAR:
            raise InputError(
                f"Regions {', '.join(self._confused)} cannot be told apart at this point spread (condition number "
                f"{self.condition:.2g} of the geometric transfer matrix): merge them, or give a narrower one."
            )
        return np.linalg.solve(self.weights, curves)

    @property
    def _confused(self) -> list[str]:
        lost = np.abs(np.linalg.svd(self.weights)[2][-1])
        return [name for name, share in zip(self.names, lost, strict=True) if share >= _TAKES_PART * lost.max()]


def background_rim(labels: Int[NDArray, "x y z"], fwhm: float, voxel_size: Sequence[float]) -> Bool[NDArray, "x y z"]:
    """Unlabelled voxels near enough to a label to exchange activity with it: up to about one FWHM away.

    What surrounds the labels is seldom like the rest of the image, of which most is air.
    """
    return (labels == 0) & (blur((labels > 0).astype(np.float32), fwhm, voxel_size) >= _EXCHANGES)


def transfer_matrix(
    labels: Int[NDArray, "x y z"],
    names: dict[int, str],
    *,
    background: int | None,
    fwhm: float,
    voxel_size: Sequence[float],
) -> TransferMatrix:
    """The matrix of a segmentation under a Gaussian point spread.

    The background is a region like the others, but reaches on over all voxels without a name and out of the grid: an
    image of one value stays one. Without a background, whatever is not named counts as empty.

    Args:
        labels: an integer a voxel.
        names: of the regions by label; each occurs in `labels`. The result has them in the order of their labels.
        background: label of the region that stands for all that has no name; see `background_rim`.
        fwhm: full width at half maximum of the point spread, mm.
        voxel_size: mm, one value an axis.
    """
    from scipy.ndimage import find_objects

    order = sorted(names)
    place = np.searchsorted(order, labels).astype(np.int32)
    place[np.append(order, -1)[place] != labels] = len(order)
    voxels = np.bincount(place.ravel(), minlength=len(order) + 1)[: len(order)]
    weights = np.zeros((len(order), len(order)))
    for j, box in enumerate(find_objects(place + 1, max_label=len(order))):
        if order[j] != background:
            weights[:, j] = _received(place, j, box, fwhm, voxel_size, len(order)) / voxels
    if background is not None:
        weights[:, order.index(background)] = 1.0 - weights.sum(axis=1)
    return TransferMatrix(tuple(names[label] for label in order), weights, voxels)


def _received(
    place: NDArray[np.int32], j: int, box: tuple[slice, ...], fwhm: float, voxel_size: Sequence[float], count: int
) -> Float[NDArray, " R"]:
    """Sums over all regions of the blurred indicator of region j, which is zero beyond the reach of the kernel."""
    reach = [gaussian_kernel(fwhm, voxel).size // 2 for voxel in voxel_size]
    near = place[tuple(slice(max(0, s.start - r), s.stop + r) for s, r in zip(box, reach, strict=True))]
    blurred = blur((near == j).astype(np.float64), fwhm, voxel_size)
    return np.bincount(near.ravel(), blurred.ravel(), count + 1)[:count]
