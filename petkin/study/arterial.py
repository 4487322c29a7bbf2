"""From a scan's blood to its input function."""

from __future__ import annotations

import numpy as np
import pandas as pd

from petkin import units
from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.inputs import InputFunction, from_blood, from_table, input_table
from petkin.io import require_cover
from petkin.study.request import FitRequest
from petkin.study.sources import Source


def arterial_input(source: Source, request: FitRequest) -> InputFunction:
    """The input function of a scan, as sampled (no delay), kBq/mL over min.

    Raises:
        InputError: no blood, blood too short, or columns missing.
    """
    if source.blood is None:
        raise InputError(
            f"{source.label}: there is no blood (_blood.tsv); these models need an arterial input: give --blood."
        )
    blood = source.blood
    require_cover(blood, source.frames)
    manual, automatic = blood.manual, blood.automatic
    if manual is None:
        manual, automatic = automatic, None
    assert manual is not None
    if _is_ready(manual):
        return from_table(
            manual["time"].to_numpy(),
            manual["AIF"].to_numpy(),
            manual["whole_blood_radioactivity"].to_numpy() if "whole_blood_radioactivity" in manual else None,
            where=blood.where,
        )
    return from_blood(
        manual,
        automatic,
        parent_fraction=request.parent_fraction,
        plasma_from=request.plasma_from,
        dispersion=_dispersion(source, request) if automatic is not None else None,
        scan_end=float(source.frames.end[-1]),
        required_until=float(source.frames.start[-1]),
        where=blood.where,
    )


def _is_ready(table: pd.DataFrame) -> bool:
    """Whether a table is a finished input function: a dense AIF without a hole, read as straight lines."""
    if "AIF" not in table:
        return False
    columns = [c for c in ("AIF", "whole_blood_radioactivity") if c in table]
    return len(table) > 100 and bool(np.isfinite(table[columns].to_numpy(np.float64)).all())


def _dispersion(source: Source, request: FitRequest) -> float | None:
    """Time constant to correct for, min: as asked, else as stated by files that say they are not corrected."""
    if request.dispersion_s is not None:
        return units.minutes(request.dispersion_s) or None
    blood = source.blood
    return None if blood is None or blood.dispersion_corrected else blood.dispersion_constant


def sampled_input(arterial: InputFunction, frames: FrameSchedule) -> pd.DataFrame:
    """The input function on the grid that is written: 1 s for the first 10 min, 10 s later."""
    end = float(frames.end[-1])
    early = np.arange(0.0, min(10.0, end), 1.0 / 60.0)
    late = np.arange(10.0, end + 1e-9, 10.0 / 60.0)
    return input_table(arterial, np.concatenate([early, late]))
