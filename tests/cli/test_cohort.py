"""Scans fitted side by side by real processes, some of them killed: the files of a serial run, to the byte."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

import pytest

import petkin

from .conftest import run_command
from .tiny_study import differences, dump, tree, write_scan

_SCANS = ("01", "02", "03")
_FIT = ("--model", "1TCM", "--delay", "0")
T = TypeVar("T")


@pytest.fixture(scope="module")
def cohort(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, bytes]]:
    """A study of three, and the files of its serial fit."""
    root = tmp_path_factory.mktemp("cohort") / "study"
    dump(root / "dataset_description.json", {"Name": "tiny", "BIDSVersion": "1.10.0", "DatasetType": "raw"})
    for subject in _SCANS:
        write_scan(root, subject)
    ran = run_command("fit", root, *_FIT)
    assert (ran.status, ran.err) == (0, "")
    serial = root / "derivatives" / "petkin"
    files = tree(serial)
    serial.rename(root.parent / "serial")
    return root, files


@contextmanager
def _running(study: Path, *more: str) -> Iterator[subprocess.Popen[str]]:
    """`petkin fit` with two workers, in a process group of its own as a shell would start it."""
    process = subprocess.Popen(
        [sys.executable, "-m", "petkin", "fit", str(study), *_FIT, "--workers", "2", *more],
        cwd=Path(petkin.__file__).parents[1],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


@contextmanager
def _taken(port: int) -> Iterator[None]:
    """A port that this process, or else another, listens at."""
    with socket.socket() as server:
        with suppress(OSError):
            server.bind(("127.0.0.1", port))
            server.listen()
        yield


def _until(there: Callable[[], T | None]) -> T:
    """What `there` gives, as soon as it gives something."""
    end = time.monotonic() + 120
    while time.monotonic() < end:
        found = there()
        if found:
            return found
        time.sleep(0.02)
    raise TimeoutError


def _at_work(study: Path, process: subprocess.Popen[str]) -> list[int]:
    """Processes of this run that hold a folder of half a scan; what an earlier one left is nobody's."""
    return sorted(_alive(process) & {int(path.name.split("-")[1]) for path in study.rglob(".petkin-*-*.lock")})


def _half_done(study: Path) -> list[Path]:
    """Folders of half a scan and their locks, held or not."""
    return list(study.rglob(".petkin-*-*"))


def _alive(process: subprocess.Popen[str]) -> set[int]:
    """The process and all that it started and that have not ended, whether it lives or not."""
    members = set()
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it ended just now
            state, _, group = path.read_text().rpartition(")")[2].split()[:3]
            if int(group) == process.pid and state not in "ZX":
                members.add(int(path.parent.name))
    return members


def _results(study: Path) -> dict[str, bytes]:
    return tree(study / "derivatives" / "petkin")


def test_a_worker_is_killed(cohort: tuple[Path, dict[str, bytes]]) -> None:
    """What listens beside the scheduler takes another port where its usual one is taken, without a word."""
    study, serial = cohort
    with _taken(8787), _running(study, "--again") as process:
        victim = _until(lambda: _at_work(study, process))[0]
        assert victim != process.pid
        os.kill(victim, signal.SIGKILL)
        out, err = process.communicate(timeout=300)
    assert (process.returncode, err) == (0, "")
    assert out.count("Report: ") == len(_SCANS)
    assert not differences(_results(study), serial)
    assert not _half_done(study)


def test_the_client_is_killed_and_starts_again(cohort: tuple[Path, dict[str, bytes]]) -> None:
    """What was finished stays, what was not leaves nothing under the name of a result, and the rest is done."""
    study, serial = cohort
    out = study / "derivatives" / "petkin"
    if out.exists():
        out.rename(study.parent / "earlier")
    with _running(study) as process:
        first = _until(lambda: list(out.rglob("*_record.json")))
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
        _until(lambda: not _alive(process))
    done = {path.name[:6] for path in out.rglob("*_record.json")}
    assert {path.name for path in out.glob("sub-*")} == done
    assert len(done) < len(_SCANS)
    stamp = first[0].stat().st_mtime_ns
    ran = run_command("fit", study, *_FIT)
    assert ran.status == 0
    assert (
        f"{len(done)} of 3 scans were finished before by the same request and not fitted again; --again does."
        in ran.out
    )
    assert first[0].stat().st_mtime_ns == stamp
    assert not differences(_results(study), serial)
    assert not _half_done(study)
    told = run_command("fit", study, *_FIT)
    assert told.out == ran.out.replace(f"{len(done)} of 3 scans", "3 of 3 scans")


def test_ctrl_c_ends_the_workers(cohort: tuple[Path, dict[str, bytes]]) -> None:
    study, _ = cohort
    before = _results(study) if (study / "derivatives" / "petkin").exists() else {}
    with _running(study, "--again") as process:
        workers = _until(lambda: _at_work(study, process))
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (130, "petkin: interrupted; nothing half-written was left behind.\n")
    assert not _alive(process).intersection(workers)
    _until(lambda: not _alive(process))  # what kept count of their memory may go a moment later
    assert not list(study.rglob(".petkin-*"))
    if before:
        assert not differences(_results(study), before)


_HURRIED = """
import logging
from contextlib import suppress
from petkin.study import cohort
from petkin.study.resources import Execution

def interrupted(*_):
    logging.getLogger("distributed.scheduler").critical("a line is closed")
    raise KeyboardInterrupt

cohort._gather = interrupted
if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        cohort.fit_on_cluster(None, [], Execution(workers=1), print)
"""


def test_what_a_scheduler_says_at_a_hurried_end_is_kept_from_the_user(tmp_path: Path) -> None:
    """Workers still tell how far they are while their line is being closed: a matter of who is faster."""
    script = tmp_path / "hurried.py"
    script.write_text(_HURRIED)
    ran = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=100)
    assert (ran.returncode, ran.stderr) == (0, "")
