"""When effects may set in during a scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.imaging import FrameObservation

Array = NDArray[np.float64]

#: At which shares of a frame onsets are tried, none of them between two frames, where a refit that began there would
#: stand on a kink.
_WITHIN = (0.25, 0.75)
#: Onsets before this (min) would be told from blood and its delay by their timing alone; what happens to the scanner
#: changes all that the regions hold, and may do so from the second of these on, where so many onsets are tried.
_BOLUS_PASSED, _BOLUS_PAST_PEAK, _EARLY_ONSETS = 5.0, 2.0, 4


def onsets(
    clock: FrameObservation, most: int, within: tuple[float, ...] = _WITHIN, *, scanner: bool
) -> tuple[float, ...]:
    """Times at so many shares of every frame after the bolus has passed, before the middle of the last, thinned; those
    of the scanner begin earlier."""
    frames = clock.frames
    times = np.sort(np.concatenate([frames.start + share * frames.duration for share in within]))
    passed, last = onset_bounds(clock, scanner=False)
    first, _ = onset_bounds(clock, scanner=scanner)
    early, late = times[(times > first) & (times <= passed)], times[(times > passed) & (times < last)]
    return (*_thinned(early, _EARLY_ONSETS), *_thinned(late, most))


def _thinned(times: Array, most: int) -> tuple[float, ...]:
    return tuple(times[np.unique(np.linspace(0, times.size - 1, min(most, times.size)).round().astype(int))])


def onset_bounds(clock: FrameObservation, *, scanner: bool) -> tuple[float, float]:
    """The first and the last time at which something may set in, min."""
    frames = clock.frames
    first = _BOLUS_PAST_PEAK if scanner else _BOLUS_PASSED
    return min(first, 0.1 * float(frames.end[-1])), float(frames.mid[-1])
