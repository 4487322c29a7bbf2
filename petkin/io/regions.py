"""Regional time-activity curves: `_tacs.tsv` with its JSON, and region volumes from `_morph.tsv`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petkin import units
from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.io.atomic import write_text
from petkin.io.checks import refuse_minutes
from petkin.io.jsonfile import json_text, merge_json
from petkin.io.names import FileName, sidecar_path
from petkin.io.remarks import Remark, note, warning
from petkin.io.schedule import frame_columns
from petkin.io.sidecar import PetSidecar
from petkin.io.tables import numbers, read_table, require_columns, write_table
from petkin.units import SECONDS_PER_MINUTE

#: Columns of a tacs table that are no region.
_NOT_REGIONS = {"weight", "weights", "frame_mid", "FrameTimesStart", "FrameTimesEnd", "frame_duration", "FrameDuration"}


@dataclass(frozen=True)
class RegionalCurves:
    """Curves of R regions over K frames.

    Args:
        names: region names, (R,).
        values: frame means, kBq/mL, (R, K); decay-corrected to time zero.
        frames: their frames.
        seg: label of the segmentation, "" where the file names none.
        desc: its desc label, "" for none.
        volumes: region volumes, mm3, (R,), NaN where unknown; None where there is no table of them.
        where: file name.
        remarks: what was odd or converted.
        units: unit that the file states.
        index: labels of the regions in their segmentation, (R,); None where curves came as a table.
        pvc: label of the correction for partial volume that they have had, "" for none.
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    frames: FrameSchedule
    seg: str = ""
    desc: str = ""
    volumes: NDArray[np.float64] | None = None
    where: str = "the curves"
    remarks: tuple[Remark, ...] = ()
    units: str = "kBq/mL"
    index: tuple[int, ...] | None = None
    pvc: str = ""

    def __post_init__(self) -> None:
        if self.values.shape != (len(self.names), len(self.frames)):
            raise InputError(
                f"{self.where}: {len(self.names)} regions and {len(self.frames)} frames need a table of that shape, "
                f"not {self.values.shape}."
            )


def read_tacs(
    path: Path,
    *,
    sidecars: Sequence[Path] | None = None,
    default_unit: str | None = None,
    image: PetSidecar | None = None,
) -> tuple[RegionalCurves, dict[str, Any]]:
    """Curves of a tacs table in kBq/mL decay-corrected to time zero, and the fields of its JSON.

    A table is corrected for decay as its own JSON says, else as the image it was drawn from, else already.

    Args:
        path: columns frame_start and frame_end (s), then one a region.
        sidecars: JSON files that apply to it, top first; None looks for one of the same name beside it.
        default_unit: unit where neither a JSON nor `image` states one.
        image: `_pet.json` of the image that the curves were drawn from.

    Raises:
        InputError: no frame columns, no region, no unit, an empty or overlapping frame, times in minutes, a cell that
            is not a number, or curves that are not corrected for decay without `image` to tell the radionuclide.
    """
    where, beside = path.name, path.with_suffix(".json")
    fields = merge_json(sidecars if sidecars is not None else [beside] if beside.is_file() else [])
    table, dropped = _without_zero_rows(read_table(path), where)
    start_s, end_s, used = frame_columns(table, where=where)
    frames = FrameSchedule.from_seconds(start_s, end_s - start_s, where=where)
    names = [str(name) for name in table.columns if name not in used and str(name) not in _NOT_REGIONS]
    if not names:
        raise InputError(f"{where}: no region beside the frame columns; add one column a region.")
    unit, assumed = _unit(fields, image.units if image else default_unit, where)
    factor = units.kbq_per_ml_factor(unit, where=f"{where}: Units")
    values = np.stack([numbers(table, name, where=where) for name in names]) * factor
    remarks = [*dropped, *assumed, *_odd_values(names, values, where)]
    if image is None:
        _require_corrected(fields, where)
    else:
        refuse_minutes(frames, image.nuclide, fields="frame_start and frame_end")
        values = values * _decay_state(image, fields, where).to_time_zero(frames)
        remarks += _other_frames(frames, image, where)
    entities = FileName.parse(path).entities
    curves = RegionalCurves(
        tuple(names),
        values,
        frames,
        entities.get("seg", ""),
        entities.get("desc", ""),
        None,
        where,
        tuple(remarks),
        unit,
        pvc=entities.get("pvc", ""),
    )
    return curves, fields


def _decay(fields: Mapping[str, Any], where: str) -> tuple[bool, float]:
    corrected, time = fields.get("ImageDecayCorrected", True), fields.get("ImageDecayCorrectionTime", 0)
    if not isinstance(corrected, bool) or not isinstance(time, int | float):
        raise InputError(f"{where}: ImageDecayCorrected must be true or false, ImageDecayCorrectionTime a number of s.")
    return corrected, float(time)


