"""From a scan's blood to its input function."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from petkin import units
from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.inputs import InputFunction, from_blood, from_table, input_table
from petkin.io import BloodRecord, Remark, join_recordings, read_blood_table, require_cover
from petkin.io.blood_checks import against_image_unit, complete
from petkin.io.blood_table import FRACTION
from petkin.io.names import FileName
from petkin.study.request import FitRequest
from petkin.study.sources import Source

#: Rows from which on a table with an AIF in every row is a finished curve, not samples to be read between.
_DENSE = 100


def given_blood(paths: Sequence[Path]) -> BloodRecord | None:
    """Recordings given by file; which is whose is told by recording-<label> in their names, else by their sampling."""
    tables = {FileName.parse(path).entities.get("recording", str(path)): read_blood_table(path) for path in paths}
    if len(tables) < len(paths):
        raise InputError(f"--blood: {', '.join(path.name for path in paths)} are of one recording; give each one once.")
    return join_recordings(tables) if tables else None


def remarks_on_given(blood: BloodRecord, image_unit: str, frames: FrameSchedule) -> tuple[Remark, ...]:
    """Remarks on blood that was given beside a scan, as a study's own blood gets them when it is read."""
    return (*blood.remarks, *against_image_unit(blood, image_unit), *complete(blood), *require_cover(blood, frames))


@dataclass(frozen=True)
class Reading:
    """How blood is read: see `FitRequest`."""

    parent_fraction: str = "auto"
    plasma_from: str = "plasma"
    dispersion_s: float | None = None


def arterial_input(source: Source, request: FitRequest | Reading) -> InputFunction:
    """The input function of a scan, as sampled (no delay), kBq/mL over min.

    Raises:
        InputError: no blood, blood too short, or columns missing.
    """
    blood = source.blood
    if blood is None:
        raise InputError(
            f"{source.label}: there is no blood (_blood.tsv); these models need an arterial input: give --blood."
        )
    require_cover(blood, source.frames)
    manual, *others = (table.dropna(axis="columns", how="all") for table in blood.tables)
    automatic = others[0] if others else None
    end = float(source.frames.end[-1])
    if request.parent_fraction != "none" and FRACTION in manual and not np.nanmax(manual[FRACTION]) > 0:
        raise InputError(
            f"{blood.where}: {FRACTION} is 0 in every row, so no tracer would reach the tissue; correct it, or take "
            "plasma as unmetabolised with --parent-fraction none."
        )
    if automatic is None and _is_ready(manual):
        return _from_curve(manual, end, where=blood.where)
    return from_blood(
        manual,
        automatic,
        parent_fraction=request.parent_fraction,
        plasma_from=request.plasma_from,
        dispersion=_dispersion(blood, request, automatic is not None),
        scan_end=end,
        required_until=float(source.frames.start[-1]),
        where=blood.where,
    )


def _is_ready(table: pd.DataFrame) -> bool:
    """Whether a table is a finished input function: a dense AIF without a hole, read as straight lines."""
    if "AIF" not in table:
        return False
    columns = [c for c in ("AIF", "whole_blood_radioactivity") if c in table]
    return len(table) > _DENSE and bool(np.isfinite(table[columns].to_numpy(np.float64)).all())


def _from_curve(table: pd.DataFrame, scan_end: float, *, where: str) -> InputFunction:
    whole, total = (table.get(name) for name in ("whole_blood_radioactivity", "plasma_radioactivity"))
    found = from_table(
        table["time"].to_numpy(),
        table["AIF"].to_numpy(),
        None if whole is None else whole.to_numpy(),
        total_plasma=None if total is None or total.isna().any() else total.to_numpy(),
        where=where,
    )
    if found.end >= scan_end:
        return found
    held = f"The curve ends at {found.end:.2f} min, the scan at {scan_end:.2f} min; its last value is held until then."
    return replace(found, remarks=(*found.remarks, held))


def _dispersion(blood: BloodRecord, request: FitRequest | Reading, sampled: bool) -> float | None:
    """Time constant to correct an autosampler for, min: as asked, else as stated by files that are not corrected."""
    if request.dispersion_s is not None:
        return units.minutes(request.dispersion_s) or None
    return blood.dispersion_constant if sampled and not blood.dispersion_corrected else None


def sampled_input(arterial: InputFunction, frames: FrameSchedule) -> pd.DataFrame:
    """The input function on the grid that is written: 1 s for the first 10 min, 10 s later, and the end of the scan."""
    end = float(frames.end[-1])
    early = np.arange(0.0, min(10.0, end), 1.0 / 60.0)
    late = np.arange(10.0, end - 1e-9, 10.0 / 60.0)
    return input_table(arterial, np.concatenate([early, late, [end]]))
