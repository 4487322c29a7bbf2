"""Tab-separated tables, read within bounds and written byte for byte alike."""

from __future__ import annotations

import csv
import io
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.io.atomic import write_text

#: A day of blood at 10 Hz, or a thousand regions in a thousand frames, stays far below.
_LARGEST = 256 * 2**20
_MISSING = ["n/a", "N/A", "NaN", "nan", "NA", ""]


def read_table(path: Path) -> pd.DataFrame:
    """A TSV with a header row; n/a and empty cells are missing.

    Raises:
        InputError: absent, unreadable, too large, not text, empty, a repeated column, or rows of unequal length.
    """
    text = _text(path)
    header = next(csv.reader(io.StringIO(text), delimiter="\t"), [])
    if not any(name.strip() for name in header):
        raise InputError(f"{path}: is empty; a table needs a header row.")
    repeated = sorted({name for name in header if header.count(name) > 1})
    if repeated:
        raise InputError(f"{path}: column {repeated[0]!r} appears {header.count(repeated[0])} times; keep one.")
    try:
        with warnings.catch_warnings():
            # a row longer than the header would only be warned of, and cut
            warnings.simplefilter("error", pd.errors.ParserWarning)
            table = pd.read_csv(io.StringIO(text), sep="\t", na_values=_MISSING, keep_default_na=False, index_col=False)
    except (pd.errors.ParserError, pd.errors.ParserWarning, ValueError) as error:
        raise InputError(f"{path}: not a tab-separated table ({str(error).splitlines()[0]}).") from error
    table.columns = [str(name).strip() for name in table.columns]
    return table


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > _LARGEST:
            raise InputError(f"{path}: {path.stat().st_size} bytes is too large for a table; is it the right file?")
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text; is it a table?") from error


def require_columns(table: pd.DataFrame, columns: Sequence[str], *, where: str) -> None:
    """Raises:
    InputError: a column is missing.
    """
    missing = [name for name in columns if name not in table.columns]
    if missing:
        found = ", ".join(map(str, table.columns[:8]))
        hint = "; the table has commas where tabs are due" if len(table.columns) == 1 and "," in found else ""
        raise InputError(f"{where}: no column {missing[0]!r} (found: {found}){hint}.")


def numbers(table: pd.DataFrame, column: str, *, where: str) -> NDArray[np.float64]:
    """A column as floats, missing cells NaN.

    Raises:
        InputError: a cell is not a number, or infinite.
    """
    values = np.array(pd.to_numeric(table[column], errors="coerce"), np.float64)
    wrong = np.flatnonzero((np.isnan(values) & table[column].notna().to_numpy()) | np.isinf(values))
    if wrong.size:
        row = int(wrong[0])
        cell = str(table[column].iloc[row])
        raise InputError(
            f"{where}: column {column!r}, row {row + 1} holds {cell!r}; use a number, or n/a where there is none."
        )
    return values


def write_table(path: Path, table: pd.DataFrame) -> None:
    """Write a TSV whole or not at all: ten significant digits, n/a for missing, line feeds, columns in their order."""
    finite = table.replace([np.inf, -np.inf], np.nan)
    text = finite.to_csv(None, sep="\t", index=False, na_rep="n/a", float_format="%.10g", lineterminator="\n")
    write_text(path, text)
