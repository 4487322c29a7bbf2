from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from petkin.errors import InputError
from petkin.io.input_table import read_input_table, write_input_table
from petkin.io.jsonfile import json_text
from petkin.io.schedule import read_schedule
from petkin.io.tables import numbers, read_table, write_table


def test_tables_are_written_the_same_every_time(tmp_path: Path) -> None:
    table = pd.DataFrame({"index": [1, 2], "name": ["a", None], "K1": [1 / 3, np.nan], "k2": [np.inf, 1e-20]})
    write_table(tmp_path / "a.tsv", table)
    assert (tmp_path / "a.tsv").read_bytes() == (b"index\tname\tK1\tk2\n1\ta\t0.3333333333\tn/a\n2\tn/a\tn/a\t1e-20\n")


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=32), min_size=1, max_size=20))
def test_numbers_come_back_within_ten_digits(tmp_path_factory: pytest.TempPathFactory, values: list[float]) -> None:
    path = tmp_path_factory.mktemp("tsv") / "a.tsv"
    write_table(path, pd.DataFrame({"x": values}))
    np.testing.assert_allclose(numbers(read_table(path), "x", where="a"), values, rtol=1e-9)


def test_missing_cells_are_nan(tmp_path: Path) -> None:
    (tmp_path / "a.tsv").write_text("x\ty\nn/a\t1\n2\t\nNaN\t3\n", encoding="utf-8-sig")
    table = read_table(tmp_path / "a.tsv")
    np.testing.assert_array_equal(numbers(table, "x", where="a"), [np.nan, 2, np.nan])
    np.testing.assert_array_equal(numbers(table, "y", where="a"), [1, np.nan, 3])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x1f\x8b\x08\x00\xff\xfe", "not UTF-8 text"),
        (b"", "is empty"),
        (b"a\tb\n1\t2\t3\n", "not a tab-separated table"),
        (b"a\ta\n1\t2\n", "column 'a' appears 2 times"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.tsv").write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_table(tmp_path / "a.tsv")


def test_a_missing_or_oversized_table_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a.tsv: cannot be read \(No such file"):
        read_table(tmp_path / "a.tsv")
    with (tmp_path / "b.tsv").open("wb") as file:
        file.truncate(2**30)
    with pytest.raises(InputError, match="too large for a table"):
        read_table(tmp_path / "b.tsv")


def test_json_is_plain_and_ordered() -> None:
    text = json_text({"b": np.float64(1.5), "a": (np.int64(2), np.nan), "c": Path("x/y"), "µ": np.zeros(2)})
    assert (
        text == json.dumps({"b": 1.5, "a": [2, None], "c": "x/y", "µ": [0.0, 0.0]}, indent=2, ensure_ascii=False) + "\n"
    )


@pytest.mark.parametrize(
    "text",
    [
        "frame_start\tframe_end\n0\t30\n30\t90\n",
        "FrameTimesStart\tFrameDuration\n0\t30\n30\t60\n",
        "FrameTimesStart\tFrameTimesEnd\n0\t30\n30\t90\n",
    ],
)
def test_schedules_from_tables(tmp_path: Path, text: str) -> None:
    (tmp_path / "frames.tsv").write_text(text)
    frames = read_schedule(tmp_path / "frames.tsv")
    np.testing.assert_allclose(frames.end, [0.5, 1.5])


def test_schedules_from_json(tmp_path: Path) -> None:
    path = tmp_path / "frames.json"
    path.write_text(json.dumps({"FrameTimesStart": [0, 30], "FrameDuration": [30, 60]}))
    np.testing.assert_allclose(read_schedule(path).end, [0.5, 1.5])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"FrameTimesStart": [0]}, "frames.json: FrameDuration is missing"),
        ({"FrameTimesStart": ["a"], "FrameDuration": [1]}, "FrameTimesStart is not a list of numbers"),
        ({"FrameTimesStart": 0, "FrameDuration": 1}, "FrameTimesStart is not a list of numbers"),
        ({"FrameTimesStart": [0, 10], "FrameDuration": [10]}, "2 values in FrameTimesStart but 1 in FrameDuration"),
        ({"FrameTimesStart": [0, float("nan")], "FrameDuration": [10, 10]}, "not a finite number"),
        ({"FrameTimesStart": [0, 10], "FrameDuration": [10, 0]}, "frame 2 lasts 0 s"),
        ({"FrameTimesStart": [0, 0.5], "FrameDuration": [0.5, 0.5]}, "looks like minutes"),
        (
            {"FrameTimesStart": [0], "FrameDuration": [60], "ImageDecayCorrected": False},
            "frames.json: says that the image is not decay-corrected to time zero",
        ),
        (
            {"FrameTimesStart": [0], "FrameDuration": [60], "ImageDecayCorrectionTime": 60},
            "frames.json: says that the image is not decay-corrected to time zero",
        ),
    ],
)
def test_wrong_schedules_are_refused(tmp_path: Path, fields: dict[str, object], message: str) -> None:
    path = tmp_path / "frames.json"
    path.write_text(json.dumps(fields))
    with pytest.raises(InputError, match=message):
        read_schedule(path)


def test_a_table_of_frames_in_minutes_is_refused_where_the_tracer_lives_longer(tmp_path: Path) -> None:
    path = tmp_path / "frames.tsv"
    path.write_text("frame_start\tframe_end\n" + "".join(f"{5 * k}\t{5 * k + 5}\n" for k in range(12)))
    assert len(read_schedule(path, nuclide="O15")) == 12
    with pytest.raises(InputError, match="looks like minutes; frame_start and frame_end are in seconds"):
        read_schedule(path, nuclide="F18")


def test_input_functions_come_back(tmp_path: Path) -> None:
    path = tmp_path / "sub-01_inputfunction.tsv"
    samples = pd.DataFrame({"time": [0.0, 0.5, 90.0], "AIF": [0.0, 50.0, 1 / 3], "plasma_radioactivity": [0, 51, 4.0]})
    write_input_table(path, samples)
    assert path.read_text().splitlines()[:3] == [
        "time\twhole_blood_radioactivity\tplasma_radioactivity\tmetabolite_parent_fraction\tAIF",
        "0\tn/a\t0\tn/a\t0",
        "30\tn/a\t51\tn/a\t50",
    ]
    read = read_input_table(path).samples
    np.testing.assert_allclose(
        read[["time", "plasma_radioactivity", "AIF"]], samples[["time", "plasma_radioactivity", "AIF"]]
    )
    path.write_text("time\tplasma_radioactivity\n0\t0\n")
    with pytest.raises(InputError, match="no column 'AIF'"):
        read_input_table(path)


def test_the_input_functions_of_pbr28_are_read(shared_data: Path) -> None:
    folder = shared_data / "pbr28/derivatives/kinfitr/sub-rbqc/ses-1/pet"
    table = read_input_table(folder / "sub-rbqc_ses-1_inputfunction.tsv")
    assert table.samples["time"].iloc[1] == pytest.approx(0.897 / 60)
    assert table.samples["AIF"].iloc[1] == pytest.approx(0.0277944)
    assert table.remarks[0].code == "blood-units-assumed"
