"""Frame schedules: names, compact text, counts, and what is refused."""

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.imaging import SCHEDULES, frame_schedule, in_seconds, parse_schedule


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


@pytest.mark.parametrize("choice", ["0", "99999", "40000x10", "weekly", "12by10", "3x", ""])
def test_nonsense_is_refused_in_one_line(choice: str) -> None:
    with pytest.raises(InputError) as error:
        frame_schedule(choice, length=40.0)
    assert "\n" not in str(error.value)
    assert "frame" in str(error.value)


def test_zero_second_frames_are_refused() -> None:
    with pytest.raises(InputError, match="must last longer than 0 s"):
        frame_schedule("3x0", length=1.0)


def test_every_named_schedule_parses() -> None:
    for name, text in SCHEDULES.items():
        assert len(parse_schedule(text, where=name)) > 0
