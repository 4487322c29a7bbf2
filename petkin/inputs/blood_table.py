"""A blood table as the laboratory leaves it, checked before anything is computed from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petkin.errors import InputError

#: Columns by their BIDS names; here time is in min and activity in kBq/mL.
TIME = "time"
WHOLE_BLOOD = "whole_blood_radioactivity"
PLASMA = "plasma_radioactivity"
PARENT_FRACTION = "metabolite_parent_fraction"
AIF = "AIF"

MEASURED = (WHOLE_BLOOD, PLASMA, PARENT_FRACTION, AIF)


@dataclass(frozen=True)
class Samples:
    """One measured quantity: values at ascending times (min), missing ones left out."""

    times: NDArray[np.float64]
    values: NDArray[np.float64]

    @property
    def size(self) -> int:
        return self.times.size


def checked(table: pd.DataFrame, *, where: str) -> dict[str, Samples]:
    """The measured columns of a blood table, each without its missing values.

    Args:
        table: columns by BIDS name; time in min, activity in kBq/mL; NaN = missing. Other columns are ignored.
        where: file or table, for messages.

    Returns:
        Samples by column name, for the measured columns that the table has.

    Raises:
        InputError: no time column, text among the numbers, infinite values, a time that is missing, negative, double or
            descending, a column without a value, an activity with one value or none above 0, a parent fraction outside
            0 to 1.
    """
    if TIME not in table:
        raise InputError(f"{where}: the blood table has no column 'time', only {', '.join(map(str, table.columns))}.")
    times = _numbers(table, TIME, where)
    _check_times(times, where)
    measured = {}
    for name in [name for name in MEASURED if name in table]:
        values = _numbers(table, name, where)
        present = ~np.isnan(values)
        if not present.any():
            raise InputError(f"{where}: column '{name}' has no value at all; fill it or remove the column.")
        measured[name] = Samples(times[present], values[present])
        if name != PARENT_FRACTION:
            _check_activity(name, measured[name], where)
    if PARENT_FRACTION in measured:
        _check_fraction(measured[PARENT_FRACTION], where)
    return measured


def _numbers(table: pd.DataFrame, name: str, where: str) -> NDArray[np.float64]:
    numbers = np.asarray(pd.to_numeric(table[name], errors="coerce"), dtype=float)
    text = np.isnan(numbers) & np.asarray(table[name].notna())
    if text.any():
        row = int(text.argmax())
        raise InputError(
            f"{where}: column '{name}' holds {table[name].iloc[row]!r} in data row {row + 1}; write a number, or n/a."
        )
    if np.isinf(numbers).any():
        raise InputError(f"{where}: column '{name}' is infinite in data row {int(np.isinf(numbers).argmax()) + 1}.")
    return numbers


def _check_times(times: NDArray[np.float64], where: str) -> None:
    if times.size == 0:
        raise InputError(f"{where}: the blood table has no rows.")
    if np.isnan(times).any():
        raise InputError(f"{where}: the time of data row {int(np.isnan(times).argmax()) + 1} is missing.")
    if times.min() < 0:
        early = f"{where}: a sample lies at {times.min():g} min, before injection"
        raise InputError(f"{early}; drop it, or let the times count from injection.")
    steps = np.diff(times)
    if (steps <= 0).any():
        row = int((steps <= 0).argmax())
        what = "appears twice" if steps[row] == 0 else f"is followed by {times[row + 1]:g} min"
        raise InputError(
            f"{where}: time {times[row]:g} min (data row {row + 1}) {what}; times must ascend: sort or merge rows."
        )


def _check_activity(name: str, samples: Samples, where: str) -> None:
    if samples.size < 2:
        raise InputError(f"{where}: column '{name}' has one value only; a curve needs two samples at least.")
    if samples.values.max() <= 0:
        raise InputError(f"{where}: column '{name}' is nowhere positive; check what it holds.")


def _check_fraction(fraction: Samples, where: str) -> None:
    worst = int(np.abs(fraction.values - 0.5).argmax())
    value, time = fraction.values[worst], fraction.times[worst]
    found = f"{where}: {PARENT_FRACTION} is {value:g} at {time:g} min"
    if value > 1.5:
        raise InputError(f"{found}, so it seems to be in percent; divide by 100.")
    if not 0.0 <= value <= 1.0:
        raise InputError(f"{found}; a fraction lies between 0 and 1: correct it.")
