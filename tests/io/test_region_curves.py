from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.io.bids import Study
from petkin.io.regions import RegionalCurves, read_tacs, read_volumes, write_tacs

Write = Callable[..., Path]
HEADER = "frame_start\tframe_end\tcortex\tcerebellum\n"


def test_curves_frames_names_and_units(tacs_file: Write) -> None:
    curves, fields = read_tacs(tacs_file(fields={"Units": "Bq/mL", "Note": "x"}))
    assert curves.names == ("cortex", "cerebellum")
    assert (curves.seg, curves.desc, curves.units) == ("rois", "", "Bq/mL")
    np.testing.assert_allclose(curves.values, np.stack([np.arange(10, 22), np.arange(5, 17)]) * 1e-3)
    np.testing.assert_allclose(curves.frames.end[[0, -1]], [0.5, 45.0])
    assert fields["Note"] == "x"


def test_a_leading_zero_row_of_no_duration_is_no_frame(tacs_file: Write) -> None:
    curves, _ = read_tacs(tacs_file(HEADER + "0\t0\t0\t0\n29\t39\t1e-4\t0\n39\t49\t3\t2\n"))
    assert curves.values.shape == (2, 2)
    np.testing.assert_allclose(curves.frames.start, [29 / 60, 39 / 60])
    assert curves.remarks[0].code == "zero-row"
    assert curves.remarks[0].text.startswith("1 leading row(s) of no duration hold only zeros")


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("0\t0\t1\t0\n0\t10\t1\t1\n", "frame 1 lasts 0 s"),
        ("0\t10\t1\t1\n10\t10\t0\t0\n", "frame 2 lasts 0 s"),
        ("0\t10\t1\t1\n10\t5\t0\t0\n", "frame 2 lasts -5 s"),
        ("0\t20\t1\t1\n10\t30\t1\t1\n", "frame 2 starts at 10 s but frame 1 ends at 20 s"),
        ("0\tn/a\t1\t1\n", "a frame time is missing in row 1"),
        ("0\t10\tx\t1\n", "column 'cortex', row 1 holds 'x'"),
        ("0\t0\t0\t0\n", "0 frame starts"),
    ],
)
def test_wrong_rows_are_refused(tacs_file: Write, rows: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_tacs(tacs_file(HEADER + rows))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("start_frame\tcortex\n0\t1\n", "no columns frame_start and frame_end"),
        ("frame_start\tframe_end\tweight\n0\t10\t1\n", "no region beside the frame columns"),
    ],
)
def test_tables_without_frames_or_regions_are_refused(tacs_file: Write, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_tacs(tacs_file(text))


def test_a_unit_is_needed(tacs_file: Write) -> None:
    path = tacs_file(bare=True)
    with pytest.raises(InputError, match=r"sub-01_seg-rois_tacs.tsv: no JSON beside it states Units"):
        read_tacs(path)
    curves, _ = read_tacs(path, default_unit="Bq/mL")
    assert curves.values[0, 0] == pytest.approx(0.01)
    assert curves.remarks[0].text == "No JSON states Units; taken to be Bq/mL as the raw image."
    with pytest.raises(InputError, match="unit 'SUV' is not an activity"):
        read_tacs(tacs_file(fields={"Units": "SUV"}))


@pytest.mark.parametrize("state", [{"ImageDecayCorrected": False}, {"ImageDecayCorrectionTime": 30}])
def test_curves_alone_must_be_decay_corrected(tacs_file: Write, state: dict[str, object]) -> None:
    with pytest.raises(InputError, match="its JSON says that it is not decay-corrected to time zero"):
        read_tacs(tacs_file(fields={"Units": "kBq/mL", **state}))


def test_missing_empty_and_negative_regions_are_remarked(tacs_file: Write) -> None:
    curves, _ = read_tacs(tacs_file(HEADER + "0\t10\tn/a\t0\n10\t20\t-1\t0\n"))
    assert [remark.code for remark in curves.remarks] == ["region-missing", "region-empty", "region-negative"]
    assert "1 of 2 regions (cerebellum) hold no activity" in curves.remarks[1].text


def test_curves_come_back_as_they_were_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    frames = FrameSchedule.from_seconds([0, 29.5, 1000], [29.5, 100, 1 / 3], where="here")
    written = RegionalCurves(("a b", "c"), rng.normal(size=(2, 3)) * 1e3, frames, seg="x", desc="y")
    path = tmp_path / "sub-01_seg-x_desc-y_tacs.tsv"
    write_tacs(path, written, {"Units": "kBq/mL"})
    read, _ = read_tacs(path)
    assert (read.names, read.seg, read.desc) == (("a b", "c"), "x", "y")
    np.testing.assert_allclose(read.values, written.values, rtol=1e-9)
    np.testing.assert_allclose(read.frames.end, frames.end, rtol=1e-9)
    first = path.read_bytes()
    write_tacs(path, read, {"Units": "kBq/mL"})
    assert path.read_bytes() == first


def test_volumes_follow_the_order_of_the_regions(tmp_path: Path) -> None:
    path = tmp_path / "sub-01_seg-x_morph.tsv"
    path.write_text("index\tname\tvolume-mm3\n1\tb\t20\n2\ta\t10\n")
    np.testing.assert_array_equal(read_volumes(path, ["a", "b", "c"]), [10, 20, np.nan])
    path.write_text("name\tvolume\nb\t20\n")
    with pytest.raises(InputError, match="no column 'volume-mm3'"):
        read_volumes(path, ["a"])


def test_a_table_must_have_the_shape_of_its_names_and_frames() -> None:
    with pytest.raises(InputError, match="2 regions and 1 frames need a table of that shape"):
        RegionalCurves(("a", "b"), np.zeros((1, 1)), FrameSchedule.uniform(1, 1.0))


def test_real_curves(pbr28: Study, mc1: Study) -> None:
    rois = next(scan for scan in pbr28.scans if scan.prefix == "sub-rbqc_ses-1").curves[0]
    assert rois.names == ("FC", "TC", "STR", "THA", "WB", "CBL")
    assert rois.values.shape == (6, 37)
    assert rois.values[0, 2] == pytest.approx(8.5461293489392)
    gtm = next(scan for scan in mc1.scans if scan.prefix == "sub-04_ses-baseline").curves[0]
    assert (gtm.seg, gtm.desc, len(gtm.names), len(gtm.frames)) == ("gtm", "preproc", 109, 33)
    assert gtm.values[0, 8] == pytest.approx(29.471399660150943)  # the file says Bq/mL
