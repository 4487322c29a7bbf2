"""What a scan may use of the machine: how much memory, where the rest goes, who fits its blocks of voxels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from petkin.errors import InputError
from petkin.fitting.parts import PART, busy
from petkin.io import Rows, Scratch, Series

#: Share of the free memory that may be used where no limit is given.
_SHARE = 0.5
#: Where Linux says what a container may hold and holds (control groups, version 2).
_CONTAINER = Path("/sys/fs/cgroup")
#: Bytes of curves and results that are held in memory; more lies in files, which the system caches while it can.
_HELD = 2**24
#: Numbers of 8 bytes a voxel that a fit holds at a time, beyond `_PER_FRAME` a frame (measured: Logan takes most).
_PER_VOXEL, _PER_FRAME = 48, 8
#: Bytes of compiled code, what draws reports, and scipy: loaded when a scan has been planned (measured: 181 MB).
_LATER = 192 * 2**20
#: Bytes a voxel of the grid that denoising holds, its composite and frames (measured: 41).
_DENOISING = 44
#: Maps of a model, standard errors among them, that results are planned for.
_MAPS = 24

#: Runs a function on parts of the voxels; the answers come in the order of the parts.
Spread = Callable[[Callable[[slice], Any], Sequence[slice]], Iterable[Any]]


@dataclass(frozen=True)
class Execution:
    """How a request is carried out; no result depends on it.

    Args:
        memory: bytes that may be held, all workers of this machine together; None for a share of what is free.
        workers: processes that fit scans side by side on this machine; 0 fits them one by one in this one.
        scheduler: address of a dask scheduler whose workers fit the scans; "" for none.
        again: fit scans again that are finished.
    """

    memory: int | None = None
    workers: int = 0
    scheduler: str = ""
    again: bool = False

    def __post_init__(self) -> None:
        if self.workers < 0:
            raise InputError(f"--workers is {self.workers}; give how many processes fit scans side by side.")
        if self.workers and self.scheduler:
            raise InputError("--workers starts workers of its own and --scheduler has its own: give one of them.")


@dataclass(frozen=True)
class Resources:
    """What a scan may use.

    Args:
        memory: bytes that this process may hold, all that it holds already included.
        scratch: takes what does not fit.
        spread: who fits blocks of voxels.
        helpers: processes that fit them; of several, each gets some, and what they look at lies in files.
    """

    memory: int
    scratch: Scratch
    spread: Spread = map
    helpers: int = 1

    def plan(self, series: Series, voxels: int, models: int, *, denoised: bool = False) -> Plan:
        """How the voxels of a series are denoised and fitted within the memory.

        Raises:
            InputError: it does not hold one frame and what belongs to it.
        """
        here, grid = psutil.Process().memory_info().rss + _LATER, int(np.prod(series.shape))
        frame = grid * max(3 * max(series.header.dtype.itemsize, 4) + 12, _DENOISING if denoised else 0)
        voxel = 8 * (_PER_VOXEL + _PER_FRAME * series.count)
        left = self.memory - here - frame
        if left < voxel * PART:
            least = (here + frame + voxel * PART) / 2**30
            raise InputError(
                f"--memory {self.memory / 2**30:.2f}G is too little for a frame of {series.path.name}, the program and "
                f"a block of voxels; give at least {np.ceil(100 * least) / 100:.2f}G."
            )
        kept = 4 * voxels * series.count + 4 * (voxels + grid) * _MAPS * models
        on_disk = self.helpers > 1 or kept > left // 2 or _HELD < kept < self.scratch.free
        block = min((left if on_disk else left - kept) // voxel, busy())
        if self.helpers > 1:
            block = min(block, voxels // (2 * self.helpers))
        return Plan(self, on_disk, max(block // PART, 1) * PART, max(left // (8 * grid), 1))


@dataclass(frozen=True)
class Plan:
    """How the voxels of one scan are fitted.

    Args:
        resources: what it may use.
        on_disk: whether curves and results lie in files.
        block: voxels fitted at a time.
        maps: maps written at a time, at most.
    """

    resources: Resources
    on_disk: bool
    block: int
    maps: int

    def rows(self, name: str, rows: int, columns: int) -> Rows:
        """A table to be filled."""
        return self.resources.scratch.rows(name, rows, columns) if self.on_disk else Rows.in_memory(rows, columns)

    def release(self) -> None:
        """Let go of the pages of files that were looked at."""
        self.resources.scratch.release()

    def parts(self, count: int) -> list[slice]:
        """Blocks that make up range(count)."""
        return [slice(start, min(start + self.block, count)) for start in range(0, count, self.block)]


def free_memory() -> int:
    """Bytes that this process may take in where nobody says: a share of what is free, in its container too."""
    free = psutil.virtual_memory().available
    limit, used = (_CONTAINER / name for name in ("memory.max", "memory.current"))
    if limit.is_file() and (text := limit.read_text().strip()).isdecimal():
        free = min(free, int(text) - int(used.read_text()))
    return int(_SHARE * free) + psutil.Process().memory_info().rss
