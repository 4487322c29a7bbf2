"""Frame times from a file of their own: a TSV or a JSON beside a plain image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.io.jsonfile import read_json
from petkin.io.tables import numbers, read_table

_STARTS = ("frame_start", "FrameTimesStart", "start")
_ENDS = ("frame_end", "FrameTimesEnd", "end")
_DURATIONS = ("frame_duration", "FrameDuration", "duration")


def read_schedule(path: Path) -> FrameSchedule:
    """Frames from a TSV (frame_start and frame_end or frame_duration) or a JSON (FrameTimesStart, FrameDuration), in s.

    Raises:
        InputError: no such columns or fields, a value that is not a number, overlapping or empty frames.
    """
    if path.suffix != ".json":
        table = read_table(path)
        start_s, end_s, _ = frame_columns(table, where=path.name)
        return FrameSchedule.from_seconds(start_s, end_s - start_s, where=path.name)
    fields = read_json(path)
    start, duration = (_field(fields, name, path.name) for name in ("FrameTimesStart", "FrameDuration"))
    return FrameSchedule.from_seconds(start, duration, where=path.name)


def frame_columns(table: pd.DataFrame, *, where: str) -> tuple[NDArray[np.float64], NDArray[np.float64], list[str]]:
    """Frame starts and ends (s) of a table, and the names of the columns that hold them.

    Raises:
        InputError: no such columns, or a cell that is not a finite number.
    """
    start = _first(table, _STARTS)
    end, duration = _first(table, _ENDS), _first(table, _DURATIONS)
    if start is None or (end is None and duration is None):
        found = ", ".join(map(str, table.columns[:6]))
        raise InputError(f"{where}: no columns frame_start and frame_end (s); found {found}.")
    used = [name for name in (start, end, duration) if name is not None]
    start_s = numbers(table, start, where=where)
    end_s = numbers(table, end, where=where) if end else start_s + numbers(table, str(duration), where=where)
    if not (np.isfinite(start_s).all() and np.isfinite(end_s).all()):
        row = int(np.flatnonzero(~np.isfinite(start_s + end_s))[0])
        raise InputError(f"{where}: a frame time is missing in row {row + 1}; every frame needs its start and end.")
    return start_s, end_s, used


def _first(table: pd.DataFrame, names: tuple[str, ...]) -> str | None:
    return next((name for name in names if name in table.columns), None)


def _field(fields: dict[str, object], name: str, where: str) -> NDArray[np.float64]:
    if name not in fields:
        raise InputError(f"{where}: {name} is missing; give one value a frame, in seconds.")
    try:
        values = np.asarray(fields[name], np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: {name} is not a list of numbers.") from error
    if values.ndim != 1:
        raise InputError(f"{where}: {name} is not a list of numbers.")
    return values
