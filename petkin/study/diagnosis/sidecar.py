"""What a sidecar already shows, before any statistics: decay corrected by a wrong amount, clocks that do not agree.

A stated decay factor of frame k is f_k = lam' d_k / (1 - e^{-lam' d_k}) e^{lam' (start_k - t_ref)}: its growth over the
scan tells with which lam' values were corrected, its level to which time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.imaging.decay import half_life
from petkin.io import PetSidecar
from petkin.io.checks import implied_references, stated_factors
from petkin.units import SECONDS_PER_MINUTE

#: Log odds that a finding lends an effect: what factors prove, what two fields contradict, what looks odd, and what is
#: only worth saying.
_PROVED, _CONTRADICTED, _ODD, _SAID = 8.0, 5.0, 2.0, 0.0
#: Growth of the stated factors over that of the nuclide, what it means, and how far off it may lie.
_GROWTHS = ((1.0 / math.log(2.0), "mean_life_swap"), (2.0, "decay_applied_twice"), (0.0, "decay_not_applied"))
_SAME_GROWTH, _RIGHT_GROWTH = 0.03, 0.002
#: Factors and times are stated to about this, s.
_ROUNDED_S = 1.0
_MEAN_LIFE = "the half-life taken for the mean life"


@dataclass(frozen=True)
class Blunder:
    """A mistake that the sidecar shows.

    Args:
        effect: its name in the catalogue.
        odds: natural logarithm by which it makes the effect likelier.
        why: one clause, with the fields and their values.
        scale: relative error of all values, for what is a pure scale and no curve can show; else 0.
    """

    effect: str
    odds: float
    why: str
    scale: float = 0.0

    @property
    def sure(self) -> bool:
        """Whether it is more than odd."""
        return self.odds >= _CONTRADICTED


def blunders(sidecar: PetSidecar | None) -> tuple[Blunder, ...]:
    """All that a sidecar shows, one entry an effect, the surest first; nothing without one."""
    if sidecar is None:
        return ()
    found = [
        blunder for check in (_growth, _state, _half_life, _reference, _frame, _clock) for blunder in check(sidecar)
    ]
    first = {blunder.effect: blunder for blunder in sorted(found, key=lambda b: b.odds)}
    return tuple(sorted(first.values(), key=lambda b: -b.odds))


def _growth(sidecar: PetSidecar) -> list[Blunder]:
    """lam' / lam from the slope of what the factors leave over what they should be."""
    field, factors = stated_factors(sidecar)
    if factors is None or not sidecar.image_decay_corrected:
        return []
    lam = _natural(sidecar)
    if np.allclose(factors, 1.0):
        return [
            Blunder("decay_not_applied", _PROVED, f"{field} is 1 in every frame though ImageDecayCorrected is true")
        ]
    middle = np.asarray(sidecar.frame_times_start) + 0.5 * np.asarray(sidecar.frame_duration)
    if len(middle) < 3:
        return []
    growth = float(np.polyfit(middle, np.log(factors), 1)[0]) / lam
    if abs(growth - 1.0) < _RIGHT_GROWTH:
        return []
    grown = f"{field} grows {growth:.4g} times as fast as {sidecar.nuclide} decays"
    for ratio, effect in _GROWTHS:
        if abs(growth - ratio) < _SAME_GROWTH:
            meaning = f", as with {_MEAN_LIFE}" if effect == "mean_life_swap" else ""
            return [Blunder(effect, _PROVED, grown + meaning)]
    return [Blunder("half_life_error", _PROVED, grown)]


def _state(sidecar: PetSidecar) -> list[Blunder]:
    """Fields that contradict one another on whether decay was corrected."""
    corrected, stated = sidecar.image_decay_corrected, sidecar.decay_correction.strip().upper()
    if corrected and stated == "NONE":
        return [Blunder("decay_not_applied", _CONTRADICTED, "ImageDecayCorrected is true but DecayCorrection is NONE")]
    if corrected:
        return []
    field, factors = stated_factors(sidecar)
    if factors is not None and not np.allclose(factors, 1.0):
        why = f"ImageDecayCorrected is false but {field} reaches {factors.max():.4g}, and petkin corrects the values"
        return [Blunder("decay_applied_twice", _CONTRADICTED, why)]
    if stated in ("ADMIN", "START"):
        why = f"ImageDecayCorrected is false but DecayCorrection is {stated}, and petkin corrects the values"
        return [Blunder("decay_applied_twice", _CONTRADICTED, why)]
    return []


