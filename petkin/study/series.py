"""Curves out of a dynamic image: voxels inside the mask, and means over regions, in one pass over the frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.io import RegionalCurves, Regions, Series, read_label_volume, require_same_grid

#: Without a mask, voxels whose mean activity exceeds this share of the 98th percentile are taken for the object.
_OBJECT_SHARE = 0.15


@dataclass(frozen=True)
class VoxelCurves:
    """Curves of the voxels in a mask.

    Args:
        values: (K, N) float32, kBq/mL: frames first and voxels in the file's (Fortran) order.
        mask: [x, y, z].
        series: where they come from.
        how: one sentence on how the mask was made.
    """

    values: NDArray[np.float32]
    mask: NDArray[np.bool_]
    series: Series
    how: str

    @property
    def mean(self) -> NDArray[np.float64]:
        """Mean curve of the finite voxels (K,)."""
        finite = np.asarray(np.isfinite(self.values).all(axis=0))
        if not finite.any():
            raise InputError(f"{self.series.path}: no voxel in the mask holds finite values in every frame.")
        return self.values.mean(axis=1, dtype=np.float64, where=finite[None, :])

    def volume(self, values: NDArray, outside: float) -> NDArray:
        """One value a voxel (N,) back on the grid, `outside` elsewhere."""
        flat = np.full(self.mask.size, outside, values.dtype)
        flat[self.mask.ravel(order="F")] = values
        return flat.reshape(self.mask.shape, order="F")


def choose_mask(
    series: Series, frames: FrameSchedule, mask: Path | None, regions: Regions | None
) -> tuple[NDArray[np.bool_], str]:
    """Voxels to fit: those of a mask file; else of the segmentation; else those that hold activity.

    Raises:
        InputError: another grid than the image's, or an empty mask.
    """
    if mask is not None:
        labels, affine = read_label_volume(mask)
        require_same_grid(labels.shape, affine, series, what=mask.name)
        chosen, how = labels > 0, f"Voxels: the mask {mask.name}."
    elif regions is not None:
        chosen, how = regions.labels > 0, f"Voxels: all labels of {regions.where}."
    else:
        mean = np.zeros(series.shape)
        for k, frame in enumerate(series.frames()):
            mean += np.nan_to_num(frame, nan=0.0, posinf=0.0, neginf=0.0) * frames.duration[k]
        chosen = mean > _OBJECT_SHARE * np.percentile(mean, 98)
        how = f"Voxels: mean activity above {_OBJECT_SHARE:.0%} of its 98th percentile, for want of a mask."
    if not chosen.any():
        raise InputError(f"{mask.name if mask else series.path.name}: the mask is empty; there is no voxel to fit.")
    return chosen, how


def extract(
    series: Series, frames: FrameSchedule, mask: NDArray[np.bool_] | None, how: str, regions: Regions | None
) -> tuple[VoxelCurves | None, RegionalCurves | None]:
    """Voxel curves inside `mask` and mean curves of `regions`, reading the file once.

    A region's mean leaves out voxels that are not finite.
    """
    flat_mask = None if mask is None else mask.ravel(order="F")
    voxels = None if flat_mask is None else np.empty((series.count, int(flat_mask.sum())), np.float32)
    sums = None if regions is None else _RegionSums(regions, series.count)
    for k, frame in enumerate(series.frames()):
        flat = frame.ravel(order="F")
        if voxels is not None and flat_mask is not None:
            voxels[k] = flat[flat_mask]
        if sums is not None:
            sums.add(k, flat)
    curves = None if sums is None else sums.curves(frames, series)
    if voxels is None or mask is None:
        return None, curves
    return VoxelCurves(voxels, mask, series, how), curves


class _RegionSums:
    """Running sums over the labels of a segmentation."""

    def __init__(self, regions: Regions, frames: int) -> None:
        self.regions = regions
        labels = regions.labels.ravel(order="F")
        self.inside = np.flatnonzero(labels > 0)
        self.place = np.searchsorted(np.array(regions.index), labels[self.inside])
        self.means = np.full((len(regions.index), frames), np.nan)

    def add(self, k: int, flat: NDArray[np.float32]) -> None:
        values = flat[self.inside].astype(np.float64)
        finite = np.isfinite(values)
        size = len(self.regions.index)
        total = np.bincount(self.place, np.where(finite, values, 0.0), size)
        count = np.bincount(self.place, finite, size)
        self.means[:, k] = np.divide(total, count, out=np.full(size, np.nan), where=count > 0)

    def curves(self, frames: FrameSchedule, series: Series) -> RegionalCurves:
        regions = self.regions
        return RegionalCurves(
            regions.names,
            self.means,
            frames,
            regions.seg,
            regions.desc,
            regions.volumes,
            f"{series.path.name} over {regions.where}",
            index=regions.index,
        )
