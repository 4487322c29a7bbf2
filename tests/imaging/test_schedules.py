"""Frame schedules: names, compact text, counts, files, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.imaging import SCHEDULES, frame_schedule, in_seconds, parse_schedule, read_schedule


@pytest.mark.parametrize(
    ("name", "frames", "minutes"), [("paper", 80, 40), ("fdg", 26, 60), ("clinical", 46, 90), ("interrupted", 26, 90)]
)
def test_named_schedules_have_their_frames_and_length(name: str, frames: int, minutes: float) -> None:
    schedule = frame_schedule(name, length=1.0)
    assert len(schedule) == frames
    assert schedule.end[-1] == pytest.approx(minutes)
    assert schedule.start[0] == 0.0


def test_paper_schedule_is_half_minutes() -> None:
    np.testing.assert_allclose(frame_schedule("paper", length=0).duration, 0.5, rtol=1e-12)


def test_interrupted_schedule_has_one_gap_of_half_an_hour() -> None:
    gaps = frame_schedule("interrupted", length=0).gaps
    assert gaps[gaps > 1e-9] == pytest.approx([30.0])


def test_a_count_spreads_over_the_length() -> None:
    schedule = frame_schedule("80", length=40.0)
    np.testing.assert_allclose(schedule.start, 0.5 * np.arange(80), atol=1e-12)


def test_compact_text_keeps_order_and_gaps() -> None:
    schedule = parse_schedule("2x10, 1x20,gap60,1x300", where="here")
    assert in_seconds(schedule) == ([0.0, 10.0, 20.0, 100.0], [10.0, 10.0, 20.0, 300.0])


@pytest.mark.parametrize("choice", ["0", "weekly", "12by10", "3x", ""])
def test_nonsense_is_refused_in_one_line(choice: str) -> None:
    with pytest.raises(InputError) as error:
        frame_schedule(choice, length=40.0)
    assert "\n" not in str(error.value)
    assert "--frames" in str(error.value)


def test_zero_second_frames_are_refused() -> None:
    with pytest.raises(InputError, match="must last longer than 0 s"):
        frame_schedule("3x0", length=1.0)


@pytest.mark.parametrize(
    "table",
    [
        "frame_start\tframe_end\n0\t30\n30\t90\n",
        "frame_start\tframe_duration\n0\t30\n30\t60\n",
        "FrameTimesStart\tFrameDuration\n0\t30\n30\t60\n",
    ],
)
def test_tables_are_read_in_seconds(tmp_path: Path, table: str) -> None:
    path = tmp_path / "frames.tsv"
    path.write_text(table)
    schedule = frame_schedule(str(path), length=0)
    np.testing.assert_allclose(schedule.end, [0.5, 1.5])


def test_sidecars_are_read(tmp_path: Path) -> None:
    path = tmp_path / "sub-01_pet.json"
    path.write_text(json.dumps({"FrameTimesStart": [0, 30], "FrameDuration": [30, 60], "TracerName": "FDG"}))
    np.testing.assert_allclose(read_schedule(path).duration, [0.5, 1.0])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.tsv", "time\tvalue\n0\t1\n", "no frame times found among time, value"),
        ("a.tsv", "", "no frame times found among no columns"),
        ("a.tsv", "frame_start\tframe_end\n0\tthirty\n", "not a number"),
        ("a.tsv", "frame_start\tframe_end\n0\t30\n20\t60\n", "must not overlap"),
        ("a.json", "{", "not JSON"),
        ("a.json", "[1]", "JSON object"),
        ("a.json", '{"FrameTimesStart": [0, 1], "FrameDuration": [1]}', "2 values of FrameTimesStart but 1"),
    ],
)
def test_unusable_files_say_why(tmp_path: Path, name: str, content: str, message: str) -> None:
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(InputError, match=message):
        read_schedule(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.tsv: the frame schedule cannot be read"):
        frame_schedule(str(tmp_path / "absent.tsv"), length=1.0)


def test_every_named_schedule_parses() -> None:
    for name, text in SCHEDULES.items():
        assert len(parse_schedule(text, where=name)) > 0
