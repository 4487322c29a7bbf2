"""NIfTI in and out; nibabel and the gzip module are the independent reader and writer."""

from __future__ import annotations

import gzip
import importlib.util
import struct
import sys
import tracemalloc
from pathlib import Path

import nibabel
import numpy as np
import pytest

from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.io import nifti
from petkin.io.nifti import open_series, read_label_volume, read_volume
from petkin.io.nifti_write import write_map, write_series

AFFINE = np.array([[-2.0, 0.1, 0, 10], [0, 2, 0, -20], [0, 0, 3, 5], [0, 0, 0, 1]])


def save(path: Path, values: np.ndarray, *, endian: str = "<", slope: float | None = None, inter: float = 0.0) -> Path:
    header = nibabel.Nifti1Header(endianness=endian)
    header.set_data_dtype(values.dtype)
    image = nibabel.Nifti1Image(values, AFFINE, header)
    if slope is not None:
        image.header.set_slope_inter(slope, inter)
    nibabel.save(image, path)
    return path


def read_all(path: Path) -> np.ndarray:
    return np.stack(list(open_series(path).frames()), axis=-1)


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
@pytest.mark.parametrize("endian", ["<", ">"])
@pytest.mark.parametrize("dtype", ["u1", "i1", "i2", "u2", "i4", "u4", "f4", "f8"])
def test_all_types_and_byte_orders_are_read_as_nibabel_does(tmp_path: Path, name: str, endian: str, dtype: str) -> None:
    values = (np.random.default_rng(2).uniform(0, 100, (3, 4, 5, 6))).astype(dtype)
    path = save(tmp_path / name, values, endian=endian)
    np.testing.assert_array_equal(read_all(path), nibabel.Nifti1Image.from_filename(path).get_fdata(dtype=np.float32))


def test_nifti_2_is_read(tmp_path: Path) -> None:
    values = np.random.default_rng(3).normal(size=(2, 3, 4, 5)).astype(np.float32)
    nibabel.save(nibabel.Nifti2Image(values, AFFINE), tmp_path / "a.nii.gz")
    np.testing.assert_array_equal(read_all(tmp_path / "a.nii.gz"), values)


def test_scaled_integers_are_read_as_nibabel_does(tmp_path: Path) -> None:
    stored = np.random.default_rng(4).integers(-30000, 30000, (3, 4, 5, 6)).astype(np.int16)
    path = tmp_path / "a.nii"
    header = nibabel.Nifti1Header()
    header.set_data_dtype(np.int16)
    header.set_data_shape(stored.shape)
    header.set_sform(AFFINE, 1)
    header["scl_slope"], header["scl_inter"], header["vox_offset"] = 0.0125, 3.0, 352
    path.write_bytes(header.binaryblock + b"\0" * 4 + stored.tobytes(order="F"))
    np.testing.assert_allclose(read_all(path), nibabel.Nifti1Image.from_filename(path).get_fdata(), rtol=1e-6)
    assert read_all(path)[0, 0, 0, 0] == pytest.approx(stored[0, 0, 0, 0] * 0.0125 + 3.0)


def test_geometry_and_frame_factors(tmp_path: Path) -> None:
    values = np.ones((3, 4, 5, 2), np.float32)
    series = open_series(save(tmp_path / "a.nii.gz", values), factors=np.array([2.0, 3.0]))
    assert (series.shape, series.count) == ((3, 4, 5), 2)
    np.testing.assert_allclose(series.affine, AFFINE, atol=1e-6)
    np.testing.assert_allclose(series.voxel_mm, [2.0, np.hypot(0.1, 2), 3.0], rtol=1e-6)
    assert [frame[0, 0, 0] for frame in series.frames()] == [2.0, 3.0]


def test_a_series_is_never_whole_in_memory(tmp_path: Path) -> None:
    frame = np.zeros((64, 64, 32), np.float32)
    path = tmp_path / "a.nii.gz"
    write_series(path, (frame for _ in range(40)), AFFINE, count=40)
    tracemalloc.start()
    total = sum(float(values.sum()) for values in open_series(path).frames())
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert total == 0.0
    assert peak < 5 * frame.nbytes  # the whole series is 40 frames


