"""Traps between blood and image: each is one function that returns remarks, or refuses with one line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.io.blood import BloodRecord
from petkin.io.remarks import Remark, severe, warning
from petkin.units import SECONDS_PER_MINUTE

#: Blood must reach this share of the scan; the input function goes on from its last samples for the rest.
SHARE_OF_SCAN = 0.9
#: Blood that lasts this many times the scan has its times in another unit than it says.
_FAR_BEYOND = 20.0
#: Blood peak over tissue peak, both in kBq/mL: real tracers lie between about 0.3 and 50.
_PLAUSIBLE_PEAK_RATIO = (0.05, 500.0)


def require_cover(blood: BloodRecord, frames: FrameSchedule) -> tuple[Remark, ...]:
    """Whether blood lasts as long as the scan; a remark where it ends early.

    Raises:
        InputError: no activity at all; it ends before 90 percent of the scan; or its times are in another unit.
    """
    end, scan = blood.end, float(frames.end[-1])
    if np.isnan(end):
        raise InputError(f"{blood.where}: no activity was measured; a plasma or whole-blood value is needed.")
    end_s, scan_s = end * SECONDS_PER_MINUTE, scan * SECONDS_PER_MINUTE
    if end < SHARE_OF_SCAN * scan:
        hint = " (times in minutes where seconds are stated?)" if 40 < scan / max(end, 1e-9) < 90 else ""
        raise InputError(
            f"{blood.where}: blood ends at {end_s:.6g} s but the last frame ends at {scan_s:.6g} s{hint}; at least "
            f"{SHARE_OF_SCAN:.0%} of the scan is needed: add samples or leave out the frames after them."
        )
    if end > _FAR_BEYOND * scan:
        raise InputError(
            f"{blood.where}: blood ends at {end_s:.6g} s but the last frame at {scan_s:.6g} s; check the Units of time."
        )
    if end < scan - 1 / SECONDS_PER_MINUTE:
        early = f"{scan_s - end_s:.4g} s before the last frame does"
        text = f"Blood ends at {end_s:.6g} s, {early}; the input function is extrapolated until then."
        return (warning("blood-short", blood.where, text),)
    return ()


def against_tissue(blood: BloodRecord, tissue: NDArray[np.floating]) -> tuple[Remark, ...]:
    """Peak of the blood against the peak of the tissue: a unit that is wrong by a thousand shows here.

    Args:
        blood: the record.
        tissue: regional or whole-brain frame values, kBq/mL, any shape.
    """
    peak, finite = blood.peak, tissue[np.isfinite(tissue)]
    if not np.isfinite(peak) or not finite.size or finite.max() <= 0:
        return ()
    low, high = _PLAUSIBLE_PEAK_RATIO
    ratio = peak / float(finite.max())
    if low <= ratio <= high:
        return ()
    stated = " and ".join(blood.units)
    text = (
        f"Blood peaks at {peak:.3g} kBq/mL but tissue at {finite.max():.3g} kBq/mL, a ratio of {ratio:.2g}; a unit is "
        f"almost certainly wrong (the blood says {stated}), and with it K1 and VT."
    )
    return (severe("blood-scale", blood.where, text),)


def against_image_unit(blood: BloodRecord, image_unit: str) -> tuple[Remark, ...]:
    """Blood and image in different units: both are converted."""
    others = [unit for unit in blood.units if unit.lower() != image_unit.strip().lower()]
    if not others:
        return ()
    text = f"Blood is in {' and '.join(others)}, the image in {image_unit}; both are converted to kBq/mL."
    return (warning("blood-unit", blood.where, text),)


def complete(blood: BloodRecord) -> tuple[Remark, ...]:
    """What an input function lacks: plasma, or the parent fraction."""
    columns = {name for table in blood.tables for name in table.columns if np.isfinite(table[name].to_numpy()).any()}
    if "AIF" in columns:
        return ()
    remarks = []
    if "plasma_radioactivity" not in columns:
        text = "No plasma was measured; whole blood alone does not tell how much tracer plasma carries."
        remarks.append(warning("no-plasma", blood.where, text))
    if "metabolite_parent_fraction" not in columns:
        text = "No parent fraction was measured; all plasma activity counts as unchanged tracer."
        remarks.append(warning("no-parent-fraction", blood.where, text))
    return tuple(remarks)
