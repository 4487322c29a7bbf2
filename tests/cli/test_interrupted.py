"""A command that is stopped on its way leaves no result, whole or half, and says so in one line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import petkin

from .tiny_study import tree

#: Runs `petkin` with one of its steps replaced by one that says so and then takes for ever.
_SLOW = """
import sys, time, petkin.study.fit as room
def for_ever(*_, **__):
    print("there", flush=True)
    time.sleep(600)
setattr(room, sys.argv.pop(1), for_ever)
from petkin.cli import main
main()
"""


def _stopped_in(step: str, number: int, study: Path, until: Callable[[], object] = lambda: True) -> tuple[int, str]:
    """Start a fit, send a signal once it reaches `step` and `until` holds; exit status and standard error."""
    process = subprocess.Popen(
        [sys.executable, "-c", _SLOW, step, "fit", str(study), "--model", "1TCM", "--delay", "0"],
        cwd=Path(petkin.__file__).parents[1],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "there\n"
    deadline = time.monotonic() + 60
    while not until() and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    return process.returncode, err


@pytest.mark.parametrize(
    ("step", "number", "status"),
    [("fit_scan", signal.SIGINT, 130), ("_report", signal.SIGINT, 130), ("write_bytes", signal.SIGTERM, 143)],
)
def test_stopped_by_a_signal(study: Path, step: str, number: int, status: int) -> None:
    """The report is rendered while tables and maps of the scan are written to the staging folder."""
    before = tree(study)
    ended, err = _stopped_in(step, number, study)
    assert (ended, err) == (status, "petkin: interrupted; nothing half-written was left behind.\n")
    after = {path: content for path, content in tree(study).items() if content != b"folder"}
    assert after == {path: content for path, content in before.items() if content != b"folder"}
    assert not list(study.rglob(".petkin-*"))


def test_killed_outright(study: Path) -> None:
    """No code runs after SIGKILL: a temporary folder stays, but nothing under the name of a result."""

    def maps() -> list[Path]:
        return list(study.rglob("*mimap*"))

    _stopped_in("_report", signal.SIGKILL, study, until=maps)
    assert maps()
    assert not [path for path in maps() if ".petkin-" not in str(path)]
    assert not (study / "derivatives" / "petkin").exists()


def test_a_crash_leaves_nothing(study: Path, petkin_command, monkeypatch: pytest.MonkeyPatch) -> None:
    """A full disk while the report is written: one line, and the maps written before it are gone too."""

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("petkin.study.fit.write_bytes", full)
    monkeypatch.setattr("petkin.reporting.render_fit_report", lambda report: report.title)
    ran = petkin_command("fit", study, "--model", "1TCM", "--delay", "0")
    assert ran.status == 2
    assert ran.err == "petkin: [Errno 28] No space left on device\n"
    assert not list(study.rglob("*mimap*"))
    assert not list(study.rglob(".petkin-*"))
