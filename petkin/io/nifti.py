"""NIfTI images read frame by frame while they decompress; a series is never whole in memory."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.io.nifti_header import MAGIC_BYTES, ImageHeader, parse_header

try:  # about three times as fast as zlib; what is read does not depend on it
    from isal import igzip, isal_zlib

    _open_gzip = igzip.open
    _DECOMPRESSION_ERRORS: tuple[Any, ...] = (zlib.error, isal_zlib.error, EOFError, OSError)
except ImportError:
    _open_gzip = gzip.open
    _DECOMPRESSION_ERRORS = (zlib.error, EOFError, OSError)

_GZIP_MAGIC = b"\x1f\x8b"
#: Types whose values float32 holds exactly; wider ones are scaled in float64 first.
_NARROW = {"u1", "i1", "u2", "i2", "f4"}


@dataclass(frozen=True)
class Series:
    """A dynamic image on disk.

    Args:
        path: the file.
        header: what it holds.
        factors: factor per frame (K,) applied to the scaled values, e.g. to kBq/mL at time zero; empty for none.
    """

    path: Path
    header: ImageHeader
    factors: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along x, y, z."""
        return self.header.shape

    @property
    def count(self) -> int:
        """Frames."""
        return self.header.count

    @property
    def affine(self) -> NDArray[np.float64]:
        """Voxel indices to mm, (4, 4)."""
        return self.header.affine

    @property
    def voxel_mm(self) -> NDArray[np.float64]:
        """Voxel edge lengths, mm, (3,)."""
        return voxel_sizes(self.affine)

    def frames(self) -> Iterator[NDArray[np.float32]]:
        """Each frame in file order as a 3-D float32 array [x, y, z], Fortran-ordered as on disk.

        While one is in use the next is already being decompressed.

        Raises:
            InputError: the file ends early or is damaged.
        """
        factors = self.factors if self.factors.size else np.ones(self.count)
        for raw, factor in zip(_ahead(_raw_frames(self.path, self.header)), factors, strict=True):
            yield _scaled(raw, self.header.slope * factor, self.header.intercept * factor)


def open_series(
    path: Path, *, frames: FrameSchedule | None = None, factors: NDArray[np.float64] | None = None
) -> Series:
    """A dynamic image, its header checked.

    Args:
        path: .nii or .nii.gz, 4-D.
        frames: schedule that it must agree with in number.
        factors: factor per frame (K,); None for 1.

    Raises:
        InputError: unreadable, not 4-D, more or fewer frames than the schedule, or a size that the file cannot hold.
    """
    header = _read_header(path)
    if header.dimensions != 4:
        raise InputError(f"{path}: has 3 dimensions; a dynamic image needs a fourth, one entry a frame.")
    if frames is not None and len(frames) != header.count:
        raise InputError(
            f"{path}: holds {header.count} frames but {frames.where} lists {len(frames)}; they must agree."
        )
    return Series(path, header, np.empty(0) if factors is None else np.asarray(factors, np.float64))


def read_volume(path: Path) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """A 3-D image and its affine.

    Raises:
        InputError: unreadable, or more than one frame.
    """
    header = _read_one(path)
    (raw,) = _raw_frames(path, header)
    return _scaled(raw, header.slope, header.intercept), header.affine


def read_label_volume(path: Path) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """A 3-D image of integer labels and its affine.

    Raises:
        InputError: unreadable, more than one frame, or values that are not integers.
    """
    header = _read_one(path)
    (raw,) = _raw_frames(path, header)
    values = raw.astype(np.float64) * header.slope + header.intercept
    labels = np.rint(np.nan_to_num(values, nan=0.5, posinf=0.5, neginf=0.5)).clip(-(2**31), 2**31 - 1).astype(np.int32)
    if not np.array_equal(labels, values):
        raise InputError(f"{path}: holds values that are not integers; a segmentation has one integer label a region.")
    return labels, header.affine


def voxel_sizes(affine: NDArray[np.float64]) -> NDArray[np.float64]:
    """Voxel edge lengths, mm, (3,)."""
    return np.sqrt((affine[:3, :3] ** 2).sum(axis=0))


