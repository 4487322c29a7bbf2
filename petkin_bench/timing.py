"""How long something takes: processor time and wall time, after a warm-up, the median of several runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numba
import numpy as np

REPEATS = 5

Work = Callable[[], object]


@dataclass(frozen=True)
class Timing:
    """Seconds: processor time of all threads together, and wall time."""

    cpu: float
    wall: float


def measure(work: Work, repeats: int = REPEATS, *, warm_up: bool = True) -> Timing:
    """Median times of `repeats` runs, after one that does not count."""
    return _in_turn([work], repeats, warm_up=warm_up)[0]


def side_by_side(*works: Work, repeats: int = REPEATS) -> list[Timing]:
    """The same of works that are to be compared: on one thread, and in turn, so that what disturbs one disturbs all.

    Two threads may share what a core is made of, and each then counts more processor time for the same work. Products
    of numpy keep to one thread as well (`petkin_bench` sees to it before numpy is loaded).
    """
    with _one_thread():
        return _in_turn(works, repeats, warm_up=True)


@contextmanager
def _one_thread() -> Iterator[None]:
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)


def _in_turn(works: tuple[Work, ...] | list[Work], repeats: int, *, warm_up: bool) -> list[Timing]:
    if warm_up:
        for work in works:
            work()
    runs = np.array([[_once(work) for work in works] for _ in range(repeats)])
    return [Timing(float(cpu), float(wall)) for cpu, wall in np.median(runs, axis=0)]


def _once(work: Work) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return time.process_time() - cpu, time.perf_counter() - wall
