"""All blood of a scan: manual and autosampler recordings as one record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from petkin.errors import InputError
from petkin.io.blood_table import ACTIVITIES, TIME_UNITS, BloodTable, read_blood_table
from petkin.io.remarks import Remark, warning
from petkin.units import SECONDS_PER_MINUTE

_MANUAL, _AUTOMATIC = {"manual", "discrete"}, {"autosampler", "automatic", "auto", "continuous"}
#: Samples closer than this (min) come from a machine.
_AUTOMATIC_INTERVAL = 10 / SECONDS_PER_MINUTE


@dataclass(frozen=True)
class BloodRecord:
    """All blood of a scan in minutes and kBq/mL, decay-corrected to time zero.

    Args:
        manual: manual samples, columns as in `BloodTable.samples`; None where there are none.
        automatic: autosampler samples, mostly whole blood alone; None where there are none.
        dispersion_corrected: whether the files say that dispersion in the lines was taken out.
        dispersion_constant: time constant of that dispersion, min; None where it is not stated.
        metabolites_measured: whether the files say that metabolites were measured and their recovery corrected for.
        where: file names.
        remarks: what was odd or converted.
        units: activity units that the files state, for remarks that compare them with the image's.
    """

    manual: pd.DataFrame | None
    automatic: pd.DataFrame | None
    dispersion_corrected: bool
    dispersion_constant: float | None
    where: str
    remarks: tuple[Remark, ...] = ()
    units: tuple[str, ...] = ()
    metabolites_measured: bool = False

    @property
    def tables(self) -> tuple[pd.DataFrame, ...]:
        """The recordings there are."""
        return tuple(table for table in (self.manual, self.automatic) if table is not None)

    @property
    def count(self) -> int:
        """Rows of all recordings."""
        return sum(len(table) for table in self.tables)

    @property
    def end(self) -> float:
        """Last time (min) of an AIF or plasma sample, else of whole blood; NaN where nothing was measured."""
        for columns in (("AIF", "plasma_radioactivity"), ("whole_blood_radioactivity",)):
            times = [
                table["time"].to_numpy()[values.size - 1 - np.argmax(np.isfinite(values[::-1]))]
                for table, values in self._measured(columns)
            ]
            if times:
                return float(max(times))
        return float("nan")

    @property
    def peak(self) -> float:
        """Highest activity of any column, kBq/mL; NaN where there is none."""
        return max((float(np.nanmax(values)) for _, values in self._measured(ACTIVITIES)), default=float("nan"))

    def _measured(self, columns: tuple[str, ...]) -> list[tuple[pd.DataFrame, np.ndarray]]:
        found = [
            (table, table[column].to_numpy(np.float64))
            for table in self.tables
            for column in columns
            if column in table
        ]
        return [(table, values) for table, values in found if np.isfinite(values).any()]


def read_blood(path: Path, *, given: Mapping[str, str] | None = None) -> BloodRecord:
    """A single blood table as a record; `given` states units by column (see `read_blood_table`).

    Raises:
        InputError: the table cannot be used.
    """
    return join_recordings({"": read_blood_table(path, given=given)})


def join_recordings(recordings: Mapping[str, BloodTable], *, dispersion_constant_s: float | None = None) -> BloodRecord:
    """Recordings of one scan by their label (manual, autosampler, ...) as one record.

    Args:
        recordings: tables by recording label; other labels are told apart by how densely they are sampled.
        dispersion_constant_s: what `_pet.json` says, used where the blood's JSON does not.

    Raises:
        InputError: no recording, or two of the same kind.
    """
    by_kind: dict[str, BloodTable] = {}
    for recording, table in recordings.items():
        kind = _kind(recording, table)
        if kind in by_kind:
            raise InputError(f"{table.where}: a second {kind} recording beside {by_kind[kind].where}; keep one.")
        by_kind[kind] = table
    if not by_kind:
        raise InputError("A blood record needs at least one table.")
    manual, automatic = by_kind.get("manual"), by_kind.get("automatic")
    leading = automatic or by_kind["manual"]
    corrected = leading.fields.get("DispersionCorrected") is True
    constant = _dispersion_constant(leading, dispersion_constant_s)
    dispersed = (_dispersed(automatic, constant),) if automatic is not None and not corrected else ()
    return BloodRecord(
        manual=manual.samples if manual else None,
        automatic=automatic.samples if automatic else None,
        dispersion_corrected=corrected,
        dispersion_constant=constant,
        where=", ".join(table.where for table in by_kind.values()),
        remarks=(*(remark for table in by_kind.values() for remark in table.remarks), *dispersed),
        units=tuple(sorted({unit for table in by_kind.values() for unit in table.units.values()})),
        metabolites_measured=any(_measured_metabolites(table.fields) for table in by_kind.values()),
    )


def _measured_metabolites(fields: Mapping[str, Any]) -> bool:
    method, corrected = fields.get("MetaboliteMethod"), fields.get("MetaboliteRecoveryCorrectionApplied")
    return fields.get("MetaboliteAvail") is True and bool(method) and corrected is True


def _kind(recording: str, table: BloodTable) -> str:
    if recording.lower() in _MANUAL | _AUTOMATIC:
        return "manual" if recording.lower() in _MANUAL else "automatic"
    steps = np.diff(table.samples["time"].to_numpy())
    fast = steps.size > 0 and float(np.median(steps)) < _AUTOMATIC_INTERVAL
    return "automatic" if fast and not {"plasma_radioactivity", "AIF"} & set(table.samples.columns) else "manual"


def _dispersion_constant(table: BloodTable, otherwise_s: float | None) -> float | None:
    """Minutes, from DispersionConstant (s unless DispersionConstantUnits says min)."""
    stated = table.fields.get("DispersionConstant", otherwise_s)
    if not isinstance(stated, int | float) or isinstance(stated, bool) or not np.isfinite(stated) or stated < 0:
        return None
    unit = str(table.fields.get("DispersionConstantUnits", "s")) if "DispersionConstant" in table.fields else "s"
    if unit not in TIME_UNITS:
        raise InputError(f"{table.where}: DispersionConstantUnits is {unit!r}; use s or min.")
    return stated * TIME_UNITS[unit]


def _dispersed(table: BloodTable, constant: float | None) -> Remark:
    stated = "not stated" if constant is None else f"{constant * SECONDS_PER_MINUTE:.3g} s"
    text = f"The autosampler record is not corrected for dispersion in its lines; its time constant is {stated}."
    return warning("blood-dispersion", table.where, text)
