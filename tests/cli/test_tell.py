"""What `petkin diagnose` prints: what is odd about the files first, then the verdicts."""

from __future__ import annotations

from pathlib import Path

import pytest

from petkin.cli.tell import tell_diagnoses
from petkin.io.remarks import Remark, Severity
from petkin.study.diagnose import Diagnosed


def test_what_is_odd_about_the_files_comes_before_the_verdicts(capsys: pytest.CaptureFixture[str]) -> None:
    unit = Remark(Severity.SEVERE, "unit", "sub-01_blood.tsv", "a unit is almost certainly wrong.")
    verdict = {"sentence": "Gain step of 0.05 from 30 min on.", "split_by": None}
    tell_diagnoses([Diagnosed("sub-01", {"verdict": verdict}, Path("sub-01.html"), (unit, unit))])
    first, second, third = capsys.readouterr().out.splitlines()
    assert first == "severe sub-01_blood.tsv: a unit is almost certainly wrong."
    assert second == "sub-01: Gain step of 0.05 from 30 min on."
    assert third == "  Report: sub-01.html"


def test_of_several_scans_what_is_alike_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    verdict = {"sentence": "No gap.", "split_by": None}
    found = [
        Diagnosed(label, {"verdict": verdict}, Path("x.html"), (Remark(Severity.WARNING, "unit", label, "is odd."),))
        for label in ("sub-01", "sub-02")
    ]
    tell_diagnoses([*found, Diagnosed("group", {"verdict": verdict}, Path("group.html"))])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("warning sub-01: is odd.")
    assert "1 more alike" in lines[0]
    assert sum("is odd" in line for line in lines) == 1
