"""Outputs that appear whole or not at all: written under a temporary name beside their place, then renamed into it."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePath
from types import TracebackType
from typing import BinaryIO

from petkin.errors import InputError

_TEMPORARY, _LOCK = ".petkin-", ".lock"
#: Which permissions this process does not give; there is no way to ask without changing it, which threads would see.
_UMASK = os.umask(0o077)
os.umask(_UMASK)


@contextmanager
def atomic_file(path: Path) -> Iterator[BinaryIO]:
    """A binary file for writing that takes the name `path` when the block ends well, and vanishes when it does not.

    Raises:
        InputError: the folder cannot be made or written.
    """
    make_folder(path.parent)
    try:
        descriptor, temporary = tempfile.mkstemp(prefix=_TEMPORARY, dir=path.parent)
    except OSError as error:
        raise _unwritable(path.parent, error) from error
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
        # mkstemp makes files private; outputs get the usual permissions.
        Path(temporary).chmod(0o666 & ~_UMASK)
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

    Each file is renamed into place, so none is ever half there; a folder that is not there before, be it `target` or
    one below it, appears with all that it holds in one rename. Files that are there under other names stay.

        with AtomicFolder(out) as folder:
            write_table(folder.path("sub-01/pet/sub-01_tacs.tsv"), table)

    Args:
        target: where the set goes.
        seal: name below `target` of the file that tells that the set is whole: an old one goes before the first file is
            moved, the new one comes after the last.
    """

    def __init__(self, target: Path, *, seal: PurePath | None = None) -> None:
        self.target = target
        self.seal = seal

    def __enter__(self) -> AtomicFolder:
        make_folder(self.target.parent)
        if self.target.exists() and not self.target.is_dir():
            raise InputError(f"{self.target}: is a file, not a folder; choose another output folder.")
        if self.target.exists() and not os.access(self.target, os.W_OK | os.X_OK):
            raise InputError(
                f"{self.target}: cannot be written; check its permissions or choose another output folder."
            )
        inside = self.target if self.target.exists() else self.target.parent
        self._temporary = temporary_folder(inside)
        try:
            self.staging = self._temporary.__enter__() / "out"
            self.staging.mkdir()
        except OSError as error:
            raise _unwritable(self.target, error) from error
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
            self._temporary.__exit__(None, None, None)

    def _move_in(self) -> None:
        try:
            self.staging.rename(self.target)
        except OSError as error:
            if not self.target.is_dir():
                raise _unwritable(self.target, error) from error
        else:
            return
        for path in self.staging.rglob("*"):
            if path.is_file():
                self._require(self.target / path.relative_to(self.staging))
        if self.seal is not None:
            (self.target / self.seal).unlink(missing_ok=True)
        self._move_each(self.staging, self.target)

    def _require(self, place: Path) -> None:
        """Whether a file may be put there."""
        _refuse_to_leave(self.target, place)
        folder = nearest_folder(place.parent)
        if place.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
            raise InputError(f"{place}: cannot be written; check the permissions of {folder}.")

    def _move_each(self, folder: Path, place: Path) -> None:
        """Move what a folder holds: folders whole, or piece by piece where there is one already; the seal last."""
        seal = None if self.seal is None else self.staging / self.seal
        for path in sorted(folder.iterdir(), key=lambda p: (seal is not None and p in (seal, *seal.parents), p)):
            there = place / path.name
            try:
                path.replace(there)
            except OSError as error:
                if not (path.is_dir() and there.is_dir()):
                    raise _unwritable(there, error) from error
                self._move_each(path, there)


@contextmanager
def temporary_folder(near: Path) -> Iterator[Path]:
    """A folder that vanishes when the block ends; if the process is killed outright, the next one removes it.

    A locked file beside it tells whether its owner lives: the system lets go of it when a process ends, however that
    comes about. The file is there before the folder and until after it, so what is left at any moment can be removed.
    """
    remove_orphans(near)
    path, lock = _locked(near)
    folder = path.with_suffix("")
    try:
        folder.mkdir(mode=0o700)
        yield folder
    finally:
        _remove(path)
        lock.close()


def remove_orphans(near: Path) -> None:
    """Remove temporary folders whose owners were killed outright."""
    for path in near.glob(f"{_TEMPORARY}*{_LOCK}"):
        with suppress(OSError), path.open("r+b") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _remove(path)


def _remove(lock: Path) -> None:
    """Remove a folder, then its lock; what cannot be removed now keeps its lock for the next process."""
    folder = lock.with_suffix("")
    shutil.rmtree(folder, ignore_errors=True)
    if not folder.exists():
        with suppress(OSError):
            lock.unlink()


def _locked(near: Path) -> tuple[Path, BinaryIO]:
    """A new file that this process has locked; where the file system has no locks, nobody else can lock it either."""
    while True:
        descriptor, name = tempfile.mkstemp(prefix=f"{_TEMPORARY}{os.getpid()}-", suffix=_LOCK, dir=near)
        lock = os.fdopen(descriptor, "r+b")
        with suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX)
        if Path(name).exists():  # else another process took it for an orphan's before it was locked
            return Path(name), lock
        lock.close()


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
    nearest = nearest_folder(folder)
    try:
        Path(tempfile.mkdtemp(prefix=_TEMPORARY, dir=nearest)).rmdir()
    except OSError as error:
        raise _unwritable(folder, error) from error


def nearest_folder(folder: Path) -> Path:
    """`folder`, or the nearest above it that exists.

    Raises:
        InputError: what exists there is a file.
    """
    nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    if not nearest.is_dir():
        raise InputError(f"{nearest}: is a file, not a folder; choose another output folder.")
    return nearest


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
