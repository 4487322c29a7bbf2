"""Frame schedules by name, by compact text, by count or from a file."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np

from petkin.errors import InputError
from petkin.imaging.frames import FrameSchedule
from petkin.units import SECONDS_PER_MINUTE

#: Named schedules as compact text: "count x seconds", "gap seconds".
#: paper: 40 min as in arXiv 2403.08194; fdg: 60 min; clinical: 90 min; interrupted: 90 min, no frames from 30 to 60.
SCHEDULES = {
    "paper": "80x30",
    "fdg": "8x10,2x20,2x30,2x60,2x150,10x300",
    "clinical": "12x10,6x20,6x30,3x60,5x120,14x300",
    "interrupted": "8x10,2x20,2x30,2x60,2x150,4x300,gap1800,6x300",
}

_PIECE = re.compile(
    r"^(?:(?P<count>\d+)\s*x\s*(?P<seconds>\d+(?:\.\d+)?)|gap\s*(?P<gap>\d+(?:\.\d+)?))$", re.IGNORECASE
)

#: Columns (TSV) or fields (JSON) that files use for (start, duration) and (start, end), all in seconds.
_START_DURATION = (("FrameTimesStart", "FrameDuration"), ("frame_start", "frame_duration"), ("start", "duration"))
_START_END = (("frame_start", "frame_end"), ("FrameTimesStart", "FrameTimesEnd"), ("start", "end"))


def frame_schedule(choice: str | int, *, length: float) -> FrameSchedule:
    """The schedule that an option asks for.

    Args:
        choice: a count (uniform frames over `length`), a name of `SCHEDULES`, compact text such as
            "12x10,6x20,gap600,5x300" (count x seconds), or a .tsv or .json file.
        length: scan length for a count, min.

    Raises:
        InputError: none of these.
    """
    text = str(choice).strip()
    if text.isdigit():
        if int(text) == 0:
            raise InputError("--frames 0: a scan needs at least one frame.")
        return FrameSchedule.uniform(int(text), length / int(text))
    if text in SCHEDULES:
        return parse_schedule(SCHEDULES[text], where=f"frame schedule {text!r}")
    if Path(text).suffix.lower() in {".tsv", ".json"}:
        return read_schedule(Path(text))
    if all(_PIECE.match(piece.strip()) for piece in text.split(",")):
        return parse_schedule(text, where=f"frame schedule {text!r}")
    raise InputError(
        f"--frames {text!r} is no schedule; give a count, a name ({', '.join(SCHEDULES)}), "
        'text such as "12x10,6x20" (count x seconds), or a .tsv or .json file.'
    )


def parse_schedule(text: str, *, where: str) -> FrameSchedule:
    """Compact text: comma-separated "COUNTxSECONDS" and "gapSECONDS".

    Raises:
        InputError: a piece that is neither.
    """
    clock, starts, durations = 0.0, [], []
    for piece in text.split(","):
        match = _PIECE.match(piece.strip())
        if match is None:
            raise InputError(f"{where}: {piece.strip()!r} is neither COUNTxSECONDS (12x10) nor gapSECONDS (gap600).")
        if match["gap"]:
            clock += float(match["gap"])
            continue
        count, seconds = int(match["count"]), float(match["seconds"])
        starts.extend(clock + seconds * np.arange(count))
        durations.extend([seconds] * count)
        clock += count * seconds
    return FrameSchedule.from_seconds(starts, durations, where=where)


def read_schedule(path: Path) -> FrameSchedule:
    """Frames from a table or a PET sidecar, in seconds: start with duration, or start with end.

    Args:
        path: .tsv with columns frame_start and frame_end (or frame_duration), or .json with FrameTimesStart and
            FrameDuration.

    Raises:
        InputError: no such file, no such columns, or frames that cannot be.
    """
    columns = _read_columns(path)
    for names, ends in ((_START_END, True), (_START_DURATION, False)):
        for start, other in names:
            if start in columns and other in columns:
                begun, value = _numbers(columns[start], path, start), _numbers(columns[other], path, other)
                if begun.size != value.size:
                    raise InputError(f"{path}: {begun.size} values of {start} but {value.size} of {other}.")
                return FrameSchedule.from_seconds(begun, value - begun if ends else value, where=str(path))
    raise InputError(
        f"{path}: no frame times found among {', '.join(columns) or 'no columns'}; "
        "give frame_start and frame_end (or frame_duration) in seconds."
    )


def in_seconds(frames: FrameSchedule) -> tuple[list[float], list[float]]:
    """Starts and durations in seconds, rounded to the microsecond, as sidecars hold them."""
    start = np.round(frames.start * SECONDS_PER_MINUTE, 6)
    duration = np.round(frames.duration * SECONDS_PER_MINUTE, 6)
    return start.tolist(), duration.tolist()


def _read_columns(path: Path) -> dict[str, list[object]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: the frame schedule cannot be read ({error}).") from error
    if path.suffix.lower() == ".json":
        try:
            fields = json.loads(text)
        except json.JSONDecodeError as error:
            raise InputError(f"{path}: not JSON (line {error.lineno}: {error.msg}).") from error
        if not isinstance(fields, dict):
            raise InputError(f"{path}: a JSON object with FrameTimesStart and FrameDuration is due here.")
        return {name: values for name, values in fields.items() if isinstance(values, list)}
    rows = list(csv.DictReader(text.splitlines(), delimiter="\t"))
    return {name: [row[name] for row in rows] for name in (rows[0] if rows else {}) if name is not None}


def _numbers(values: list[object], path: Path, name: str) -> np.ndarray:
    try:
        return np.array([float(v) for v in values])  # type: ignore[arg-type]
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: {name} holds something that is not a number ({error}).") from error
