"""How long something takes: processor time and wall time, after a warm-up, the median of several runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

REPEATS = 5


@dataclass(frozen=True)
class Timing:
    """Seconds: processor time of all threads together, and wall time."""

    cpu: float
    wall: float


def measure(work: Callable[[], object], repeats: int = REPEATS, *, warm_up: bool = True) -> Timing:
    """Median times of `repeats` runs, after one that does not count."""
    if warm_up:
        work()
    runs = []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        work()
        runs.append((time.process_time() - cpu, time.perf_counter() - wall))
    cpus, walls = np.array(runs).T
    return Timing(float(np.median(cpus)), float(np.median(walls)))
