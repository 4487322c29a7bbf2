"""Frame times from a file of their own: a TSV or a JSON beside a plain image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.io.checks import refuse_minutes
from petkin.io.jsonfile import read_json
from petkin.io.tables import numbers, read_table

_STARTS = ("frame_start", "FrameTimesStart", "start")
_ENDS = ("frame_end", "FrameTimesEnd", "end")
_DURATIONS = ("frame_duration", "FrameDuration", "duration")


def read_schedule(path: Path, *, nuclide: str | None = None) -> FrameSchedule:
    """Frames from a TSV (frame_start and frame_end or frame_duration) or a JSON (FrameTimesStart, FrameDuration), in s.

    Args:
        path: the file. A JSON may be a whole `_pet.json`.
        nuclide: radionuclide, to tell a short scan of a short-lived one from times in minutes.

    Raises:
        InputError: no such columns or fields, a value that is not a number, overlapping or empty frames, times in
            minutes, or a JSON that says that the image is not decay-corrected to time zero.
    """
    if path.suffix != ".json":
        start_s, end_s, (start, end) = frame_columns(read_table(path), where=path.name)
        frames = FrameSchedule.from_seconds(start_s, end_s - start_s, where=path.name)
        refuse_minutes(frames, nuclide, fields=f"{start} and {end}")
        return frames
    fields = read_json(path)
    start_s, duration_s = (_field(fields, name, path.name) for name in ("FrameTimesStart", "FrameDuration"))
    frames = FrameSchedule.from_seconds(start_s, duration_s, where=path.name)
    refuse_minutes(frames, nuclide, fields="FrameTimesStart and FrameDuration")
    if fields.get("ImageDecayCorrected", True) is not True or fields.get("ImageDecayCorrectionTime", 0) != 0:
        raise InputError(
            f"{path.name}: says that the image is not decay-corrected to time zero; place both in a PET-BIDS study, "
            "where frames are corrected as they are read."
        )
    return frames


def frame_columns(
    table: pd.DataFrame, *, where: str
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[str, str]]:
    """Frame starts and ends (s) of a table, and the names of the columns that hold them.

    Raises:
        InputError: no such columns, or a cell that is not a finite number.
    """
    start = _first(table, _STARTS)
    end, duration = _first(table, _ENDS), _first(table, _DURATIONS)
    if start is None or (end is None and duration is None):
        found = ", ".join(map(str, table.columns[:6]))
        raise InputError(f"{where}: no columns frame_start and frame_end (s); found {found}.")
    start_s = numbers(table, start, where=where)
    end_s = numbers(table, end, where=where) if end else start_s + numbers(table, str(duration), where=where)
    if not (np.isfinite(start_s).all() and np.isfinite(end_s).all()):
        row = int(np.flatnonzero(~np.isfinite(start_s + end_s))[0])
        raise InputError(f"{where}: a frame time is missing in row {row + 1}; every frame needs its start and end.")
    return start_s, end_s, (start, end or str(duration))


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
