from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path, PurePath

import pytest

from petkin.errors import InputError
from petkin.io.atomic import AtomicFolder, atomic_file, make_folder, write_text


class CrashError(Exception):
    """Stands for whatever ends a run in the middle of writing."""


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    """A folder that cannot be written; root writes everywhere, so root skips."""
    if os.geteuid() == 0:
        pytest.skip("root may write anywhere")
    folder = tmp_path / "locked"
    folder.mkdir()
    folder.chmod(0o500)
    yield folder
    folder.chmod(0o700)


def everything(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def test_a_file_appears_whole(tmp_path: Path) -> None:
    write_text(tmp_path / "new" / "a.txt", "content\n")
    assert everything(tmp_path) == ["new", "new/a.txt"]
    assert (tmp_path / "new/a.txt").read_text() == "content\n"


def test_files_get_the_usual_permissions(tmp_path: Path) -> None:
    (tmp_path / "usual").write_text("")
    write_text(tmp_path / "ours", "")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_a_crash_while_writing_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")

    def crash() -> None:
        with atomic_file(path) as file:
            file.write(b"half of the new")
            assert path.read_text() == "old"
            raise CrashError

    with pytest.raises(CrashError):
        crash()
    assert everything(tmp_path) == ["a.txt"]
    assert path.read_text() == "old"


def test_a_set_of_files_appears_together(tmp_path: Path) -> None:
    out = tmp_path / "derivatives" / "petkin"
    with AtomicFolder(out) as folder:
        write_text(folder.path("sub-01/pet/a.txt"), "a")
        write_text(folder.path("b.txt"), "b")
        assert not out.exists()
    assert everything(out) == ["b.txt", "sub-01", "sub-01/pet", "sub-01/pet/a.txt"]
    assert everything(out.parent) == ["petkin", *(f"petkin/{name}" for name in everything(out))]


def test_a_set_joins_what_is_there(tmp_path: Path) -> None:
    write_text(tmp_path / "sub-01/old.txt", "old")
    write_text(tmp_path / "sub-01/both.txt", "old")
    with AtomicFolder(tmp_path) as folder:
        write_text(folder.path("sub-01/both.txt"), "new")
        assert (tmp_path / "sub-01/both.txt").read_text() == "old"
    assert everything(tmp_path) == ["sub-01", "sub-01/both.txt", "sub-01/old.txt"]
    assert (tmp_path / "sub-01/both.txt").read_text() == "new"


def test_a_folder_that_is_not_there_appears_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever is killed between two moves leaves none of a subject or all of it."""
    write_text(tmp_path / "sub-01/pet/a.txt", "a")
    seen, replace = [], Path.replace

    def watched(path: Path, place: Path) -> Path:
        moved = replace(path, place)
        seen.append(everything(tmp_path / "sub-02"))
        return moved

    with AtomicFolder(tmp_path, seal=PurePath("sub-02/pet/a.txt")) as folder:
        for name in ("a.txt", "b.txt"):
            write_text(folder.path(f"sub-02/pet/{name}"), name)
        write_text(folder.path("z.txt"), "z")
        write_text(folder.path("sub-01/pet/b.txt"), "b")
        monkeypatch.setattr(Path, "replace", watched)
    whole = ["pet", "pet/a.txt", "pet/b.txt"]
    assert seen[-1] == whole
    assert all(there == [] for there in seen[:-1])
    assert everything(tmp_path / "sub-01") == whole


@pytest.mark.parametrize("there", [True, False])
def test_a_crash_leaves_none_of_a_set(tmp_path: Path, there: bool) -> None:
    out = tmp_path / "out"
    if there:
        out.mkdir()

    def crash() -> None:
        with AtomicFolder(out) as folder:
            write_text(folder.path("sub-01/a.txt"), "a")
            raise CrashError

    with pytest.raises(CrashError):
        crash()
    assert everything(tmp_path) == (["out"] if there else [])


@pytest.mark.parametrize("name", ["../a.txt", "/etc/a.txt", "sub-01/../../a.txt", ""])
def test_names_stay_inside(tmp_path: Path, name: str) -> None:
    with AtomicFolder(tmp_path / "out") as folder, pytest.raises(InputError, match="leaves the output folder"):
        folder.path(name)


def test_links_out_of_the_folder_are_not_followed(tmp_path: Path) -> None:
    elsewhere, out = tmp_path / "elsewhere", tmp_path / "out"
    elsewhere.mkdir()
    out.mkdir()
    (out / "sub-01").symlink_to(elsewhere)
    with pytest.raises(InputError, match="a link leads out of the output folder"), AtomicFolder(out) as folder:
        write_text(folder.path("sub-01/a.txt"), "a")
    assert everything(elsewhere) == []


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(InputError, match=r"out: is a file, not a folder"), AtomicFolder(tmp_path / "out"):
        pass
    with pytest.raises(InputError, match="cannot be written"):
        make_folder(tmp_path / "out" / "sub-01")


def test_a_folder_in_place_of_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(InputError, match=r"a.txt: cannot be written"):
        write_text(tmp_path / "a.txt", "")
    with pytest.raises(InputError, match=r"a.txt: cannot be written"), AtomicFolder(tmp_path) as folder:
        write_text(folder.path("a.txt"), "")
    assert everything(tmp_path) == ["a.txt"]


def test_an_unwritable_folder_is_one_line(read_only: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write_text(read_only / "a.txt", "")
    with pytest.raises(InputError, match="cannot be written"), AtomicFolder(read_only):
        pass
    with pytest.raises(InputError, match="cannot be written"), AtomicFolder(read_only / "out"):
        pass
