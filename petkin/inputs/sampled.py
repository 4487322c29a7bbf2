"""The input function from blood samples: C_P(t) = total plasma(t) x parent fraction(t)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from petkin.dynamics import PiecewiseLinear
from petkin.errors import InputError
from petkin.inputs.blood_curves import Measured, beside_given_input, measured, plasma_and_blood, plasma_from_blood
from petkin.inputs.blood_table import AIF, MEASURED, PARENT_FRACTION, TIME, Samples
from petkin.inputs.curves import Curve, through
from petkin.inputs.input_function import InputFunction
from petkin.inputs.linearise import piecewise_linear
from petkin.inputs.parent_fraction import ParentFractionFit, fit_parent_fraction

#: Curves run this far past the scan (min), so that an earlier arrival in tissue than in blood needs no held value.
_MARGIN = 2.0
#: A first sample above this share of the peak deserves a remark.
_LATE_START = 0.05
#: Blood this many times longer (or shorter) than the scan points to seconds (or minutes) taken for the other.
_UNIT_SUSPECT = 20.0


def from_blood(
    manual: pd.DataFrame,
    automatic: pd.DataFrame | None = None,
    *,
    parent_fraction: str = "auto",
    plasma_ratio: str = "interpolated",
    plasma_from: str = "plasma",
    dispersion: float | None = None,
    haematocrit: float | None = None,
    scan_end: float | None = None,
    required_until: float | None = None,
    where: str = "blood",
) -> InputFunction:
    """An input function from the blood tables of a scan: C_P(t) = total plasma(t) x parent fraction(t).

    Total plasma is measured (manual), or whole blood times the plasma-to-blood ratio of manual samples (autosampler,
    and manual rows without plasma). `curves.joined` says how the two samplers meet, `curves.through` how samples are
    read between, before and after. An AIF column is taken as C_P as it is. Every choice and repair leaves a remark.

    Args:
        manual: BIDS column names; time in min from injection, activity in kBq/mL decay-corrected to injection, NaN =
            missing: time, plasma_radioactivity (total), whole_blood_radioactivity, metabolite_parent_fraction, AIF.
        automatic: the same from an autosampler, whose whole_blood_radioactivity is used.
        parent_fraction: model for `fit_parent_fraction`; or none: plasma holds the unchanged tracer alone.
        plasma_ratio: model for `fit_plasma_ratio`.
        plasma_from: plasma; or whole_blood: the total plasma is whole blood, over (1 - haematocrit) if that is given.
        dispersion: time constant of the autosampler's line to correct for, min.
        haematocrit: of a tracer that no cell takes up, 0 to 1: C_B = (1 - haematocrit) plasma where one is missing.
        scan_end: end of the last frame, min; curves are extended past it.
        required_until: time that the samples must reach, min, e.g. the start of the last frame.
        where: file, for messages.

    Returns:
        The input function, in straight pieces within 0.02 % of the curves they read; its end is the last sample.

    Raises:
        InputError: see `blood_table.checked`; a missing quantity; blood that ends too early; an option out of range.
    """
    _check_options(plasma_from, haematocrit, where)
    blood, remarks = measured(manual, automatic, dispersion=dispersion, where=where)
    fraction = None
    if AIF in blood.manual:
        total, whole_blood, more = beside_given_input(blood, haematocrit)
        plasma = through(blood.manual[AIF])
        more.append("The table holds the metabolite-corrected input function itself; it is used as it is.")
    else:
        if plasma_from == "plasma":
            total, whole_blood, more = plasma_and_blood(blood, ratio_model=plasma_ratio, haematocrit=haematocrit)
        else:
            total, whole_blood, more = plasma_from_blood(blood, haematocrit)
        fraction, plain = _fraction(blood, parent_fraction, total.end)
        plasma, more = (total if fraction is None else total.times(fraction)), [*more, *plain]
    _check_reach(plasma.end, scan_end, required_until, where)
    remarks += [*more, *_start(plasma), *_extensions({"plasma": plasma, "whole blood": whole_blood}, scan_end)]
    last = max(plasma.end, whole_blood.end, 0.0 if scan_end is None else scan_end + _MARGIN)
    kinks = np.array([0.0, last]) if fraction is None else np.concatenate([[0.0], fraction.times, [last]])
    return InputFunction(
        plasma=_forcing(plasma, kinks),
        whole_blood=_forcing(whole_blood, kinks[[0, -1]]),
        end=plasma.end,
        samples=_samples(manual, automatic),
        remarks=tuple(remarks),
        total_plasma=None if total is None else _forcing(total, kinks[[0, -1]]),
        parent_fraction=None if fraction is None else piecewise_linear(fraction, kinks[kinks <= last]),
        parent_fraction_fit=fraction,
    )


def _check_options(plasma_from: str, haematocrit: float | None, where: str) -> None:
    if plasma_from not in {"plasma", "whole_blood"}:
        raise InputError(f"{where}: plasma_from is {plasma_from!r}; use 'plasma' or 'whole_blood'.")
    if haematocrit is not None and not 0 < haematocrit < 1:
        raise InputError(f"{where}: a haematocrit of {haematocrit:g} is out of range; give a fraction such as 0.42.")


def _fraction(blood: Measured, model: str, end: float) -> tuple[ParentFractionFit | None, list[str]]:
    """The parent fraction, or None where the plasma is taken as unmetabolised; and remarks."""
    samples: Samples | None = blood.manual.get(PARENT_FRACTION)
    if model == "none":
        return None, ["No parent fraction is applied, as asked: plasma is taken to hold unchanged tracer alone."]
    if samples is None:
        if model != "auto":
            raise InputError(f"{blood.where}: there is no column '{PARENT_FRACTION}' to fit the model {model!r} to.")
        return None, [
            "No parent fraction: total plasma is the input, which is right only without labelled metabolites."
        ]
    fit = fit_parent_fraction(samples.times, samples.values, model=model)
    remarks = [f"Parent fraction: {fit.name}, from {samples.size} samples.", *fit.remarks]
    if samples.times[-1] < 0.9 * end:
        remarks.append(f"Parent fraction samples end at {samples.times[-1]:.1f} min, blood ends at {end:.1f} min.")
    return fit, remarks


def _check_reach(end: float, scan_end: float | None, required_until: float | None, where: str) -> None:
    if scan_end is not None and end > _UNIT_SUSPECT * scan_end:
        raise InputError(
            f"{where}: blood runs to {end:g} min but the scan ends at {scan_end:g} min; its times seem to be "
            "in seconds where minutes are stated: correct their unit."
        )
    if required_until is not None and end < required_until:
        hint = " (are its times in minutes where seconds are stated?)" if end * _UNIT_SUSPECT < required_until else ""
        raise InputError(
            f"{where}: blood ends at {end:.4g} min but the last frame starts at {required_until:.4g} min{hint}; "
            "add samples, or leave the later frames out."
        )


def _start(plasma: Curve) -> list[str]:
    first = plasma.knots[plasma.knots > 0][0]
    share = float(plasma(np.array([first]))[0] / plasma(plasma.knots).max())
    if share <= _LATE_START:
        return []
    return [f"The first sample, at {first:.2f} min, holds {share:.0%} of the peak; a straight rise to it is assumed."]


def _extensions(curves: dict[str, Curve], scan_end: float | None) -> list[str]:
    if scan_end is None:
        return []
    ends = sorted({curve.end for curve in curves.values() if curve.end < scan_end - 1e-9})
    return [
        f"Samples of {' and '.join(name for name, curve in curves.items() if curve.end == end)} end at {end:.2f} min, "
        f"the scan at {scan_end:.2f} min; the exponential through the last of them (or their last value) goes on."
        for end in ends
    ]


def _forcing(curve: Curve, kinks: np.ndarray) -> PiecewiseLinear:
    knots = np.concatenate([curve.knots, kinks])
    return piecewise_linear(curve, knots[knots <= kinks[-1]])


def _samples(manual: pd.DataFrame, automatic: pd.DataFrame | None) -> pd.DataFrame:
    """Both tables in one, the sampler in a column of its own."""
    parts = {"manual": manual, "autosampler": automatic}
    known = [TIME, *MEASURED]
    tables = [t[[c for c in known if c in t]].assign(sampler=name) for name, t in parts.items() if t is not None]
    return pd.concat(tables, ignore_index=True).sort_values(TIME, kind="stable", ignore_index=True)
