"""Two processes that share the episodes of every step train as one process does."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

TORCHRUN = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
LEAVES = """
from pathlib import Path
import torch
from petkin.hybrid import processes

with processes() as count:
    weights = torch.ones(3, requires_grad=True)
    optimizer = torch.optim.Adam([weights])
    weights.sum().backward()
    optimizer.step()
threads = [(task / "comm").read_text().strip() for task in Path("/proc/self/task").iterdir()]
assert count == 2
assert not any("gloo" in name for name in threads), threads
"""


def _run(command: list[str], folder: Path) -> pd.DataFrame:
    options = ["--system", "pendulum", "--dynamics", "purely_physics", "--preset", "tiny", "--work", str(folder)]
    arguments = ["-m", "petkin_bench", "run", *options, "--results", str(folder), "--episodes", "2"]
    done = subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert len(pd.read_csv(folder / "learning.csv")) == 4
    return pd.read_csv(next(folder.glob("tiny_*.csv")))


def test_two_processes_train_as_one_with_twice_the_episodes(tmp_path):
    alone, together = _run([sys.executable], tmp_path / "one"), _run(TORCHRUN, tmp_path / "two")
    assert len(alone) == len(together) == 60
    np.testing.assert_allclose(together["loss"], alone["loss"], rtol=1e-3)
    np.testing.assert_allclose(together["loss"][:10], alone["loss"][:10], rtol=1e-5)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are listed where /proc lists them")
def test_processes_that_part_leave_no_thread_behind(tmp_path):
    """A thread of a group that something still holds may abort the interpreter while it ends, and torchrun with it."""
    (tmp_path / "leaves.py").write_text(LEAVES)
    command = [*TORCHRUN, str(tmp_path / "leaves.py")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