def _require_corrected(fields: Mapping[str, Any], where: str) -> None:
    if _decay(fields, where) != (True, 0.0):
        raise InputError(
            f"{where}: its JSON says that it is not decay-corrected to time zero; place it in a PET-BIDS study, whose "
            "_pet.json names the radionuclide."
        )


def _decay_state(image: PetSidecar, fields: Mapping[str, Any], where: str) -> PetSidecar:
    if "ImageDecayCorrected" not in fields:
        return image
    corrected, time = _decay(fields, where)
    return image.model_copy(update={"image_decay_corrected": corrected, "image_decay_correction_time": time})


def _other_frames(frames: FrameSchedule, image: PetSidecar, where: str) -> list[Remark]:
    theirs = image.frames
    if len(frames) == len(theirs):
        edges = np.stack([frames.start - theirs.start, frames.end - theirs.end])
        off_s = float(np.abs(edges).max()) * SECONDS_PER_MINUTE
        if off_s <= 0.5:
            return []
        text = f"Its frame times differ by up to {off_s:.3g} s from those of {image.where}; the table's are used."
    else:
        text = f"It has {len(frames)} frames but {image.where} has {len(theirs)}; the table's are used."
    return [warning("frames-differ", where, text)]


def _without_zero_rows(table: pd.DataFrame, where: str) -> tuple[pd.DataFrame, list[Remark]]:
    """Leading rows of no duration and no activity are a program's way to say that curves start at zero."""
    start_s, end_s, used = frame_columns(table, where=where)
    activity = table.drop(columns=list(used)).apply(pd.to_numeric, errors="coerce").fillna(0.0).to_numpy(np.float64)
    empty = (end_s <= start_s) & (activity == 0).all(axis=1)
    leading = int(np.argmin(empty)) if not empty.all() else len(empty)
    if leading == 0:
        return table, []
    text = f"{leading} leading row(s) of no duration hold only zeros; they are no frames and were left out."
    return table.iloc[leading:].reset_index(drop=True), [warning("zero-row", where, text)]


def _unit(fields: Mapping[str, Any], default: str | None, where: str) -> tuple[str, list[Remark]]:
    stated = fields.get("Units")
    if stated:
        return str(stated), []
    if default is None:
        raise InputError(f'{where}: no JSON beside it states Units; add one, e.g. {{"Units": "kBq/mL"}}.')
    text = f"No JSON states Units; taken to be {default} as the raw image."
    return default, [warning("tacs-unit", where, text)]


def _odd_values(names: Sequence[str], values: NDArray[np.float64], where: str) -> list[Remark]:
    remarks = []
    missing = np.flatnonzero(np.isnan(values).any(axis=1))
    flat = np.flatnonzero((np.nan_to_num(values) == 0).all(axis=1))
    if missing.size:
        text = f"{_count(missing, names)} lack values in some frames and get no estimate."
        remarks.append(warning("region-missing", where, text))
    if flat.size:
        text = f"{_count(flat, names)} hold no activity and get no estimate."
        remarks.append(warning("region-empty", where, text))
    negative = int(np.count_nonzero(values < 0))
    if negative:
        text = f"{negative} of {values.size} frame values are negative; they are fitted as they are."
        remarks.append(note("region-negative", where, text))
    return remarks


def _count(which: NDArray[np.intp], names: Sequence[str]) -> str:
    return f"{which.size} of {len(names)} regions ({names[which[0]]}{', ...' if which.size > 1 else ''})"


def write_tacs(path: Path, curves: RegionalCurves, sidecar: Mapping[str, Any]) -> None:
    """Write curves as a table (frame_start, frame_end in s, then regions in kBq/mL) and its JSON.

    Raises:
        InputError: the folder cannot be written.
    """
    edges = {"frame_start": curves.frames.start, "frame_end": curves.frames.end}
    columns = {name: edge * SECONDS_PER_MINUTE for name, edge in edges.items()}
    table = pd.DataFrame({**columns, **dict(zip(curves.names, curves.values, strict=True))})
    write_table(path, table)
    write_text(path.with_name(sidecar_path(PurePosixPath(path.name)).name), json_text(sidecar))


def read_volumes(path: Path, names: Sequence[str]) -> NDArray[np.float64]:
    """Region volumes (mm3) of a morph table in the order of `names`, NaN where the table has none.

    Raises:
        InputError: no columns name and volume-mm3.
    """
    table = read_table(path)
    require_columns(table, ["name", "volume-mm3"], where=path.name)
    by_name = dict(zip(map(str, table["name"]), numbers(table, "volume-mm3", where=path.name), strict=True))
    return np.array([by_name.get(name, np.nan) for name in names], np.float64)
