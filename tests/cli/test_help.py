"""`--help` answers at once, loads nothing heavy, and explains every option."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer.main

import petkin
from petkin.cli.app import app

_ROOT = Path(petkin.__file__).parents[1]
_COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]
_HEAVY = ("torch", "pandas", "matplotlib", "numpy", "scipy", "numba", "nibabel")


def _seconds(*arguments: str) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, "-m", "petkin", *arguments], cwd=_ROOT, check=True, capture_output=True)
    return time.perf_counter() - start


def test_help_takes_less_than_half_a_second() -> None:
    """The best of five, because a busy machine slows any of them."""
    assert min(_seconds("--help") for _ in range(5)) < 0.5


@pytest.mark.parametrize(
    "arguments", [["--help"], ["fit", "--help"], ["simulate", "--help"], ["diagnose", "--help"], ["--version"]]
)
def test_help_loads_nothing_heavy(arguments: list[str]) -> None:
    code = f"""
import sys
sys.argv = ["petkin", *{arguments!r}]
from petkin.cli import main
try:
    main()
except SystemExit as ended:
    assert not ended.code
loaded = [name for name in {_HEAVY!r} if name in sys.modules]
sys.exit(", ".join(loaded) or 0)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=_ROOT, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert done.returncode == 0


@pytest.mark.parametrize("verb", _COMMANDS)
def test_every_option_is_explained(verb: str) -> None:
    """In a sentence: it starts with a capital, a number or a choice, and ends in a full stop."""
    assert _COMMANDS[verb].help
    for parameter in _COMMANDS[verb].params:
        text = getattr(parameter, "help", None)
        assert text, f"{verb}: {parameter.name} has no help"
        assert text.endswith("."), f"{verb}: the help of {parameter.name} does not end: {text!r}"


def test_a_command_alone_shows_what_there_is(petkin_command) -> None:
    ran = petkin_command()
    for verb in ("simulate", "fit", "diagnose", "tacs", "info", "demo"):
        assert verb in ran.out + ran.err
