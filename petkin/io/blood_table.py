"""One blood table: `_recording-<label>_blood.tsv` with its JSON, or a plain TSV of the same columns."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petkin import units
from petkin.errors import InputError
from petkin.io.jsonfile import merge_json
from petkin.io.remarks import Remark, note, warning
from petkin.io.tables import numbers, read_table, require_columns
from petkin.units import SECONDS_PER_MINUTE

ACTIVITIES = ("whole_blood_radioactivity", "plasma_radioactivity", "AIF")
FRACTION = "metabolite_parent_fraction"
_SECOND = 1 / SECONDS_PER_MINUTE
#: Spellings of time units, as factors to minutes.
TIME_UNITS = {"s": _SECOND, "sec": _SECOND, "seconds": _SECOND, "min": 1.0, "minutes": 1.0}
_PERCENT = {"%", "percent"}
#: Column and unit in one name: "time (min)", "plasma_radioactivity [Bq/mL]".
_NAMED_UNIT = re.compile(r"(\w+)\s*[\[(]([^\])]+)[\])]")
_FLAGS = {
    "MetaboliteAvail": FRACTION,
    "PlasmaAvail": "plasma_radioactivity",
    "WholeBloodAvail": "whole_blood_radioactivity",
}

_Columns = dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class BloodTable:
    """One recording in petkin's units.

    Args:
        samples: columns time (min, ascending) and those of whole_blood_radioactivity, plasma_radioactivity, AIF
            (kBq/mL), metabolite_parent_fraction (0 to 1) that the file has; missing values NaN.
        units: unit that the file states for each activity column.
        fields: the JSON beside it, empty where there is none.
        where: file name.
        remarks: what was odd or converted.
    """

    samples: pd.DataFrame
    units: dict[str, str]
    fields: dict[str, Any]
    where: str
    remarks: tuple[Remark, ...] = ()


def read_blood_table(
    path: Path, *, sidecars: Sequence[Path] | None = None, given: Mapping[str, str] | None = None
) -> BloodTable:
    """One blood table.

    The unit of a column is, in this order: `given`; in its name ("time (min)", "AIF [Bq/mL]"); its Units in the JSON.
    Where there is no JSON at all, times are seconds and activities kBq/mL, with a remark.

    Args:
        path: the TSV; columns time and at least one activity or the parent fraction, others are left out.
        sidecars: JSON files that apply to it, top first; None looks for one of the same name beside it.
        given: units by column, e.g. {"time": "min", "plasma_radioactivity": "Bq/mL"}.

    Raises:
        InputError: no such column, a missing or unknown unit, a missing time, a parent fraction outside 0 to 1.
    """
    beside = path.with_suffix(".json")
    files = list(sidecars) if sidecars is not None else [beside] if beside.is_file() else []
    fields, where = merge_json(files), path.name
    table, named = _bare_names(read_table(path), where)
    require_columns(table, ["time"], where=where)
    kept = [column for column in (*ACTIVITIES, FRACTION) if column in table.columns]
    if not kept:
        raise InputError(f"{where}: none of the columns {', '.join((*ACTIVITIES, FRACTION))}; a blood table needs one.")
    stated = _stated_units(kept, fields, {**named, **(given or {})}, files[-1].name if files else None, where)
    columns = {
        column: numbers(table, column, where=where) * _factor(column, stated, where) for column in ("time", *kept)
    }
    _check_fraction(columns, where)
    columns, dropped = _unavailable(columns, fields, where)
    columns, ordered = _ascending(columns, where)
    assumed = [] if files or named or given else [_assumed_units(where)]
    activity_units = {column: stated[column] for column in columns if column in ACTIVITIES}
    remarks = (*assumed, *dropped, *ordered, *_negative(columns, where))
    return BloodTable(pd.DataFrame(columns), activity_units, fields, where, remarks)


def _bare_names(table: pd.DataFrame, where: str) -> tuple[pd.DataFrame, dict[str, str]]:
    """Units taken out of the column names."""
    found = {str(name): match for name in table.columns if (match := _NAMED_UNIT.fullmatch(str(name)))}
    bare = [found[name].group(1) if name in found else name for name in map(str, table.columns)]
    repeated = [name for name in bare if bare.count(name) > 1]
    if repeated:
        raise InputError(f"{where}: column {repeated[0]!r} is there in two units; keep one.")
    table.columns = bare
    return table, {match.group(1): match.group(2) for match in found.values()}


def _stated_units(
    columns: Sequence[str], fields: Mapping[str, Any], given: Mapping[str, str], sidecar: str | None, where: str
) -> dict[str, str]:
    """Unit of each column; where a JSON exists, only time (s) and parent fraction (unitless) have one by default."""
    default = {"time": "s", FRACTION: "unitless"}
    if sidecar is None:
        default |= dict.fromkeys(ACTIVITIES, "kBq/mL")
    stated: dict[str, str] = {}
    for column in ("time", *columns):
        described = fields.get(column)
        written = described.get("Units") if isinstance(described, Mapping) else None
        unit = given.get(column) or written or default.get(column)
        if unit is None:
            raise InputError(f"{sidecar}: {column}.Units is missing; state the unit of that column, e.g. kBq/mL.")
        stated[column] = str(unit).strip()
    if stated["time"] not in TIME_UNITS:
        raise InputError(f"{where}: Units of time is {stated['time']!r}; use s or min.")
    return stated


def _factor(column: str, stated: Mapping[str, str], where: str) -> float:
    unit = stated[column]
    if column == "time":
        return TIME_UNITS[unit]
    if column == FRACTION:
        return 0.01 if unit.lower() in _PERCENT else 1.0
    return units.kbq_per_ml_factor(unit, where=f"{where}: Units of {column}")


def _assumed_units(where: str) -> Remark:
    text = "No JSON and no unit given; times are taken as seconds, activities as kBq/mL."
    return warning("blood-units-assumed", where, text)


def _check_fraction(columns: _Columns, where: str) -> None:
    fraction = columns.get(FRACTION, np.empty(0))
    wrong = np.flatnonzero((fraction < 0) | (fraction > 1.05))
    if wrong.size:
        raise InputError(
            f"{where}: {FRACTION} is {fraction[wrong[0]]:g} in row {wrong[0] + 1}; it is a fraction between 0 and 1 "
            "(state Units percent if it is in percent)."
        )


def _unavailable(columns: _Columns, fields: Mapping[str, Any], where: str) -> tuple[_Columns, list[Remark]]:
    """Columns that the JSON calls not available are left out: their values are placeholders."""
    kept, remarks = dict(columns), []
    for flag, column in _FLAGS.items():
        present = column in kept and bool(np.isfinite(kept[column]).any())
        if fields.get(flag) is False and column in kept:
            del kept[column]
            if present:
                remarks.append(warning("blood-flag", where, f"{flag} is false; the values of {column} are not used."))
        elif fields.get(flag) is True and not present:
            remarks.append(warning("blood-flag", where, f"{flag} is true but there are no values of {column}."))
    return kept, remarks


def _ascending(columns: _Columns, where: str) -> tuple[_Columns, list[Remark]]:
    """Rows by time; rows of the same time joined, a missing value giving way to a measured one."""
    time = columns["time"]
    if np.isnan(time).any():
        row = int(np.flatnonzero(np.isnan(time))[0])
        raise InputError(f"{where}: time is missing in row {row + 1}; every sample needs one.")
    remarks = []
    if (np.diff(time) < 0).any():
        remarks.append(warning("blood-order", where, "Rows are not in order of time; they were sorted."))
    distinct, row_of = np.unique(time, return_inverse=True)
    if distinct.size == time.size:
        order = np.argsort(time)
        return {column: values[order] for column, values in columns.items()}, remarks
    text = f"{time.size - distinct.size} rows repeat a time; their values were averaged."
    remarks.append(warning("blood-repeated", where, text))
    joined = {column: _mean_by(values, row_of, distinct.size) for column, values in columns.items()}
    return {**joined, "time": distinct}, remarks


def _mean_by(values: NDArray[np.float64], row_of: NDArray[np.intp], rows: int) -> NDArray[np.float64]:
    measured = np.isfinite(values)
    counts = np.bincount(row_of[measured], minlength=rows)
    sums = np.bincount(row_of[measured], weights=values[measured], minlength=rows)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def _negative(columns: _Columns, where: str) -> list[Remark]:
    remarks = []
    for column in ACTIVITIES:
        count = int(np.count_nonzero(columns.get(column, np.empty(0)) < 0))
        if count:
            text = f"{count} of {columns[column].size} values of {column} are negative; they are kept as they are."
            remarks.append(note("blood-negative", where, text))
    return remarks
