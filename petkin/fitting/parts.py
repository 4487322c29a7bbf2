"""Curves handled in parts: each fits the cache, and every processor core takes the next one that waits."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numba

T = TypeVar("T")

#: Curves in a part: some hundred kilobytes an array of numbers, and no multiple of a page, so that rows of numbers do
#: not push each other out of the cache. Results do not depend on it.
PART = 16320


def busy() -> int:
    """Curves that give every processor core a part; more at once are fitted no faster."""
    return PART * numba.get_num_threads()


def in_parts(work: Callable[[slice], T], count: int, size: int = PART) -> list[T]:
    """`work` on the slices that make up range(count), `size` long, in order of the slices.

    The parts run on as many threads as `numba.get_num_threads` says; compiled work and numpy leave the interpreter's
    lock alone. What comes out of a curve must depend on that curve alone.
    """
    slices = [slice(start, min(start + size, count)) for start in range(0, count, size)]
    threads = min(numba.get_num_threads(), len(slices))
    if threads <= 1:
        return [work(part) for part in slices]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, slices))
