"""What a NIfTI header promises, checked before a byte of the image is read or allocated."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError

#: NIfTI datatype codes read here (nifti1.h); colour and complex images are no activity.
_DTYPES = {
    2: "u1",
    4: "i2",
    8: "i4",
    16: "f4",
    64: "f8",
    256: "i1",
    512: "u2",
    768: "u4",
}
#: One frame of a total-body scanner at 1 mm is 4e8 voxels.
_MOST_VOXELS = 2**29
_MOST_FRAMES = 100_000
#: Extensions between header and data; DICOM headers kept there stay far below.
_FURTHEST_DATA = 64 * 2**20
#: Deflate cannot shrink data further than this (RFC 1951: 258 bytes in two bits).
_DEFLATE_LIMIT = 1032
MAGIC_BYTES = 540


@dataclass(frozen=True)
class ImageHeader:
    """Geometry and storage of a NIfTI-1 or -2 file.

    Args:
        shape: voxels along x, y, z.
        count: frames; 1 for a 3-D file.
        dimensions: 3 or 4, as the file says.
        affine: voxel indices to mm, (4, 4).
        dtype: stored type with its byte order.
        offset: first byte of the data.
        slope: value = slope x stored + intercept.
        intercept: see slope.
    """

    shape: tuple[int, int, int]
    count: int
    dimensions: int
    affine: NDArray[np.float64]
    dtype: np.dtype
    offset: int
    slope: float
    intercept: float

    @property
    def frame_bytes(self) -> int:
        return int(np.prod(self.shape, dtype=np.int64)) * self.dtype.itemsize


def parse_header(block: bytes, path: Path, *, compressed: bool) -> ImageHeader:
    """Read and check the first `MAGIC_BYTES` bytes of a file.

    Args:
        block: decompressed start of the file.
        path: the file, for its size and for messages.
        compressed: whether it is a gzip.

    Raises:
        InputError: not NIfTI, not 3-D or 4-D, colour or complex, a size that the file cannot hold, a useless affine.
    """
    from nibabel.nifti1 import Nifti1Header
    from nibabel.nifti2 import Nifti2Header

    sizes = {int(np.frombuffer(block[:4], order + "i4")[0]): order for order in "<>"} if len(block) >= 4 else {}
    length = next((size for size in (348, 540) if size in sizes), None)
    if length is None or len(block) < length:
        raise InputError(f"{path}: not a NIfTI image (no header of 348 or 540 bytes); convert it to .nii.gz.")
    kind = Nifti1Header if length == 348 else Nifti2Header
    header = kind.from_fileobj(io.BytesIO(block), check=False)
    if header["magic"].item()[:3] not in (b"n+1", b"n+2"):
        raise InputError(f"{path}: header and image are two files (.hdr/.img); convert them to one .nii.gz.")
    shape, count, dimensions = _extent([int(n) for n in header["dim"]], path)
    code = int(header["datatype"])
    if code not in _DTYPES:
        raise InputError(f"{path}: NIfTI datatype {code} is no real number; convert the image to float32.")
    parsed = ImageHeader(
        shape, count, dimensions, _affine(header, path), np.dtype(sizes[length] + _DTYPES[code]),
        _offset(float(header["vox_offset"]), length, path), *_scaling(header, path),
    )  # fmt: skip
    _check_size(parsed, path, compressed=compressed)
    return parsed


def _extent(dim: list[int], path: Path) -> tuple[tuple[int, int, int], int, int]:
    rank = dim[0]
    if not 3 <= rank <= 7 or any(n < 1 for n in dim[1 : rank + 1]) or any(n > 1 for n in dim[5 : rank + 1]):
        raise InputError(f"{path}: dimensions {dim} are not those of a 3-D image or a series of them.")
    shape, count = (dim[1], dim[2], dim[3]), dim[4] if rank >= 4 else 1
    if shape[0] * shape[1] * shape[2] > _MOST_VOXELS or count > _MOST_FRAMES:
        size = " x ".join(map(str, (*shape, count)))
        raise InputError(f"{path}: the header promises {size} voxels, more than a frame can have; the file is damaged.")
    return shape, count, 4 if rank >= 4 else 3


def _affine(header, path: Path) -> NDArray[np.float64]:
    from nibabel.spatialimages import HeaderDataError

    try:
        affine = np.asarray(header.get_best_affine(), np.float64)
    except (HeaderDataError, ValueError) as error:
        raise InputError(f"{path}: the header's orientation cannot be read ({error}).") from error
    if not np.isfinite(affine).all() or abs(np.linalg.det(affine[:3, :3])) < 1e-12:
        raise InputError(f"{path}: the header's affine is not finite or flat, so the voxels have no place; repair it.")
    return affine


def _offset(offset: float, length: int, path: Path) -> int:
    if not 0 <= offset <= _FURTHEST_DATA:
        raise InputError(f"{path}: the header says that data start at byte {offset:g}; the file is damaged.")
    return max(int(offset), length + 4)


def _scaling(header, path: Path) -> tuple[float, float]:
    """Slope and intercept; a slope of 0 or NaN means none, as the standard says."""
    slope, intercept = float(header["scl_slope"]), float(header["scl_inter"])
    if slope == 0 or np.isnan(slope):
        return 1.0, 0.0
    if not np.isfinite(slope) or not np.isfinite(intercept):
        raise InputError(f"{path}: scl_slope {slope} and scl_inter {intercept} are not finite; the file is damaged.")
    return slope, intercept


def _check_size(header: ImageHeader, path: Path, *, compressed: bool) -> None:
    promised, there = header.offset + header.frame_bytes * header.count, path.stat().st_size
    if compressed and promised > there * _DEFLATE_LIMIT + 1024:
        raise InputError(
            f"{path}: the header promises {promised} bytes, more than a gzip of {there} bytes can hold; the file is "
            "truncated or damaged."
        )
    if not compressed and promised > there:
        raise InputError(f"{path}: the header promises {promised} bytes but the file has {there}; it is truncated.")
