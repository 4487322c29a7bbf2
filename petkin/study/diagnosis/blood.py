"""The blood record as a diagnosis reads it: straight lines between samples, nothing corrected, nothing modelled; or,
where that is asked for, as a fit reads it. How far it may err either way, `petkin.study.diagnosis.record` tells.

Each column is interpolated by itself (missing rows are skipped) and then multiplied; activities are zero before time 0
and rise straight to the first sample; the last value is held to the end of the scan. A fit reads blood with more care
(`petkin.inputs.from_blood`), but what a careful reading repairs, a diagnosis must be able to find: unless samples
scatter so much that lines between them are the gap.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from petkin.dynamics import Forcing, PiecewiseLinear
from petkin.errors import InputError
from petkin.inputs import InputFunction
from petkin.io import BloodRecord
from petkin.study.diagnosis.record import between_errors, record_errors, remark
from petkin.study.diagnosis.request import FITTED
from petkin.units import SECONDS_PER_MINUTE

Array = NDArray[np.float64]

_TIME, _PLASMA, _BLOOD = "time", "plasma_radioactivity", "whole_blood_radioactivity"
_FRACTION, _AIF = "metabolite_parent_fraction", "AIF"
#: Lines and smooth curves are compared from this time on (min), and said to differ from this share on.
_SETTLED, _APART = 1.0, 0.03


def recorded_input(blood: BloodRecord, end: float) -> InputFunction:
    """Plasma x parent fraction and whole blood as recorded, to the end of the scan (min).

    With two recordings the automatic one gives whole blood up to its end and the manual one the rest; plasma is whole
    blood times the interpolated plasma-to-blood ratio where it has no samples of its own.

    Raises:
        InputError: no plasma, or none with activity.
    """
    manual = blood.manual if blood.manual is not None else blood.automatic
    automatic = blood.automatic if blood.manual is not None else None
    if manual is None:
        raise InputError(f"{blood.where}: there are no samples; a diagnosis needs the arterial input.")
    whole = _samples(manual, _BLOOD)
    if automatic is not None and (fast := _samples(automatic, _BLOOD)) is not None:
        whole = _joined(fast, whole)
    if (given := _samples(manual, _AIF)) is not None:
        _require_activity(given, _AIF, blood.where)
        curve, between = _lines(*given, end), _table(given, _AIF)
        return InputFunction(
            curve, curve if whole is None else _lines(*whole, end), end=float(given[0][-1]), samples=between
        )
    plasma = _samples(manual, _PLASMA)
    if plasma is None:
        raise InputError(f"{blood.where}: there is no column '{_PLASMA}' nor '{_AIF}'; a diagnosis needs plasma.")
    _require_activity(plasma, _PLASMA, blood.where)
    remarks = _held({"plasma": plasma, "whole blood": whole}, end)
    if automatic is not None and whole is not None:
        plasma = _through_ratio(plasma, whole)
    fraction = _samples(manual, _FRACTION)
    if fraction is not None:
        _require_activity(fraction, _FRACTION, blood.where)
    total, knots = _lines(*plasma, end), [plasma[0], np.array([0.0, end])]
    if fraction is not None:
        knots.append(fraction[0])
    times = np.unique(np.concatenate(knots))
    times = _refined(times[(times >= 0) & (times <= end)], fraction is not None)
    t = torch.from_numpy(times)
    share = None if fraction is None else PiecewiseLinear(t, torch.from_numpy(np.interp(times, *fraction)))
    input_curve = total if share is None else PiecewiseLinear(t, total(t) * share.values)
    if whole is None:
        remarks.append("There is no whole blood; plasma stands for it.")
    return InputFunction(
        input_curve,
        total if whole is None else _lines(*whole, end),
        end=float(plasma[0][-1]),
        samples=_table(plasma, _PLASMA, fraction),
        remarks=tuple(remarks),
        total_plasma=total,
        parent_fraction=share,
    )


def errors_of(arterial: InputFunction, nodes: Array, how: str) -> Array:
    """Errors of C_P (m, T) that a record leaves, read as it is or as a fit does."""
    return record_errors(arterial, nodes) if how == FITTED else between_errors(arterial, nodes)


def allowing(arterial: InputFunction, nodes: Array, errors: Array, how: str) -> InputFunction:
    """The input with a remark on how far it may err, where that is much."""
    if how == FITTED:
        return replace(arterial, remarks=(*arterial.remarks, remark(arterial)))
    apart = np.abs(errors[:, nodes > _SETTLED]).max(initial=0.0)
    if apart <= _APART:
        return arterial
    text = (
        "Blood is read as straight lines between samples; smooth curves through them lie up to "
        f"{apart:.0%} away, which the diagnosis allows for. Where samples scatter, see --read-blood fitted."
    )
    return replace(arterial, remarks=(*arterial.remarks, text))


def _samples(table: pd.DataFrame, column: str) -> tuple[Array, Array] | None:
    """Times and values of a column, missing rows skipped; None where there is none."""
    if column not in table:
        return None
    times, values = table["time"].to_numpy(np.float64), table[column].to_numpy(np.float64)
    known = np.isfinite(values) & np.isfinite(times)
    return (times[known], values[known]) if known.any() else None


def _require_activity(samples: tuple[Array, Array], column: str, where: str) -> None:
    if not (samples[1] > 0).any():
        raise InputError(f"{where}: column '{column}' has no value above 0; a diagnosis needs an arterial input.")


def _table(plasma: tuple[Array, Array], column: str, fraction: tuple[Array, Array] | None = None) -> pd.DataFrame:
    """Samples by time, as they were read."""
    found = pd.DataFrame({_TIME: plasma[0], column: plasma[1]})
    if fraction is None:
        return found
    return found.merge(pd.DataFrame({_TIME: fraction[0], _FRACTION: fraction[1]}), on=_TIME, how="outer", sort=True)


def _joined(fast: tuple[Array, Array], slow: tuple[Array, Array] | None) -> tuple[Array, Array]:
    if slow is None:
        return fast
    later = slow[0] > fast[0][-1]
    return np.concatenate([fast[0], slow[0][later]]), np.concatenate([fast[1], slow[1][later]])


def _through_ratio(plasma: tuple[Array, Array], whole: tuple[Array, Array]) -> tuple[Array, Array]:
    """Plasma at its own samples, and blood times the ratio at blood samples before the last of them."""
    at = np.interp(plasma[0], *whole)
    usable = (at > 0) & (plasma[0] > 0)
    if not usable.any():
        return plasma
    ratio = plasma[1][usable] / at[usable]
    more = np.setdiff1d(whole[0], plasma[0])
    derived = np.interp(more, *whole) * np.interp(more, plasma[0][usable], ratio)
    times = np.concatenate([plasma[0], more])
    order = np.argsort(times, kind="stable")
    return times[order], np.concatenate([plasma[1], derived])[order]


def _lines(times: Array, values: Array, end: float) -> PiecewiseLinear:
    times, values = times[times >= 0], values[times >= 0]
    if times[0] > 0:
        times, values = np.append(0.0, times), np.append(0.0, values)
    if times[-1] < end:
        times, values = np.append(times, end), np.append(values, values[-1])
    return PiecewiseLinear(torch.from_numpy(times), torch.from_numpy(values))


def _refined(times: Array, product: bool) -> Array:
    """Halves and quarters of long pieces, since a product of two straight lines is bent."""
    if not product:
        return times
    pieces = [times]
    for part in (0.25, 0.5, 0.75):
        pieces.append(times[:-1] + part * np.diff(times))
    return np.unique(np.concatenate(pieces))


def _held(curves: dict[str, tuple[Array, Array] | None], end: float) -> list[str]:
    return [
        f"Samples of {name} end at {curve[0][-1]:.2f} min, the scan at {end:.2f} min; the last value is held."
        for name, curve in curves.items()
        if curve is not None and curve[0][-1] < end - 1e-9
    ]


def reading_nodes(arterial: InputFunction, end: float, arrival_step: float = 1.0) -> Array:
    """Times at which an input is read: its own knots, and 1 s early to 30 s late."""
    steps = ((3.0, arrival_step), (10.0, 5.0), (end + 2.0, 30.0))
    start, parts = 0.0, [np.zeros(1)]
    for stop, step_s in steps:
        parts.append(np.arange(start, max(stop, start), step_s / SECONDS_PER_MINUTE))
        start = max(stop, start)
    knots = [np.asarray(f.knots) for f in (arterial.plasma, arterial.whole_blood)]
    nodes = np.unique(np.concatenate([*parts, *knots, [end + 2.0]]).round(9))
    return nodes[(nodes >= 0) & (nodes <= end + 2.0)].astype(np.float64)


def read_at(arterial: InputFunction, nodes: Array) -> InputFunction:
    """The input as straight lines between nodes."""

    def lines(curve: Forcing | None) -> PiecewiseLinear | None:
        return None if curve is None else PiecewiseLinear(nodes, np.asarray(curve(nodes)))

    plasma = lines(arterial.plasma)
    blood = plasma if arterial.whole_blood is arterial.plasma else lines(arterial.whole_blood)
    assert plasma is not None
    assert blood is not None
    return replace(
        arterial,
        plasma=plasma,
        whole_blood=blood,
        total_plasma=lines(arterial.total_plasma),
        parent_fraction=lines(arterial.parent_fraction),
    )
