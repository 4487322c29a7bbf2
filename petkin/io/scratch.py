"""Numbers that do not fit into memory: float32 rows in a file that vanishes when the work is done."""

from __future__ import annotations

import mmap
import os
import shutil
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.io.atomic import nearest_folder, temporary_folder


@dataclass(frozen=True)
class Rows:
    """A table of float32, in memory or mapped from a file.

    Args:
        array: (rows, columns).
        path: the file, or None.
        mapping: how it is mapped, or None.
    """

    array: NDArray[np.float32]
    path: Path | None = None
    mapping: mmap.mmap | None = None

    @classmethod
    def in_memory(cls, rows: int, columns: int) -> Rows:
        """A table to be filled."""
        return cls(np.empty((rows, columns), np.float32))

    @classmethod
    def mapped(cls, path: Path, rows: int, columns: int) -> Rows:
        """The table in a file that is there."""
        with path.open("r+b") as file:
            mapping = mmap.mmap(file.fileno(), 4 * rows * columns)
        return cls(np.frombuffer(mapping, np.float32).reshape(rows, columns), path, mapping)

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process gets the place of the file, not its content."""
        if self.path is None:
            return Rows, (self.array,)
        return Rows.mapped, (self.path, *self.array.shape)

    def release(self) -> None:
        """Let go of the pages that were looked at; what they hold stays in the file."""
        if self.mapping is not None:
            self.mapping.madvise(mmap.MADV_DONTNEED)


class Scratch:
    """A folder for tables, made near `place` when the first one needs it, removed when the block ends.

    with Scratch(out) as scratch:
        rows = scratch.rows("curves", 60, 10_000_000)
    """

    def __init__(self, place: Path) -> None:
        self.place = place
        self._open = ExitStack()
        self._folder: Path | None = None
        self._made: list[Rows] = []

    def __enter__(self) -> Scratch:
        return self

    @property
    def free(self) -> int:
        """Bytes that the disk still takes."""
        return shutil.disk_usage(nearest_folder(self.place)).free

    def rows(self, name: str, rows: int, columns: int) -> Rows:
        """A table in a file, to be filled.

        Raises:
            InputError: the disk has no room for it.
        """
        if self._folder is None:
            self._folder = self._open.enter_context(temporary_folder(nearest_folder(self.place)))
        size, free = 4 * rows * columns, self.free
        if size > free:
            raise InputError(
                f"{self._folder.parent}: has {free / 1e9:.3g} GB free, but {size / 1e9:.3g} GB of {name} do not fit "
                "into memory and go there while they are fitted; give more --memory, or another --out."
            )
        path = self._folder / name
        with path.open("wb") as file:
            # a mapped file that the disk cannot hold would end the program without a word
            reserve = getattr(os, "posix_fallocate", None)  # macOS has none
            reserve(file.fileno(), 0, size) if reserve else file.truncate(size)
        self._made.append(Rows.mapped(path, rows, columns))
        return self._made[-1]

    def release(self) -> None:
        """Let go of the pages of all tables that were looked at."""
        for rows in self._made:
            rows.release()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()
