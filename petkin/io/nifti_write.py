"""NIfTI images written the same to the byte every time: zlib through the standard gzip, no time stamp, no file name."""

from __future__ import annotations

import gzip
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.io.atomic import atomic_file, write_text
from petkin.io.jsonfile import json_text
from petkin.io.names import sidecar_path

#: zlib even where a faster library is installed: what is written must not depend on what else is.
_LEVEL = 1
_STORED = {"float32", "int16", "int32", "uint8"}


def write_map(path: Path, values: NDArray, affine: NDArray[np.float64], sidecar: Mapping[str, Any]) -> None:
    """Write a 3-D map as .nii.gz and its JSON, each whole or not at all.

    Args:
        path: ends in .nii.gz; the JSON gets the same name.
        values: [x, y, z]; float32, int16, int32 or uint8 are stored as they are, other types as float32.
        affine: voxel indices to mm, (4, 4).
        sidecar: fields of the JSON.

    Raises:
        InputError: the folder cannot be written.
    """
    stored = values if values.dtype.name in _STORED else values.astype(np.float32)
    header = _header(values.shape, affine, stored.dtype)
    with _gzip_file(path) as file:
        file.write(header)
        file.write(np.ascontiguousarray(stored.astype(stored.dtype.newbyteorder("<"), copy=False).T).data)
    write_text(path.with_name(sidecar_path(PurePosixPath(path.name)).name), json_text(sidecar))


def write_series(
    path: Path, frames: Iterable[NDArray], affine: NDArray[np.float64], *, count: int, slope: float | None = None
) -> None:
    """Write a dynamic image frame by frame as .nii.gz, whole or not at all.

    Args:
        path: ends in .nii.gz.
        frames: 3-D arrays [x, y, z] of one shape.
        affine: voxel indices to mm, (4, 4).
        count: how many frames there will be.
        slope: None stores float32; a number stores int16 with value = slope x stored.

    Raises:
        InputError: another number of frames, or a value that int16 cannot hold at this slope.
    """
    written = 0
    with _gzip_file(path) as file:
        for frame in frames:
            if written == 0:
                file.write(_header((*frame.shape, count), affine, np.dtype("<f4" if slope is None else "<i2"), slope))
            file.write((frame.astype("<f4") if slope is None else _as_int16(frame, slope, path)).tobytes(order="F"))
            written += 1
        if written != count:
            raise InputError(f"{path}: {written} frames were given to write, {count} were announced.")


def _as_int16(frame: NDArray, slope: float, path: Path) -> NDArray[np.int16]:
    stored = np.rint(frame / slope)
    if not np.isfinite(stored).all() or np.abs(stored).max() > 32767:
        raise InputError(f"{path}: a value does not fit int16 at slope {slope:g}; use a larger slope or float32.")
    return stored.astype("<i2")


def _header(shape: tuple[int, ...], affine: NDArray[np.float64], dtype: np.dtype, slope: float | None = None) -> bytes:
    from nibabel.nifti1 import Nifti1Header

    if max(shape) > 32767:
        raise InputError(f"An image of {' x '.join(map(str, shape))} voxels is too large for NIfTI-1 (32767 an axis).")
    header = Nifti1Header(endianness="<")
    header.set_data_dtype(dtype)
    header.set_data_shape(shape)
    header.set_qform(affine, code=1)
    header.set_sform(affine, code=1)
    header.set_xyzt_units("mm", "sec")
    header["scl_slope"], header["scl_inter"] = 1.0 if slope is None else slope, 0.0
    header["vox_offset"] = 352
    return header.binaryblock + b"\0\0\0\0"


@contextmanager
def _gzip_file(path: Path) -> Iterator[gzip.GzipFile]:
    with atomic_file(path) as raw, gzip.GzipFile("", "wb", compresslevel=_LEVEL, fileobj=raw, mtime=0) as file:
        yield file
