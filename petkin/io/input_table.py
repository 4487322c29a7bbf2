"""Ready input functions: `_inputfunction.tsv` (time, AIF and what it was made of)."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from petkin.errors import InputError
from petkin.io.blood_table import FRACTION, BloodTable, read_blood_table
from petkin.io.tables import write_table
from petkin.units import SECONDS_PER_MINUTE

_COLUMNS = ("time", "whole_blood_radioactivity", "plasma_radioactivity", FRACTION, "AIF")


def read_input_table(path: Path) -> BloodTable:
    """A ready input function; times in s and activities in kBq/mL unless its JSON says otherwise.

    Raises:
        InputError: no column time or AIF, or a unit that is not one.
    """
    table = read_blood_table(path)
    if "AIF" not in table.samples.columns:
        raise InputError(
            f"{path.name}: no column 'AIF'; give the blood table instead if the parent plasma is not ready."
        )
    return table


def write_input_table(path: Path, samples: pd.DataFrame) -> None:
    """Write an input function: time in s, activities in kBq/mL.

    Args:
        path: the TSV.
        samples: time (min) and any of the activity columns and the parent fraction; missing columns are written as n/a.
    """
    columns = {name: samples[name] if name in samples.columns else float("nan") for name in _COLUMNS}
    table = pd.DataFrame(columns, index=samples.index)
    table["time"] = table["time"] * SECONDS_PER_MINUTE
    write_table(path, table)
