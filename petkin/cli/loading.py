"""Imports that take seconds, made a little shorter."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def loading() -> Iterator[None]:
    """Import within this block: the garbage collector neither runs meanwhile nor looks at what was loaded later on.

    It would go through a million objects of torch and numba that live as long as the program.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
