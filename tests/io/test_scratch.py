from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.io import atomic
from petkin.io.atomic import AtomicFolder, remove_orphans, temporary_folder, write_text
from petkin.io.scratch import Rows, Scratch


def test_a_table_in_a_file_is_a_table(tmp_path: Path) -> None:
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    with Scratch(tmp_path / "absent" / "out") as scratch:
        assert not list(tmp_path.iterdir())
        rows = scratch.rows("curves", 3, 4)
        rows.array[1] = values[1]
        rows.array[:, :2] = values[:, :2]
        rows.release()
        rows.array[:, 2:] = values[:, 2:]
        scratch.release()
        np.testing.assert_array_equal(rows.array, values)
        elsewhere = pickle.loads(pickle.dumps(rows))
        np.testing.assert_array_equal(elsewhere.array, values)
        assert len(pickle.dumps(rows)) < 500
    assert not list(tmp_path.iterdir())


def test_a_table_in_memory_travels_whole() -> None:
    rows = Rows.in_memory(2, 3)
    rows.array[:] = 1.0
    rows.release()
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(rows)).array, np.ones((2, 3)))


def test_a_disk_that_is_too_small_is_one_line(tmp_path: Path) -> None:
    with Scratch(tmp_path) as scratch, pytest.raises(InputError, match="of curves do not fit into memory"):
        scratch.rows("curves", 2**20, 2**40)
    assert not list(tmp_path.iterdir())


def test_folders_of_the_living_stay_and_those_of_the_dead_go(tmp_path: Path) -> None:
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom petkin.io.atomic import temporary_folder\n"
        "with temporary_folder(Path(sys.argv[1])) as folder:\n"
        "    (folder / 'half').write_text('x')\n    print(folder, flush=True)\n    time.sleep(600)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    folder = Path(process.stdout.readline().strip())
    assert str(process.pid) in folder.name
    with temporary_folder(tmp_path) as mine:
        remove_orphans(tmp_path)
        assert folder.is_dir()
        assert mine.is_dir()
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    assert folder.is_dir()
    with AtomicFolder(tmp_path) as target:
        write_text(target.path("a"), "a")
        assert not folder.exists()
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_the_seal_goes_first_and_comes_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seal = Path("a_seal.json")  # its name sorts before the other's
    for content in ("old", "new"):
        moved: list[tuple[str, bool]] = []
        replace = Path.replace

        def watched(source: Path, place: Path, moved: list = moved, replace=replace) -> Path:
            moved.append((place.name, (tmp_path / seal).exists()))
            return replace(source, place)

        with AtomicFolder(tmp_path, seal=seal) as folder:
            write_text(folder.path("b"), content)
            write_text(folder.path(seal), content)
            monkeypatch.setattr(Path, "replace", watched)
        monkeypatch.undo()
        assert moved == [("b", False), ("a_seal.json", False)]
    assert (tmp_path / seal).read_text() == "new"


def test_two_that_make_the_same_folder_both_end_well(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with AtomicFolder(out) as first, AtomicFolder(out) as second:
        write_text(first.path("one"), "1")
        write_text(second.path("two"), "2")
    assert sorted(path.name for path in out.iterdir()) == ["one", "two"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("held", [None, (), ("out", "half")])
def test_whatever_the_dead_left_goes_at_once(tmp_path: Path, held: tuple[str, ...] | None) -> None:
    """Killed before its folder was made or after it was removed, with nothing in it, in the middle of the work."""
    (tmp_path / ".petkin-1-abc.lock").touch()
    if held is not None:
        (tmp_path / ".petkin-1-abc").mkdir()
        for name in held:
            (tmp_path / ".petkin-1-abc" / name).touch()
    remove_orphans(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_lock_taken_for_an_orphan_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another process may look for orphans between the moment that a lock's file is made and that it is locked."""
    flock, seen = atomic.fcntl.flock, list[int]()

    def late(file: object, operation: int) -> None:
        seen.append(operation)
        if len(seen) == 1:
            remove_orphans(tmp_path)
        flock(file, operation)

    monkeypatch.setattr(atomic.fcntl, "flock", late)
    with temporary_folder(tmp_path) as mine:
        remove_orphans(tmp_path)
        assert sorted(path.name for path in tmp_path.iterdir()) == [mine.name, f"{mine.name}.lock"]
    assert len(seen) == 4
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_locked_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the file system has no locks, nobody knows whether its owner lives."""
    monkeypatch.setattr(atomic.fcntl, "flock", refused)
    with temporary_folder(tmp_path) as mine:
        remove_orphans(tmp_path)
        assert mine.is_dir()
    assert not list(tmp_path.iterdir())


def test_a_lock_that_cannot_be_removed_hides_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "unlink", refused)
    with pytest.raises(KeyError), temporary_folder(tmp_path):
        raise KeyError


def refused(*_: object, **__: object) -> None:
    raise OSError("no locks available")
