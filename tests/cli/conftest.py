"""The command as a user runs it, and a small study to run it on."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pytest

import petkin
from petkin.cli import main

from .tiny_study import dump, write_scan


@dataclass(frozen=True)
class Ran:
    """How a command ended."""

    status: int
    out: str
    err: str


def run_command(*arguments: object) -> Ran:
    """Run `petkin ...` in this process, through the function that the console script calls."""
    out, err, status = io.StringIO(), io.StringIO(), 0
    typed = ["petkin", *map(str, arguments)]
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", typed)
        try:
            main()
        except SystemExit as ended:
            status = int(ended.code or 0)
    return Ran(status, out.getvalue(), err.getvalue())


@pytest.fixture
def petkin_command() -> Callable[..., Ran]:
    """`run_command`."""
    return run_command


@pytest.fixture(scope="session")
def petkin_process() -> Callable[..., Ran]:
    """Run `petkin ...` in a process of its own."""

    def run(*arguments: object) -> Ran:
        done = subprocess.run(
            [sys.executable, "-m", "petkin", *map(str, arguments)],
            cwd=Path(petkin.__file__).parents[1],
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        return Ran(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """One subject: 6 x 6 x 4 voxels, 12 frames, two regions, manual blood."""
    root = tmp_path / "study"
    dump(root / "dataset_description.json", {"Name": "tiny", "BIDSVersion": "1.10.0", "DatasetType": "raw"})
    write_scan(root)
    return root
