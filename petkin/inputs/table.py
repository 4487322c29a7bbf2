"""Ready input functions: in from a table, out to a table."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from petkin.dynamics import Forcing, PiecewiseLinear
from petkin.errors import InputError
from petkin.inputs.blood_table import AIF, PARENT_FRACTION, PLASMA, TIME, WHOLE_BLOOD, checked
from petkin.inputs.input_function import InputFunction
from petkin.inputs.linearise import needed_knots


def from_table(
    time: ArrayLike,
    plasma: ArrayLike,
    whole_blood: ArrayLike | None = None,
    *,
    total_plasma: ArrayLike | None = None,
    tolerance: float = 0.0,
    where: str = "input function",
) -> InputFunction:
    """An input function that is given ready, read as straight lines between its rows.

    Args:
        time: min, ascending from 0 on, (rows,).
        plasma: C_P, metabolite-corrected, kBq/mL, (rows,).
        whole_blood: C_B, kBq/mL, (rows,); C_P where it is not given, which a remark says.
        total_plasma: plasma with its metabolites, kBq/mL, (rows,), if known.
        tolerance: rows go that the straight lines between the others pass within this share of the peak; 0 is read as
            1e-12, so that only rows in line with their neighbours go.
        where: file, for messages.

    Returns:
        The input function; its end is the last time.

    Raises:
        InputError: times or values that `blood_table.checked` refuses, a missing value, or lengths that differ.
    """
    columns = {TIME: time, AIF: plasma, WHOLE_BLOOD: whole_blood, PLASMA: total_plasma}
    given = {name: np.asarray(values, dtype=float) for name, values in columns.items() if values is not None}
    rows = given[TIME].shape
    for name, values in given.items():
        if values.shape != rows or values.ndim != 1:
            raise InputError(f"{where}: column '{name}' has shape {values.shape}, the times {rows}; they must agree.")
    samples = pd.DataFrame(given)
    measured = checked(samples, where=where)
    for name, column in measured.items():
        if column.size != rows[0]:
            raise InputError(
                f"{where}: {rows[0] - column.size} values of column '{name}' are missing; fill or drop them."
            )

    def forcing(name: str) -> PiecewiseLinear:
        keep = needed_knots(given[TIME], given[name], tolerance=max(tolerance, 1e-12))
        return PiecewiseLinear(given[TIME][keep], given[name][keep])

    remark = "Whole blood was not given and is taken equal to the plasma curve."
    return InputFunction(
        plasma=forcing(AIF),
        whole_blood=forcing(WHOLE_BLOOD if whole_blood is not None else AIF),
        end=float(given[TIME][-1]),
        samples=samples,
        remarks=() if whole_blood is not None else (remark,),
        total_plasma=forcing(PLASMA) if total_plasma is not None else None,
    )


def input_table(input_function: InputFunction, times: ArrayLike) -> pd.DataFrame:
    """The input function at chosen times, with the columns of an inputfunction file (BEP023 draft).

    Args:
        input_function: one curve, no batch.
        times: min, (rows,).

    Returns:
        time (min), whole_blood_radioactivity, plasma_radioactivity (total), metabolite_parent_fraction, AIF (kBq/mL);
        nan where the total plasma or the fraction is not known.
    """
    t = np.array(times, dtype=float)  # a copy: torch takes no read-only array, which pandas may hand over
    aif = _at(input_function.plasma, t)
    total = np.full_like(t, np.nan) if input_function.total_plasma is None else _at(input_function.total_plasma, t)
    if input_function.parent_fraction is None:
        fraction = np.divide(aif, total, out=np.full_like(t, np.nan), where=total > 0)
    else:
        start = float(input_function.parent_fraction.knots[0])  # before it the fraction is that at the start
        fraction = _at(input_function.parent_fraction, np.maximum(t, start))
    columns = {
        TIME: t,
        WHOLE_BLOOD: _at(input_function.whole_blood, t),
        PLASMA: total,
        PARENT_FRACTION: fraction,
        AIF: aif,
    }
    return pd.DataFrame(columns)


def _at(forcing: Forcing, t: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(forcing(t))
