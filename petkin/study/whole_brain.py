"""What is decided once a scan, from the curve of the whole brain: frame weights and the delay of the input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting import Delay, counting_weights, estimate_delay
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs import InputFunction
from petkin.io import RegionalCurves, read_table
from petkin.io.tables import numbers
from petkin.kinetics import ONE_TISSUE, TWO_TISSUE
from petkin.study.request import FitRequest
from petkin.study.series import VoxelCurves
from petkin.study.sources import Source

#: Frames as long as this (min), all of them while the tracer arrives, average a delay of seconds away.
_LONG, _ARRIVAL = 0.75, 3.0
#: Times closer than this are one, min.
_SAME_TIME = 1e-3


def whole_brain(voxels: VoxelCurves | None, curves: RegionalCurves | None) -> NDArray[np.float64]:
    """Mean curve of all that is fitted (K,): voxels in the mask, else regions by volume where volumes are known.

    Raises:
        InputError: nothing to take a mean of.
    """
    if voxels is not None:
        return voxels.mean
    if curves is None:
        raise InputError("There are neither voxels nor regions to fit.")
    usable = np.isfinite(curves.values).all(axis=1) & (curves.values.sum(axis=1) > 0)
    if not usable.any():
        raise InputError(f"{curves.where}: no region holds finite values above zero.")
    volumes = np.full(len(curves.names), np.nan) if curves.volumes is None else curves.volumes
    known = volumes[usable]
    usual = np.nanmean(known) if np.isfinite(known).any() else 1.0
    return np.average(curves.values[usable], axis=0, weights=np.where(np.isfinite(known), known, usual))


def frame_weights(whole: NDArray[np.float64], source: Source, request: FitRequest) -> tuple[NDArray[np.float64], str]:
    """Frame weights (K,) as asked, and a sentence on them.

    Raises:
        InputError: no activity to derive them from; a table without a column `weight`, or of another length; no frame
            to fit, or none to forecast.
    """
    weights, how = _all_weights(whole, source, request)
    if request.until is None:
        return weights, how
    later = after(source.frames, request.until)
    if later.all() or not later.any():
        raise InputError(
            f"{source.label}: frames end at {source.frames.end[0]:.4g} to {source.frames.end[-1]:.4g} min; "
            f"--until {request.until:g} leaves none to {'fit' if later.all() else 'forecast'}."
        )
    return np.where(later, 0.0, weights), f"{how}; frames that end after {request.until:g} min are forecast, not fitted"


def after(frames: FrameSchedule, minutes: float) -> NDArray[np.bool_]:
    """Frames that end later (K,)."""
    return frames.end > minutes + _SAME_TIME


def _all_weights(whole: NDArray[np.float64], source: Source, request: FitRequest) -> tuple[NDArray[np.float64], str]:
    if request.weights == "counting":
        if not whole.max() > 0:
            raise InputError(f"{source.label}: the mean of all curves is nowhere above zero; is it the right mask?")
        how = "w_k ~ d_k exp(-lambda t_k) / C_k of the whole-brain curve, mean 1 (counting noise)"
        return counting_weights(whole, source.frames, source.decay), how
    if request.weights == "constant":
        return np.ones(len(whole)), "all frames weigh the same"
    path = Path(request.weights)
    if not path.is_file():
        raise InputError(f"--weights {request.weights!r}: choose counting or constant, or give a table that exists.")
    table = read_table(path)
    if "weight" not in table or len(table) != len(whole):
        raise InputError(
            f"{path}: needs a column 'weight' with {len(whole)} rows, one a frame; it has {len(table)} rows."
        )
    weights = numbers(table, "weight", where=path.name)
    if not (np.isfinite(weights).all() and (weights >= 0).all() and weights.any()):
        raise InputError(f"{path}: weights must be finite and not negative, and not all zero.")
    return weights, f"from {path.name}"


def shared_delay(
    whole: NDArray[np.float64],
    arterial: InputFunction | None,
    observation: FrameObservation,
    weights: NDArray[np.float64],
    request: FitRequest,
    curves: RegionalCurves | None = None,
) -> tuple[Delay | None, tuple[float, float], str]:
    """The estimate, if one was asked for; the delay to apply (min) with its error; and a warning, or "".

    Raises:
        InputError: too few frames to estimate it.
    """
    if arterial is None:
        return None, (0.0, float("nan")), ""
    if not isinstance(request.delay, str):
        return None, (float(request.delay), float("nan")), ""
    counted = int(np.count_nonzero(weights))
    model = TWO_TISSUE if counted > len(TWO_TISSUE.parameters) + 3 else ONE_TISSUE
    if counted < len(model.parameters) + 2:
        raise InputError(
            f"{observation.frames.where}: {counted} frames with weight are too few to estimate the delay between blood "
            "and brain; give --delay 0, or more frames."
        )
    seen = seen_for_delay(whole, observation, request, curves)
    found = estimate_delay(seen, arterial, observation, weights, model, rate_bounds=request.choices.rate_bounds)
    if not found.at_end:
        return found, (found.minutes, found.se), ""
    text = (
        f"The delay between blood and brain could not be estimated (it ran to {found.minutes * 60:.0f} s, an end of "
        "the span): none was applied; check the blood's time zero, or give --delay."
    )
    return found, (0.0, float("nan")), text


def coarse_frames(frames: FrameSchedule, delay: Delay | None) -> str:
    """That frames are too long to tell the delay that was estimated from them, or ""."""
    if delay is None or delay.at_end:
        return ""
    early = frames.duration[frames.start < _ARRIVAL]
    if early.size and early.min() < _LONG:
        return ""
    seen = f"frames of {60 * early.min():.0f} s and longer" if early.size else "no frame"
    return (
        f"The delay between blood and brain ({60 * delay.minutes:.0f} s) was estimated with {seen} in the first "
        f"{_ARRIVAL:g} min, while the tracer arrives: it may be off by more than its standard error says (17 s were "
        "seen with frames of 120 s); give --delay where it is known."
    )


def seen_for_delay(
    whole: NDArray[np.float64], observation: FrameObservation, request: FitRequest, curves: RegionalCurves | None
) -> NDArray[np.float64]:
    """The whole brain (K,), or all regions (N, K) where they are to share the delay."""
    return _regions(curves, observation) if request.share_delay else whole


def _regions(curves: RegionalCurves | None, observation: FrameObservation) -> NDArray[np.float64]:
    """Curves of all regions that hold numbers and activity (N, K)."""
    if curves is None:
        raise InputError(f"{observation.frames.where}: --share delay needs regions; give --dseg or --tacs.")
    usable = np.isfinite(curves.values).all(axis=1) & (curves.values.sum(axis=1) > 0)
    return np.ascontiguousarray(curves.values[usable], np.float64)
