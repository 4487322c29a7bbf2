"""Compiled code belongs to the sources it was compiled from."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

import petkin
from petkin.compiled import VARIABLE, fingerprint, keep_compiled_code


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of two files, with no folder for compiled code given."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(numba.config, "CACHE_DIR", numba.config.CACHE_DIR)
    (tmp_path / "room").mkdir()
    for name in ("calls.py", "room/called.py"):
        (tmp_path / name).write_text("x = 1\n")
    return tmp_path


def test_a_change_of_any_source_begins_a_new_folder_and_removes_the_old(package, monkeypatch):
    keep_compiled_code(package)
    before = os.environ[VARIABLE]
    monkeypatch.delenv(VARIABLE)
    (package / "room" / "called.py").write_text("x = 1.5\n")
    keep_compiled_code(package)
    after = os.environ[VARIABLE]
    assert before != after
    assert after == numba.config.CACHE_DIR
    assert not Path(before).exists()
    monkeypatch.delenv(VARIABLE)
    keep_compiled_code(package)
    assert os.environ[VARIABLE] == after


def test_a_folder_that_is_given_is_used_and_one_of_petkins_own_is_kept(package, tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tmp_path / "mine"))
    keep_compiled_code(package)
    inside = os.environ[VARIABLE]
    assert inside == str(tmp_path / "mine" / f"petkin-compiled-{fingerprint(package)}")
    keep_compiled_code(package)
    assert os.environ[VARIABLE] == inside


def test_where_nothing_can_be_written_the_compiler_is_left_alone(package, monkeypatch):
    (package / "__pycache__").write_text("a file, not a folder")
    keep_compiled_code(package)
    assert VARIABLE not in os.environ


def test_petkins_own_code_lies_in_such_a_folder():
    code = "import petkin.fitting, numba; print(numba.config.CACHE_DIR)"
    environment = {name: value for name, value in os.environ.items() if name != VARIABLE}
    found = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert found.stdout.strip().endswith(f"petkin-compiled-{fingerprint(Path(petkin.__file__).parent)}")