def require_same_grid(shape: tuple[int, ...], affine: NDArray[np.float64], series: Series, *, what: str) -> None:
    """Whether an image lies voxel by voxel on a series.

    Raises:
        InputError: another shape, or a corner of the grid more than a tenth of a voxel away.
    """
    if tuple(shape) != series.shape:
        mine, theirs = " x ".join(map(str, shape)), " x ".join(map(str, series.shape))
        raise InputError(
            f"{what}: is {mine} voxels but {series.path.name} is {theirs}; resample it to the image's grid."
        )
    corners = np.array(np.meshgrid(*((0, n - 1) for n in shape), (1,), indexing="ij")).reshape(4, -1)
    shift_mm = float(np.linalg.norm(((affine - series.affine) @ corners)[:3], axis=0).max())
    if shift_mm > 0.1 * series.voxel_mm.min():
        raise InputError(
            f"{what}: lies up to {shift_mm:.3g} mm off the grid of {series.path.name} (their affines differ); resample "
            "it to the image's grid."
        )


def _scaled(raw: NDArray, slope: float, intercept: float) -> NDArray[np.float32]:
    wide = raw.dtype.str[1:] not in _NARROW
    values = raw.astype(np.float64 if wide else np.float32, order="K", copy=False)
    if slope != 1.0:
        values *= values.dtype.type(slope)
    if intercept != 0.0:
        values += values.dtype.type(intercept)
    with np.errstate(over="ignore"):  # beyond float32 becomes inf, which is counted and reported as such
        return values.astype(np.float32, copy=False)


def _read_one(path: Path) -> ImageHeader:
    header = _read_header(path)
    if header.count != 1:
        raise InputError(f"{path}: holds {header.count} frames where one 3-D image is due.")
    return header


def _read_header(path: Path) -> ImageHeader:
    with _opened(path) as (file, compressed):
        return parse_header(file.read(MAGIC_BYTES), path, compressed=compressed)


def _raw_frames(path: Path, header: ImageHeader) -> Iterator[NDArray]:
    with _opened(path) as (file, _):
        _skip(file, header.offset, path)
        for k in range(header.count):
            buffer = np.empty(header.frame_bytes, np.uint8)
            _fill(file, buffer.data, f"{path}: ends within frame {k + 1} of {header.count}")
            yield buffer.view(header.dtype).reshape(header.shape, order="F")
        file.read(1)  # reaches the checksum of a gzip


def _ahead(items: Iterator[NDArray]) -> Iterator[NDArray]:
    """The same items, the next one made in a thread of its own: decompression leaves the interpreter's lock alone."""
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(next, items, None)
        while (item := waiting.result()) is not None:
            waiting = pool.submit(next, items, None)
            yield item


def _fill(file: BinaryIO, view: memoryview, otherwise: str) -> None:
    filled = 0
    while filled < len(view):
        # BufferedIOBase.readinto; typing's BinaryIO does not list it
        got = cast("gzip.GzipFile", file).readinto(view[filled:])
        if not got:
            raise InputError(f"{otherwise}; it is truncated, copy it again.")
        filled += got


def _skip(file: BinaryIO, count: int, path: Path) -> None:
    if len(file.read(count)) < count:
        raise InputError(f"{path}: ends before its data; it is truncated, copy it again.")


@contextmanager
def _opened(path: Path) -> Iterator[tuple[BinaryIO, bool]]:
    """The file's decompressed bytes, and whether it is a gzip (told by its first bytes, not by its name)."""
    try:
        with path.open("rb") as plain:
            compressed = plain.read(2) == _GZIP_MAGIC
        if path.name.endswith(".gz") and not compressed:
            raise InputError(f"{path}: is named .gz but is not a gzip file; rename or compress it.")
        opener = _open_gzip if compressed else Path.open
        with cast("BinaryIO", opener(path, "rb")) as file:
            yield file, compressed
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file.") from error
    except _DECOMPRESSION_ERRORS as error:
        raise InputError(f"{path}: cannot be read, truncated or damaged ({error}); copy it again.") from error