def _half_life(sidecar: PetSidecar) -> list[Blunder]:
    """RadionuclideHalfLife against the nuclide's."""
    stated, natural = sidecar.radionuclide_half_life, half_life(sidecar.nuclide) * SECONDS_PER_MINUTE
    if not stated or stated <= 0 or abs(natural / stated - 1.0) < _RIGHT_GROWTH or not sidecar.image_decay_corrected:
        return []
    why = f"RadionuclideHalfLife is {stated:g} s but that of {sidecar.nuclide} is {natural:.6g} s"
    if abs(natural / stated - 1.0 / math.log(2.0)) < _SAME_GROWTH:
        return [Blunder("mean_life_swap", _CONTRADICTED, f"{why}, as with {_MEAN_LIFE}")]
    return [Blunder("half_life_error", _CONTRADICTED, why)]


def _reference(sidecar: PetSidecar) -> list[Blunder]:
    """To which time the factors refer: a pure scale, which kinetics absorb."""
    field, off = _references(sidecar)
    if off.size == 0 or abs(np.median(off)) < _ROUNDED_S:
        return []
    late, scale = float(np.median(off)), math.expm1(_natural(sidecar) * abs(float(np.median(off))))
    side, stated = "before" if late < 0 else "after", sidecar.image_decay_correction_time or 0.0
    why = (
        f"{field} implies a decay reference {abs(late):.1f} s {side} ImageDecayCorrectionTime ({stated:g} s), so that "
        f"all values are {100 * scale:.2g} % too {'large' if late < 0 else 'small'} beside the blood"
    )
    if late < 0 and sidecar.decay_correction.strip().upper() == "ADMIN":
        why += "; corrected to the administration (ADMIN), which then came earlier than InjectionStart says"
    return [Blunder("input_scale", _PROVED, why, scale)]


def _frame(sidecar: PetSidecar) -> list[Blunder]:
    """One frame whose duration its decay factor or the schedule denies."""
    field, off = _references(sidecar)
    if off.size >= 3:
        k = int(np.argmax(np.abs(off - np.median(off))))
        others = np.delete(off, k)
        if abs(off[k] - np.median(off)) > _ROUNDED_S and np.ptp(others) < _ROUNDED_S:
            why = f"{field} of frame {k} (from 0) belongs to another start or duration than the sidecar's"
            return [Blunder("frame_duration", _PROVED, why)]
    start, duration = np.asarray(sidecar.frame_times_start), np.asarray(sidecar.frame_duration)
    gap = start[1:] - (start + duration)[:-1]
    holes = np.flatnonzero(gap > _ROUNDED_S)
    if holes.size == 1:
        k = int(holes[0])
        if k > 0 and abs(duration[k] + gap[k] - duration[k - 1]) < _ROUNDED_S:
            full = duration[k] + gap[k]
            why = f"frame {k} (from 0) is stated to last {duration[k]:g} s and {full:g} s would fill its gap"
            return [Blunder("frame_duration", _ODD, why)]
    return []


def _clock(sidecar: PetSidecar) -> list[Blunder]:
    """Injection and scan against the frame times."""
    first, injected, started = sidecar.frame_times_start[0], sidecar.injection_start, sidecar.scan_start
    if injected:
        why = f"InjectionStart is {injected:g} s; blood that was timed from the injection lies as far off the frames"
        return [Blunder("frame_offset", _ODD, why)]
    if started is not None and abs(started - first) > _ROUNDED_S:
        return [Blunder("frame_offset", _SAID, f"ScanStart is {started:g} s but the first frame starts at {first:g} s")]
    return []


def _references(sidecar: PetSidecar) -> tuple[str, NDArray[np.float64]]:
    """Field of the factors, and by how much (s) the reference that each implies is later than stated; empty for none.

    Of the stated and the nuclide's half-life, the one counts with which all factors imply the same reference.
    """
    field, factors = stated_factors(sidecar)
    if factors is None or not sidecar.image_decay_corrected or np.allclose(factors, 1.0) or _growth(sidecar):
        return field, np.zeros(0)
    natural = half_life(sidecar.nuclide) * SECONDS_PER_MINUTE
    start, duration = np.asarray(sidecar.frame_times_start), np.asarray(sidecar.frame_duration)
    found = [
        implied_references(factors, start, duration, h) for h in (sidecar.radionuclide_half_life or natural, natural)
    ]
    steadiest = min(found, key=lambda references: float(np.ptp(references)))
    return field, np.asarray(steadiest - (sidecar.image_decay_correction_time or 0.0), np.float64)


def _natural(sidecar: PetSidecar) -> float:
    """lam of the nuclide, 1/s."""
    return math.log(2.0) / (half_life(sidecar.nuclide) * SECONDS_PER_MINUTE)