def test_frames_must_agree_with_the_schedule(tmp_path: Path) -> None:
    path = save(tmp_path / "a.nii.gz", np.ones((2, 2, 2, 3), np.float32))
    with pytest.raises(InputError, match=r"holds 3 frames but here.json lists 4"):
        open_series(path, frames=FrameSchedule(np.arange(4.0), np.arange(4.0) + 1, where="here.json"))


def truncated(path: Path, keep: float) -> Path:
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content))])
    return path


@pytest.mark.parametrize("keep", [0.999, 0.9, 0.5])
def test_a_truncated_gzip_is_one_line(tmp_path: Path, keep: float) -> None:
    values = np.random.default_rng(5).normal(size=(8, 8, 8, 4)).astype(np.float32)
    path = truncated(save(tmp_path / "a.nii.gz", values), keep)
    with pytest.raises(InputError, match=r"a\.nii\.gz: [^\n]*truncated[^\n]*$"):
        read_all(path)


def test_a_gzip_cut_in_its_header_is_one_line(tmp_path: Path) -> None:
    path = save(tmp_path / "a.nii.gz", np.ones((8, 8, 8, 4), np.float32))
    path.write_bytes(path.read_bytes()[:20])
    with pytest.raises(InputError, match=r"a\.nii\.gz: [^\n]*(truncated|not a NIfTI)"):
        open_series(path)


def test_a_gzip_with_a_wrong_byte_fails_its_checksum(tmp_path: Path) -> None:
    values = np.random.default_rng(6).normal(size=(8, 8, 8, 4)).astype(np.float32)
    path = tmp_path / "a.nii.gz"
    raw = tmp_path / "a.nii"
    save(raw, values)
    content = bytearray(gzip.compress(raw.read_bytes(), 0, mtime=0))
    content[-1000] ^= 1
    path.write_bytes(bytes(content))
    with pytest.raises(InputError, match="truncated or damaged"):
        read_all(path)


def test_a_short_plain_file_is_refused_before_reading(tmp_path: Path) -> None:
    path = truncated(save(tmp_path / "a.nii", np.ones((8, 8, 8, 4), np.float32)), 0.9)
    with pytest.raises(InputError, match=r"the header promises 8544 bytes but the file has"):
        open_series(path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.nii.gz", b"not a gzip at all" * 40, "is named .gz but is not a gzip file"),
        ("a.nii", b"not a nifti at all" * 40, "not a NIfTI image"),
        ("a.nii", b"", "not a NIfTI image"),
        ("a.nii.gz", gzip.compress(b"not a nifti at all" * 40, mtime=0), "not a NIfTI image"),
    ],
)
def test_what_is_no_nifti_is_refused(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        open_series(tmp_path / name)


def patched(tmp_path: Path, offset: int, content: bytes, *, compress: bool = True) -> Path:
    """A sound file with bytes of its header replaced (offsets as in nifti1.h)."""
    plain = save(tmp_path / "plain.nii", np.ones((4, 4, 4, 3), np.float32))
    raw = bytearray(plain.read_bytes())
    raw[offset : offset + len(content)] = content
    path = tmp_path / ("a.nii.gz" if compress else "a.nii")
    path.write_bytes(gzip.compress(bytes(raw)) if compress else bytes(raw))
    return path


@pytest.mark.parametrize("compress", [True, False])
@pytest.mark.parametrize(
    ("offset", "content", "message"),
    [
        (40, struct.pack("<8h", 4, 32000, 32000, 32000, 30000, 1, 1, 1), "more than a frame can have"),
        (40, struct.pack("<8h", 4, 800, 800, 800, 30, 1, 1, 1), "the header promises .* bytes"),
        (40, struct.pack("<8h", 4, 4, -4, 4, 3, 1, 1, 1), "dimensions .* are not those"),
        (40, struct.pack("<8h", 5, 4, 4, 4, 3, 2, 1, 1), "dimensions .* are not those"),
        (40, struct.pack("<8h", 2, 4, 4, 1, 1, 1, 1, 1), "dimensions .* are not those"),
        (40, struct.pack("<8h", 3, 4, 4, 4, 1, 1, 1, 1), "has 3 dimensions; a dynamic image needs a fourth"),
        (70, struct.pack("<h", 32), "datatype 32 is no real number"),
        (108, struct.pack("<f", 1e12), "data start at byte 1e\\+12"),
        (108, struct.pack("<f", float("nan")), "data start at byte nan"),
        (112, struct.pack("<f", float("inf")), "scl_slope inf"),
        (280, struct.pack("<f", float("nan")), "affine is not finite"),
        (280, struct.pack("<12f", *[0.0] * 12), "affine is not finite or flat"),
        (344, b"ni1\0", "header and image are two files"),
    ],
)
def test_a_header_that_cannot_be_right_is_refused_before_allocation(
    tmp_path: Path, offset: int, content: bytes, message: str, compress: bool
) -> None:
    with pytest.raises(InputError, match=message):
        open_series(patched(tmp_path, offset, content, compress=compress))


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere.nii.gz: no such file\."):
        open_series(tmp_path / "nowhere.nii.gz")


@pytest.mark.parametrize("dtype", [np.float32, np.uint8, np.int16, np.int32])
def test_maps_come_back_with_their_affine(tmp_path: Path, dtype: type) -> None:
    values = np.random.default_rng(7).uniform(0, 200, (3, 4, 5)).astype(dtype)
    path = tmp_path / "out" / "sub-01_model-2TCM_meas-VT_mimap.nii.gz"
    write_map(path, values, AFFINE, {"Units": "mL cm-3"})
    read, affine = read_volume(path)
    np.testing.assert_array_equal(read, values.astype(np.float32))
    np.testing.assert_allclose(affine, AFFINE, atol=1e-6)
    image = nibabel.Nifti1Image.from_filename(path)
    assert image.get_data_dtype() == dtype
    np.testing.assert_array_equal(np.asarray(image.dataobj), values)
    assert path.with_name("sub-01_model-2TCM_meas-VT_mimap.json").read_text() == '{\n  "Units": "mL cm-3"\n}\n'


def test_integer_series_come_back_scaled(tmp_path: Path) -> None:
    values = np.random.default_rng(8).uniform(-5, 50, (4, 5, 6, 3))
    path = tmp_path / "a.nii.gz"
    write_series(path, np.moveaxis(values, -1, 0), AFFINE, count=3, slope=0.002)
    assert nibabel.Nifti1Image.from_filename(path).get_data_dtype() == np.int16
    np.testing.assert_allclose(read_all(path), values, atol=0.00101)
    with pytest.raises(InputError, match=r"does not fit int16 at slope 0\.001"):
        write_series(path, np.moveaxis(values, -1, 0), AFFINE, count=3, slope=0.001)
    np.testing.assert_allclose(read_all(path), values, atol=0.00101)  # the old file is still whole


def test_a_wrong_number_of_frames_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="2 frames were given to write, 3 were announced"):
        write_series(tmp_path / "a.nii.gz", [np.zeros((2, 2, 2))] * 2, AFFINE, count=3)
    assert list(tmp_path.iterdir()) == []


