"""`petkin-bench survey`: a whole brain made and judged by the two commands, and what counts as right."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn

import pytest

from petkin.errors import InputError
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin_bench import survey
from petkin_bench.survey import BRAINS, Brain, _right, _right_set, measure_survey, text_of

TWO = Brain("two", answer=(frozenset({"arterial_delay", "frame_offset"}), frozenset({"gain_step"})))
NONE = Brain("nothing")


def test_a_right_answer_names_what_is_there_and_no_more() -> None:
    assert _right(TWO, "named", ["frame_offset", "gain_step"])
    assert _right(TWO, "ambiguous", ["arterial_delay", "gain_step"])
    assert not _right(TWO, "named", ["gain_step"])
    assert not _right(TWO, "unknown", ["arterial_delay", "gain_step"])
    assert not _right(TWO, "named", ["arterial_delay", "frame_offset"])
    assert _right_set(TWO, "ambiguous", ["dispersion+gain_step", "arterial_delay+gain_step"])
    assert not _right_set(TWO, "none", [])


def test_a_brain_without_a_gap_is_right_where_none_is_claimed() -> None:
    assert _right(NONE, "none", [])
    assert _right_set(NONE, "none", [])
    assert not _right(NONE, "unknown", [])


def test_a_whole_brain_that_the_simulator_gives_no_blood(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Made once and, where it lies there already, judged again without being made anew."""
    first = measure_survey(tmp_path, only=("no blood volume",))
    (row,) = first
    assert (row["set"], row["first"], row["in_set"]) == ("blood_volume", True, True)
    assert 0.03 < float(str(row["amplitude"])) < 0.08
    assert "1/1     1/1  blood_volume" in text_of(first)
    judged: list[DiagnoseRequest] = []

    def asked(request: DiagnoseRequest) -> NoReturn:
        judged.append(request)
        raise InputError("asked")

    monkeypatch.setattr(survey, "simulate", pytest.fail)
    monkeypatch.setattr(survey, "diagnose_study", asked)
    with pytest.raises(InputError, match="asked"):
        measure_survey(tmp_path, only=("no blood volume",))
    assert [request.target.parent for request in judged] == [tmp_path]


def test_a_brain_of_no_such_name_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing; nothing, a point"):
        measure_survey(tmp_path, only=("nonsense",))
    assert len({brain.name for brain in BRAINS}) == len(BRAINS)
