"""Total plasma and whole blood as continuous curves, from what a laboratory has measured of either."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from petkin.errors import InputError
from petkin.inputs.blood_table import AIF, PLASMA, WHOLE_BLOOD, Samples, checked
from petkin.inputs.curves import Curve, joined, through
from petkin.inputs.dispersion import undispersed
from petkin.inputs.plasma_ratio import PlasmaRatio, fit_plasma_ratio, ratio_pairs

#: An autosampler that departs from manual samples by more than this share deserves a remark.
_MISMATCH = 0.10
#: They are compared from this long after its peak on, with the mean over this long to either side (min).
_AFTER_PEAK, _NEAR = 1.0, 10 / 60


@dataclass(frozen=True)
class Measured:
    """Checked blood samples of one scan: manual ones by column, and whole blood of an autosampler."""

    manual: dict[str, Samples]
    automatic: Samples | None
    where: str


def measured(
    manual: pd.DataFrame, automatic: pd.DataFrame | None, *, dispersion: float | None, where: str
) -> tuple[Measured, list[str]]:
    """Check both tables and correct the autosampler for dispersion.

    Args:
        manual: see `from_blood`.
        automatic: see `from_blood`.
        dispersion: time constant of the autosampler's line, min.
        where: file, for messages.

    Returns:
        The samples, and remarks.

    Raises:
        InputError: see `blood_table.checked`; a dispersion without an autosampler; an autosampler without whole blood.
    """
    by_column = checked(manual, where=where)
    remarks = [line for name, samples in by_column.items() for line in _negative(samples, f"manual {name}")]
    if automatic is None:
        if dispersion is not None:
            raise InputError(
                f"{where}: a dispersion of {dispersion:g} min is given but no autosampler to correct for it."
            )
        return Measured(by_column, None, where), remarks
    place = f"{where} (autosampler)"
    fast = checked(automatic, where=place).get(WHOLE_BLOOD)
    if fast is None:
        raise InputError(f"{place}: there is no column '{WHOLE_BLOOD}'; an autosampler is read as whole blood.")
    remarks += _negative(fast, "autosampler")
    if dispersion is not None:
        fast = Samples(fast.times, undispersed(fast.times, fast.values, dispersion))
        remarks.append(f"The autosampler is corrected for a dispersion of {60 * dispersion:.2g} s.")
    return Measured(by_column, fast, where), remarks


def _negative(samples: Samples, what: str) -> list[str]:
    below = int((samples.values < 0).sum())
    if not below:
        return []
    lowest = samples.values.min()
    return [f"{below} of {samples.size} {what} values are negative (lowest {lowest:.3g}); they are kept as they are."]


def whole_blood_curve(blood: Measured, samples: Samples | None) -> tuple[Curve, list[str]]:
    """Whole blood from manual `samples`, the autosampler, or both; one of them must be there."""
    fast = blood.automatic
    if fast is None or samples is None:
        only = samples if fast is None else fast
        if only is None:
            raise InputError(f"{blood.where}: there is no column '{WHOLE_BLOOD}', manual or automatic.")
        return through(only, washout_from=np.inf if only is fast else 0.0), []
    curve, how = joined(fast, samples)
    return curve, [how, *_mismatch(fast, samples)]


def _mismatch(fast: Samples, manual: Samples) -> list[str]:
    from_time = fast.times[int(fast.values.argmax())] + _AFTER_PEAK
    common = (manual.times >= from_time) & (manual.times <= fast.times[-1]) & (manual.values > 0)
    near = [fast.values[np.abs(fast.times - t) <= _NEAR] for t in manual.times[common]]
    quotients = [n.mean() / m for n, m in zip(near, manual.values[common], strict=True) if n.size]
    if not quotients or abs(float(np.median(quotients)) - 1) <= _MISMATCH:
        return []
    return [
        f"The autosampler reads {np.median(quotients):.2f} x the manual whole blood (median of {len(quotients)} "
        f"samples, {min(quotients):.2f} to {max(quotients):.2f}); it is not rescaled."
    ]


def plasma_and_blood(blood: Measured, *, ratio_model: str, haematocrit: float | None) -> tuple[Curve, Curve, list[str]]:
    """Total plasma and whole blood where plasma is measured.

    Args:
        blood: the samples.
        ratio_model: see `fit_plasma_ratio`.
        haematocrit: C_B = (1 - haematocrit) plasma where whole blood was not measured at all.

    Returns:
        Total plasma, whole blood, remarks.

    Raises:
        InputError: no plasma; or no time at which both are known, where one must be derived from the other.
    """
    if PLASMA not in blood.manual:
        raise InputError(
            f"{blood.where}: there is no column '{PLASMA}'; if whole blood may stand for it, ask for that with "
            "plasma_from='whole_blood'."
        )
    plasma, manual, fast = blood.manual[PLASMA], blood.manual.get(WHOLE_BLOOD), blood.automatic
    if manual is None and fast is None:
        samples, remarks = blood_from_plasma(plasma, haematocrit)
        return through(plasma), through(samples), remarks
    alone = np.setdiff1d([] if manual is None else manual.times, plasma.times)
    if fast is None and alone.size == 0:
        curve, remarks = whole_blood_curve(blood, manual)
        return through(plasma), curve, remarks
    ratio, remarks = _ratio(blood, plasma, ratio_model)
    if manual is not None and alone.size:
        plasma = _completed(plasma, manual, alone, ratio)
        remarks.append(f"{alone.size} manual samples hold whole blood alone; their plasma follows from that ratio.")
    if manual is None:
        manual = Samples(plasma.times, plasma.values / ratio(plasma.times))
        remarks.append("Manual samples hold plasma alone; their whole blood follows from that ratio.")
    curve, more = whole_blood_curve(blood, manual)
    if fast is None:
        return through(plasma), curve, [*remarks, *more]
    return joined(Samples(fast.times, fast.values * ratio(fast.times)), plasma)[0], curve, [*remarks, *more]


def plasma_from_blood(blood: Measured, haematocrit: float | None) -> tuple[Curve, Curve, list[str]]:
    """Total plasma = whole blood, over (1 - haematocrit) where that is given; whole blood; remarks."""
    factor = 1.0 if haematocrit is None else 1.0 / (1.0 - haematocrit)
    curve, remarks = whole_blood_curve(blood, blood.manual.get(WHOLE_BLOOD))
    remarks.append(f"Total plasma is taken as {factor:.3g} x whole blood, as asked.")
    return curve.times(lambda t: np.full_like(t, factor)), curve, remarks


def blood_from_plasma(plasma: Samples, haematocrit: float | None) -> tuple[Samples, list[str]]:
    """Whole blood = plasma, times (1 - haematocrit) where that is given; and a remark."""
    factor = 1.0 if haematocrit is None else 1.0 - haematocrit
    return Samples(plasma.times, factor * plasma.values), [
        f"There is no whole blood; it is taken as {factor:.3g} x plasma."
    ]


def beside_given_input(blood: Measured, haematocrit: float | None) -> tuple[Curve | None, Curve, list[str]]:
    """Total plasma (if measured) and whole blood beside a ready input function, and remarks."""
    total = through(blood.manual[PLASMA]) if PLASMA in blood.manual else None
    if WHOLE_BLOOD in blood.manual or blood.automatic is not None:
        curve, remarks = whole_blood_curve(blood, blood.manual.get(WHOLE_BLOOD))
        return total, curve, remarks
    samples, remarks = blood_from_plasma(blood.manual.get(PLASMA, blood.manual[AIF]), haematocrit)
    return total, through(samples), remarks


def _ratio(blood: Measured, plasma: Samples, model: str) -> tuple[PlasmaRatio, list[str]]:
    """Plasma over whole blood from rows that hold both, or else from the autosampler at the plasma times."""
    manual, fast = blood.manual.get(WHOLE_BLOOD), blood.automatic
    both = np.intersect1d(plasma.times, [] if manual is None else manual.times)
    source = manual if both.size else fast
    pairs = Samples(np.empty(0), np.empty(0))
    if source is not None:
        inside = (plasma.times >= source.times[0]) & (plasma.times <= source.times[-1])
        at = both if both.size else plasma.times[inside]
        pairs = ratio_pairs(plasma, source, at)
    if pairs.size == 0:
        raise InputError(
            f"{blood.where}: plasma and whole blood have no time in common, so neither follows from the other; "
            "add a row that holds both."
        )
    ratio = fit_plasma_ratio(pairs, model=model)
    low, high = pairs.values.min(), pairs.values.max()
    return ratio, [f"Plasma over whole blood: {ratio.name}, from {pairs.size} samples of {low:.2f} to {high:.2f}."]


def _completed(plasma: Samples, manual: Samples, alone: np.ndarray, ratio: PlasmaRatio) -> Samples:
    derived = manual.values[np.isin(manual.times, alone)] * ratio(alone)
    times, values = np.concatenate([plasma.times, alone]), np.concatenate([plasma.values, derived])
    order = np.argsort(times)
    return Samples(times[order], values[order])
