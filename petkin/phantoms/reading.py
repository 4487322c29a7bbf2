"""Where phantoms and populations lie, and how their files are read."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from petkin.errors import InputError
from petkin.phantoms.definition import Phantom

_PACKAGED = Path(__file__).with_name("catalogue")
_IN_REPOSITORY = Path(__file__).resolve().parents[2] / "phantoms"

M = TypeVar("M", bound=BaseModel)


def catalogue_folder() -> Path:
    """The folder of the phantoms that petkin ships: beside the package in a checkout, inside it in an installed wheel.

    Raises:
        InputError: neither is there.
    """
    for folder in (_PACKAGED, _IN_REPOSITORY):
        if (folder / "brain2d.toml").is_file():
            return folder
    raise InputError(f"petkin's own phantoms are missing (looked in {_PACKAGED} and {_IN_REPOSITORY}); reinstall it.")


def phantom_names() -> tuple[str, ...]:
    """Names of the shipped phantoms."""
    return tuple(sorted(p.stem for p in catalogue_folder().glob("*.toml")))


def read_phantom(name: str | Path) -> Phantom:
    """A phantom by its name, or from a .toml file of one's own.

    Raises:
        InputError: no such phantom, or a file that does not describe one.
    """
    return read_described(str(name), catalogue_folder(), Phantom, "phantom", phantom_names())


def phantom_with(regions: int) -> Phantom:
    """The shipped phantom with this many regions.

    Raises:
        InputError: there is none.
    """
    sizes = {len(read_phantom(name).regions): name for name in phantom_names()}
    if regions not in sizes:
        known = ", ".join(f"{count} ({name})" for count, name in sorted(sizes.items()))
        raise InputError(f"--roi {regions}: no phantom has that many; choose {known}, or give --phantom FILE.toml.")
    return read_phantom(sizes[regions])


def read_described(name: str, folder: Path, kind: type[M], noun: str, known: tuple[str, ...]) -> M:
    """A shipped description by its name, or one's own by its path."""
    if name in known:
        return _parse(folder / f"{name}.toml", kind, noun)
    if name.endswith(".toml"):
        return _parse(Path(name), kind, noun)
    raise InputError(f"There is no {noun} {name!r}; choose one of {', '.join(known)}, or give a .toml file.")


def _parse(path: Path, kind: type[M], noun: str) -> M:
    try:
        return kind.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: the {noun} cannot be read ({error}).") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not a TOML file ({error}).") from error
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or noun
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise InputError(f"{path}: {field}: {first['msg']}{more}; correct the {noun} file.") from error
