"""Outputs that appear whole or not at all: written under a temporary name beside their place, then renamed into it."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath
from types import TracebackType
from typing import BinaryIO

from petkin.errors import InputError


@contextmanager
def atomic_file(path: Path) -> Iterator[BinaryIO]:
    """A binary file for writing that takes the name `path` when the block ends well, and vanishes when it does not.

    Raises:
        InputError: the folder cannot be made or written.
    """
    make_folder(path.parent)
    try:
        descriptor, temporary = tempfile.mkstemp(prefix=".petkin-", dir=path.parent)
    except OSError as error:
        raise _unwritable(path.parent, error) from error
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
        # mkstemp makes files private; outputs get the usual permissions.
        Path(temporary).chmod(0o666 & ~_umask())
        _replace(Path(temporary), path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all."""
    with atomic_file(path) as file:
        file.write(content)


def write_text(path: Path, content: str) -> None:
    """Write UTF-8 text whole or not at all."""
    write_bytes(path, content.encode())


class AtomicFolder:
    """A set of outputs: files written under `staging` move below `target` when the block ends well, else none does.

    Each file is renamed into place, so none is ever half there; where `target` did not exist before, the whole set
    appears in one rename. Files that `target` already holds under other names stay.

        with AtomicFolder(out) as folder:
            write_table(folder.path("sub-01/pet/sub-01_tacs.tsv"), table)
    """

    def __init__(self, target: Path) -> None:
        self.target = target

    def __enter__(self) -> AtomicFolder:
        make_folder(self.target.parent)
        if self.target.exists() and not self.target.is_dir():
            raise InputError(f"{self.target}: is a file, not a folder; choose another output folder.")
        if self.target.exists() and not os.access(self.target, os.W_OK | os.X_OK):
            raise InputError(
                f"{self.target}: cannot be written; check its permissions or choose another output folder."
            )
        try:
            inside = self.target if self.target.exists() else self.target.parent
            self._temporary = Path(tempfile.mkdtemp(prefix=".petkin-", dir=inside))
        except OSError as error:
            raise _unwritable(self.target, error) from error
        self.staging = self._temporary / "out"
        self.staging.mkdir()
        return self

    def path(self, relative: str | PurePath) -> Path:
        """Where to write the file that will be `target/relative`; its folder exists.

        Raises:
            InputError: the path would leave the folder.
        """
        inside = PurePath(relative)
        if inside.is_absolute() or ".." in inside.parts or not inside.parts:
            raise InputError(f"Output name {str(relative)!r} leaves the output folder {self.target}.")
        staged = self.staging / inside
        make_folder(staged.parent)
        return staged

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._move_in()
        finally:
            shutil.rmtree(self._temporary, ignore_errors=True)

    def _move_in(self) -> None:
        if not self.target.exists():
            _replace(self.staging, self.target)
            return
        files = sorted(path for path in self.staging.rglob("*") if path.is_file())
        places = [self.target / path.relative_to(self.staging) for path in files]
        for place in places:
            _refuse_to_leave(self.target, place)
            make_folder(place.parent)
            if place.is_dir() or not os.access(place.parent, os.W_OK | os.X_OK):
                raise InputError(f"{place}: cannot be written; check the permissions of {place.parent}.")
        for path, place in zip(files, places, strict=True):
            _replace(path, place)


def make_folder(folder: Path) -> None:
    """Make a folder and its parents.

    Raises:
        InputError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(folder, error) from error


def require_writable(folder: Path) -> None:
    """Whether `folder` can be made and written, before hours of work go into what would not find its place.

    Raises:
        InputError: it, or the nearest folder above it that exists, is a file or cannot be written.
    """
    nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    if not nearest.is_dir():
        raise InputError(f"{nearest}: is a file, not a folder; choose another output folder.")
    try:
        Path(tempfile.mkdtemp(prefix=".petkin-", dir=nearest)).rmdir()
    except OSError as error:
        raise _unwritable(folder, error) from error


def _refuse_to_leave(folder: Path, place: Path) -> None:
    if not place.parent.resolve().is_relative_to(folder.resolve()):
        raise InputError(
            f"{place}: a link leads out of the output folder {folder}; remove it or choose another folder."
        )


def _replace(source: Path, place: Path) -> None:
    try:
        source.replace(place)
    except OSError as error:
        raise _unwritable(place, error) from error


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(f"{path}: cannot be written ({error.strerror or error}); choose another output folder.")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
