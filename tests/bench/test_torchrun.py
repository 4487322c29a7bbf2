"""Two processes that share the episodes of every step train as one process does."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd


def _run(command: list[str], folder: Path) -> pd.DataFrame:
    options = ["--system", "pendulum", "--dynamics", "purely_physics", "--preset", "tiny", "--work", str(folder)]
    arguments = ["-m", "petkin_bench", "run", *options, "--results", str(folder), "--episodes", "2"]
    done = subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert len(pd.read_csv(folder / "learning.csv")) == 4
    return pd.read_csv(next(folder.glob("tiny_*.csv")))


def test_two_processes_train_as_one_with_twice_the_episodes(tmp_path):
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    alone, together = _run([sys.executable], tmp_path / "one"), _run(torchrun, tmp_path / "two")
    assert len(alone) == len(together) == 60
    np.testing.assert_allclose(together["loss"], alone["loss"], rtol=1e-3)
    np.testing.assert_allclose(together["loss"][:10], alone["loss"][:10], rtol=1e-5)
