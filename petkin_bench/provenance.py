"""Where a measured number comes from: program, commit, machine, settings."""

from __future__ import annotations

import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import pandas as pd

from petkin.io import write_text

RESULTS = Path(__file__).parent / "results"
_LIBRARIES = ("numpy", "scipy", "numba", "torch")


def provenance() -> dict[str, str]:
    """Columns that every row of a result file carries."""
    return {
        "petkin": version("petkin"),
        "commit": _commit(),
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "cpu": _cpu(),
        "cores": str(os.cpu_count()),
        "python": platform.python_version(),
        "libraries": " ".join(f"{name} {version(name)}" for name in _LIBRARIES),
    }


def append_rows(name: str, rows: list[dict[str, object]], folder: Path = RESULTS) -> Path:
    """Add rows, with their provenance, to `<name>.csv`; columns that are new are added to the old rows empty.

    The file is written whole or not at all.
    """
    path = folder / f"{name}.csv"
    folder.mkdir(parents=True, exist_ok=True)
    table = pd.DataFrame([row | provenance() for row in rows])
    if path.is_file():
        table = pd.concat([pd.read_csv(path, dtype=str), table.astype(str)], ignore_index=True)
    write_text(path, table.to_csv(index=False))
    return path


def _commit() -> str:
    """Commit of the working tree, "+" where more than results was changed since; "unknown" outside a checkout."""
    try:
        name = _git("describe", "--always")
        changed = _git("status", "--porcelain", "--untracked-files=no", "--", ":/", f":(exclude){RESULTS}")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{name}+" if changed else name


def _git(*words: str) -> str:
    here = Path(__file__).parent
    return subprocess.run(["git", *words], cwd=here, capture_output=True, text=True, check=True).stdout.strip()


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
