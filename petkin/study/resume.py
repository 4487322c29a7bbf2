"""Scans that need no second fit: the record that a finished scan leaves, and whether it still holds.

A record names the request, the input and the version by one fingerprint, and every file with its size. It is the last
file of a scan to appear and the first to go, so where it stands the scan is whole.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from petkin import __version__
from petkin.errors import InputError
from petkin.io import AtomicFolder, Remark, Severity, json_text, read_json, write_text
from petkin.io.names import record_path, report_path
from petkin.study.outcome import Fitted, Outcome
from petkin.study.request import FitRequest
from petkin.study.sources import Source


def fingerprint(source: Source, request: FitRequest) -> str:
    """Of all that the results of a scan depend on: what was read of it, its images to the byte, the request, petkin.

    Which other scans are fitted, where results go, how the command was typed and on what device it runs do not count.
    """
    anywhere = replace(request.choices, device=None)
    asked = replace(request, target=Path(), out=None, subjects=(), sessions=(), command_line="", choices=anywhere)
    digest = hashlib.sha256()
    for piece in (__version__, *_pieces(asked), *_content(Path(request.weights)), *_pieces(source)):
        digest.update(piece.encode() + b"\n" if isinstance(piece, str) else piece)
    return digest.hexdigest()


def write_record(folder: AtomicFolder, source: Source, request: FitRequest, fitted: Fitted) -> None:
    """Leave the record beside the files of a scan that lie in the staging folder."""
    files = sorted(path for path in folder.staging.rglob("*") if path.is_file())
    record = {
        "Fingerprint": fingerprint(source, request),
        "SoftwareVersion": __version__,
        "Files": {path.relative_to(folder.staging).as_posix(): path.stat().st_size for path in files},
        "InputDelay": fitted.delay,
        "InputDelayUnits": "min",
        "Outcomes": [asdict(outcome) for outcome in fitted.outcomes],
        "Remarks": [asdict(remark) for remark in fitted.remarks],
    }
    write_text(folder.path(record_path(source.entities)), json_text(record))


def finished(out: Path, source: Source, request: FitRequest) -> Fitted | None:
    """What an earlier run of the same request made of the same scan, if all of it is still there."""
    path = out / record_path(source.entities)
    if not path.is_file():
        return None
    try:
        record = read_json(path)
        whole = all((out / name).is_file() and (out / name).stat().st_size == n for name, n in record["Files"].items())
        if (
            not whole
            or record["SoftwareVersion"] != __version__
            or record["Fingerprint"] != fingerprint(source, request)
        ):
            return None
        return Fitted(
            label=source.label,
            delay=record["InputDelay"],
            outcomes=tuple(Outcome(**_with_nan(entry)) for entry in record["Outcomes"]),
            remarks=tuple(Remark(**{**entry, "severity": Severity(entry["severity"])}) for entry in record["Remarks"]),
            report=out / report_path(source.entities, desc="fit"),
            before=True,
        )
    except (InputError, KeyError, TypeError, AttributeError):  # not as this version writes it
        return None


def _with_nan(entry: Mapping[str, Any]) -> dict[str, Any]:
    """JSON has null where a number is missing."""
    return {key: float("nan") if value is None else value for key, value in entry.items()}


def _pieces(thing: Any) -> Iterator[str | bytes]:
    """A value taken apart into text and bytes, the same for the same value."""
    if isinstance(thing, Path):
        yield from _content(thing)
    elif isinstance(thing, np.ndarray):
        yield f"{thing.dtype.str} {thing.shape}"
        yield np.ascontiguousarray(thing).tobytes()
    elif isinstance(thing, pd.DataFrame):
        yield thing.to_csv(float_format="%.17g")
    elif is_dataclass(thing):
        for field in fields(thing):
            yield field.name
            yield from _pieces(getattr(thing, field.name))
    elif isinstance(thing, Mapping):
        yield from _pieces(sorted(thing.items()))
    elif isinstance(thing, list | tuple | set | frozenset):
        yield f"{len(thing)} entries"
        for item in thing:
            yield from _pieces(item)
    else:
        yield repr(thing.value) if isinstance(thing, Enum) else repr(thing)


def _content(path: Path) -> Iterator[str]:
    if path.is_file():
        with path.open("rb") as file:
            yield hashlib.file_digest(file, "sha256").hexdigest()
