"""Curves out of a dynamic image: voxels inside the mask, and means over regions, in one pass over the frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.io import RegionalCurves, Regions, Rows, Series, read_label_volume, read_regions, require_same_grid
from petkin.io.remarks import Remark, warning
from petkin.study.resources import Plan
from petkin.study.sources import Source

#: Without a mask, voxels whose mean activity exceeds this share of the 98th percentile are taken for the object.
_OBJECT_SHARE = 0.15


#: Voxels looked at together for a mean: sums in the same order whatever fits into memory.
_TOGETHER = 65536


@dataclass(frozen=True)
class VoxelCurves:
    """Curves of the voxels in a mask.

    Args:
        rows: frames first and voxels in the file's (Fortran) order, (K, N), kBq/mL.
        mask: [x, y, z].
        series: where they come from.
        how: one sentence on how the mask was made.
        mean: mean curve of the voxels that are finite in every frame (K,).
        not_finite: how many are not.
        negative: share of all values below zero.
        plan: how many are handled at a time.
    """

    rows: Rows
    mask: NDArray[np.bool_]
    series: Series
    how: str
    mean: NDArray[np.float64]
    not_finite: int
    negative: float
    plan: Plan

    @classmethod
    def summed_up(cls, rows: Rows, mask: NDArray[np.bool_], series: Series, how: str, plan: Plan) -> VoxelCurves:
        """With what is known of all of them together.

        Raises:
            InputError: no voxel is finite.
        """
        frames, count = rows.array.shape
        total, usable, negative = np.zeros(frames), 0, 0
        for start in range(0, count, _TOGETHER):
            block = rows.array[:, start : start + _TOGETHER]
            finite = np.isfinite(block).all(axis=0)
            total += block[:, finite].sum(axis=1, dtype=np.float64)
            usable += int(np.count_nonzero(finite))
            negative += int(np.count_nonzero(block < 0))
            rows.release()
        if not usable:
            raise InputError(f"{series.path}: no voxel in the mask holds finite values in every frame.")
        return cls(rows, mask, series, how, total / usable, count - usable, negative / rows.array.size, plan)

    @property
    def count(self) -> int:
        """Voxels."""
        return self.rows.array.shape[1]

    def volume(self, values: NDArray, outside: float) -> NDArray:
        """One value a voxel (N,) back on the grid, `outside` elsewhere."""
        flat = np.full(self.mask.size, outside, values.dtype)
        flat[self.mask.ravel(order="F")] = values
        self.plan.release()
        return flat.reshape(self.mask.shape, order="F")


class StoredValues:
    """One value a voxel, copied whenever it is looked at: for reports on maps that do not fit into memory.

    Args:
        voxels: whose values.
        values: (N,), in a file.
    """

    def __init__(self, voxels: VoxelCurves, values: NDArray[np.float32]) -> None:
        self.shape = values.shape
        self._plan, self._values = voxels.plan, values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[np.float32]:
        values = self._values.astype(dtype or self._values.dtype)
        self._plan.release()
        return values


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


def regional_curves(source: Source) -> RegionalCurves:
    """A scan's table of curves, or the means over its segmentation; what is fitted by region has one of them."""
    if source.curves is not None:
        return source.curves
    assert source.image is not None
    assert source.dseg is not None
    curves = extract(source.image, source.frames, read_regions(source.dseg, source.image))
    assert curves is not None
    return curves


def extract(
    series: Series,
    frames: FrameSchedule,
    regions: Regions | None,
    *,
    mask: NDArray[np.bool_] | None = None,
    into: Rows | None = None,
) -> RegionalCurves | None:
    """Mean curves of `regions` and the curves of the voxels in `mask`, reading the file once.

    A region's mean leaves out voxels that are not finite.

    Args:
        series: the image.
        frames: its schedule.
        regions: segmentation, or None.
        mask: [x, y, z].
        into: takes the voxels' curves (K, N).
    """
    flat_mask = None if mask is None else mask.ravel(order="F")
    sums = None if regions is None else _RegionSums(regions, series.count)
    for k, frame in enumerate(series.frames()):
        flat = frame.ravel(order="F")
        if flat_mask is not None and into is not None:
            into.array[k] = flat[flat_mask]
            into.release()
        if sums is not None:
            sums.add(k, flat)
    return None if sums is None else sums.curves(frames, series)


class _RegionSums:
    """Running sums over the labels of a segmentation."""

    def __init__(self, regions: Regions, frames: int) -> None:
        self.regions = regions
        labels = regions.labels.ravel(order="F")
        self.inside = np.flatnonzero(labels > 0)
        self.place = np.searchsorted(np.array(regions.index), labels[self.inside])
        self.means = np.full((len(regions.index), frames), np.nan)
        self.lacking = np.zeros(len(self.inside), np.bool_)

    def add(self, k: int, flat: NDArray[np.float32]) -> None:
        values = flat[self.inside].astype(np.float64)
        finite = np.isfinite(values)
        self.lacking |= ~finite
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
            self._remarks(series),
            index=regions.index,
        )

    def _remarks(self, series: Series) -> tuple[Remark, ...]:
        if not self.lacking.any():
            return ()
        among = np.unique(self.place[self.lacking])
        where = self.regions.names[among[0]] if len(among) == 1 else f"{len(among)} regions"
        text = (
            f"{self.lacking.sum()} voxels of {where} hold NaN or infinite values in some frame; means over regions "
            "leave them out there."
        )
        return (warning("region-not-finite", series.path.name, text),)
