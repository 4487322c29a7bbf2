"""Frame schedules by name, by compact text or by count."""

from __future__ import annotations

import re

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

#: What one axis of a NIfTI-1 image holds.
_MOST_FRAMES = 32767
_PIECE = re.compile(
    r"^(?:(?P<count>\d+)\s*x\s*(?P<seconds>\d+(?:\.\d+)?)|gap\s*(?P<gap>\d+(?:\.\d+)?))$", re.IGNORECASE
)


def frame_schedule(choice: str | int, *, length: float) -> FrameSchedule:
    """The schedule that an option asks for.

    Args:
        choice: a count (uniform frames over `length`), a name of `SCHEDULES`, or compact text such as
            "12x10,6x20,gap600,5x300" (count x seconds).
        length: scan length for a count, min.

    Raises:
        InputError: none of these.
    """
    text = str(choice).strip()
    if text.isdigit():
        if not 1 <= int(text) <= _MOST_FRAMES:
            raise InputError(f"--frames {text}: a scan has 1 to {_MOST_FRAMES} frames.")
        return FrameSchedule.uniform(int(text), length / int(text))
    if text in SCHEDULES:
        return parse_schedule(SCHEDULES[text], where=f"frame schedule {text!r}")
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
        if len(starts) + count > _MOST_FRAMES:
            raise InputError(f"{where}: more than {_MOST_FRAMES} frames.")
        starts.extend(clock + seconds * np.arange(count))
        durations.extend([seconds] * count)
        clock += count * seconds
    return FrameSchedule.from_seconds(starts, durations, where=where)


def in_seconds(frames: FrameSchedule) -> tuple[list[float], list[float]]:
    """Starts and durations in seconds, rounded to the microsecond, as sidecars hold them."""
    start = np.round(frames.start * SECONDS_PER_MINUTE, 6)
    duration = np.round(frames.duration * SECONDS_PER_MINUTE, 6)
    return start.tolist(), duration.tolist()