def test_the_same_map_is_the_same_bytes_without_time_or_name(tmp_path: Path) -> None:
    values = np.random.default_rng(9).normal(size=(6, 6, 6)).astype(np.float32)
    for name in ("a.nii.gz", "b.nii.gz"):
        write_map(tmp_path / name, values, AFFINE, {})
    first, second = (tmp_path / "a.nii.gz").read_bytes(), (tmp_path / "b.nii.gz").read_bytes()
    assert first == second
    assert first[3] == 0  # no name, comment or extra field (RFC 1952)
    assert first[4:8] == b"\0\0\0\0"  # no time


def test_reading_does_not_depend_on_the_faster_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(10).normal(size=(5, 6, 7, 8)).astype(np.float32)
    path = save(tmp_path / "a.nii.gz", values)
    usual = read_all(path)
    for module in ("isal", "isal.igzip", "isal.isal_zlib"):
        monkeypatch.setitem(sys.modules, module, None)
    spec = importlib.util.spec_from_file_location("nifti_without_isal", nifti.__file__)
    assert spec is not None
    assert spec.loader is not None
    plain = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "nifti_without_isal", plain)
    spec.loader.exec_module(plain)
    assert plain._open_gzip is gzip.open
    np.testing.assert_array_equal(np.stack(list(plain.open_series(path).frames()), axis=-1), usual)
    with pytest.raises(InputError, match="truncated"):
        list(plain.open_series(truncated(path, 0.8)).frames())


def test_more_frames_than_one_are_no_volume(tmp_path: Path) -> None:
    path = save(tmp_path / "a.nii.gz", np.ones((2, 2, 2, 3), np.float32))
    with pytest.raises(InputError, match="holds 3 frames where one 3-D image is due"):
        read_label_volume(path)
