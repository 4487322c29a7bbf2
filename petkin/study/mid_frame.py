"""How estimates would move if model curves were read at mid-frame instead of averaged over frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from petkin.fitting import Choices, FitResult, Given
from petkin.imaging import FrameObservation
from petkin.io import RegionalCurves
from petkin.methods import Method


def mid_frame_shift(averaged: FitResult, method: Method, curves: RegionalCurves, given: Given, choices: Choices) -> str:
    """One sentence: median change, over regions, of every quantity from frame averages to mid-frame values.

    Args:
        averaged: the fit of frame averages.
        method: its method.
        curves: what was fitted.
        given: what the scan gave it.
        choices: the same as for the fit.
    """
    at_middle = replace(given, observation=FrameObservation(curves.frames, mid_frame=True))
    read = method.fit(curves.values, at_middle, replace(choices, scrutiny=False), False)
    with np.errstate(all="ignore"):
        moved = {e.symbol: 100.0 * (read[e.symbol] / e.value - 1.0) for e in averaged.estimates}
    parts = [f"{s} {np.median(m[np.isfinite(m)]):+.2g} %" for s, m in moved.items() if np.isfinite(m).any()]
    if not parts:
        return "Mid-frame values cannot be compared: no region was fitted."
    return f"Read at mid-frame instead, estimates would move by (median over regions): {', '.join(parts)}."
