"""What `petkin diagnose` prints: what is odd about the files first, then the verdicts; what a design could tell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from petkin.cli.tell import tell_design, tell_diagnoses
from petkin.diagnosis import Hypothesis, Visible
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


def test_a_design_tells_the_strongest_first_and_what_cannot_be_seen(capsys: pytest.CaptureFixture[str]) -> None:
    def visible(name: str, detectability: float, kept: float) -> Visible:
        hypothesis = Hypothesis(name, "input", "amplitude", "s", 0.0, 1.0)
        return Visible(hypothesis, detectability, kept, np.zeros(0), np.zeros(0), (("dispersion", 0.99),))

    tell_design("sub-01", [visible("input_scale", 0.0, 0.0), visible("arterial_delay", 12.3, 0.05)])
    _, heading, first, second = (line.split() for line in capsys.readouterr().out.splitlines())
    assert heading == ["effect", "d'", "kept", "taken", "for"]
    assert first == ["arterial_delay", "12.30", "5", "%", "dispersion", "(0.99)"]
    assert second == ["input_scale", "0.00", "none", "cannot", "be", "seen"]
