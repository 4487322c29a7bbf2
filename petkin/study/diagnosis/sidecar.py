"""What a sidecar already shows, before any statistics: decay corrected by a wrong amount, clocks that do not agree.

A stated decay factor of frame k is f_k = lam' d_k / (1 - e^{-lam' d_k}) e^{lam' (start_k - t_ref)}: its growth over the
scan tells with which lam' values were corrected, its level to which time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.imaging.decay import NUCLIDES, half_life
from petkin.io import PetSidecar
from petkin.io.checks import implied_constant, implied_references, stated_factors
from petkin.units import SECONDS_PER_MINUTE

#: Log odds that a finding lends an effect: what factors prove, what two fields contradict, what looks odd, and what is
#: only worth saying: neither weighed nor in the sentence.
_PROVED, _CONTRADICTED, _ODD, _SAID = 8.0, 5.0, 2.0, 0.0
_MEAN_LIFE = (1.0 / math.log(2.0), "mean_life_swap")
#: Growth of the stated factors over that of the nuclide, what it means, and how far off it may lie.
_GROWTHS = (_MEAN_LIFE, (2.0, "decay_applied_twice"), (0.0, "decay_not_applied"))
_SAME_GROWTH, _RIGHT_GROWTH = 0.03, 0.002
#: Factors that tell how they grow, at least.
_ENOUGH = 3
#: Relative error within which a half-life is another nuclide's, as tables of it differ.
_SAME_NUCLIDE = 0.02
#: Share of the decay correction, from its reference to the far end of the scan, below which a change is slight.
_SLIGHT = 0.01
#: Half-lives (min) that scanners and programs use, least and greatest: to differ by these is no mistake of the study.
_IN_USE = {"C11": (20.3, 20.4), "O15": (2.03, 2.07), "F18": (109.7, 110.0), "Ga68": (67.6, 68.0)}
#: Factors and times are stated to about this, s; factors, to about this share.
_ROUNDED_S, _ROUNDED = 1.0, 1e-4


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
    """The factors' lam' over the nuclide's lam."""
    field, factors = stated_factors(sidecar)
    if factors is None or not sidecar.image_decay_corrected:
        return []
    if np.allclose(factors, 1.0):
        if _decayed(sidecar) < _SLIGHT:
            return []
        return [
            Blunder("decay_not_applied", _PROVED, f"{field} is 1 in every frame though ImageDecayCorrected is true")
        ]
    growth = _grown(sidecar)
    if growth is None:
        return []
    grown = f"{field} grows {growth:.4g} times as fast as {sidecar.nuclide} decays"
    grown += "".join(f", as those of {other} would" for other in _others(sidecar.nuclide, growth))
    return _meant(sidecar, growth, grown, _PROVED, _GROWTHS)


def _grown(sidecar: PetSidecar) -> float | None:
    """lam' / lam of stated factors; None where they are missing or too few to tell."""
    factors, start, duration = stated_factors(sidecar)[1], *_times(sidecar)
    if factors is None or len(factors) < _ENOUGH:
        return None
    return implied_constant(factors, start, duration) / _natural(sidecar)


def _meant(
    sidecar: PetSidecar, growth: float, why: str, odds: float, known: tuple[tuple[float, str], ...]
) -> list[Blunder]:
    """What a correction means that grows so many times as fast as the nuclide decays; nothing where it is right."""
    if abs(growth - 1.0) < _RIGHT_GROWTH:
        return []
    change = abs(growth - 1.0) * _decayed(sidecar)
    if change < _SLIGHT or _in_use(sidecar.nuclide, growth):
        return [_said("half_life_error", f"{why}, which changes the decay correction by {100 * change:.2g} % at most")]
    for ratio, effect in known:
        if abs(growth - ratio) < _SAME_GROWTH:
            meaning = ", as with the half-life taken for the mean life" if effect == _MEAN_LIFE[1] else ""
            return [Blunder(effect, odds, why + meaning)]
    return [Blunder("half_life_error", odds, why)]


def _decayed(sidecar: PetSidecar) -> float:
    """lam t from the decay reference to the far end of the scan."""
    start, duration = _times(sidecar)
    ends = np.array([start[0], start[-1] + duration[-1]])
    return _natural(sidecar) * float(np.abs(ends - (sidecar.image_decay_correction_time or 0.0)).max())


def _said(effect: str, why: str) -> Blunder:
    """What the page alone tells; 0 is the prior of no flag, so that `effect` must have a size."""
    return Blunder(effect, _SAID, f"{why} (said only: it is not weighed)")


def _in_use(nuclide: str, growth: float) -> bool:
    """Whether the half-life of such a growth is one that is used for the nuclide."""
    least, greatest = _IN_USE.get(nuclide, (math.inf, math.inf))
    return growth > 0.0 and least * (1.0 - _RIGHT_GROWTH) < half_life(nuclide) / growth < greatest * (
        1.0 + _RIGHT_GROWTH
    )


def _others(nuclide: str, growth: float) -> list[str]:
    """The other nuclide whose half-life such a growth has, if any."""
    lives = half_life(nuclide)
    return [
        other for other in NUCLIDES if other != nuclide and abs(growth * half_life(other) / lives - 1.0) < _SAME_NUCLIDE
    ]


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
    if not stated or stated <= 0 or not sidecar.image_decay_corrected:
        return []
    why = f"RadionuclideHalfLife is {stated:g} s but that of {sidecar.nuclide} is {natural:.6g} s"
    why += "".join(f", as that of {other} is" for other in _others(sidecar.nuclide, natural / stated))
    grown = _grown(sidecar)
    if grown is not None and abs(grown - 1.0) < _RIGHT_GROWTH < abs(natural / stated - 1.0):
        why += f"; {stated_factors(sidecar)[0]} shows that values were corrected as they should be"
        return [_said("half_life_error", why)]
    return _meant(sidecar, natural / stated, why, _CONTRADICTED, (_MEAN_LIFE,))


def _reference(sidecar: PetSidecar) -> list[Blunder]:
    """To which time the factors refer: a pure scale, which kinetics absorb."""
    field, off = _references(sidecar)
    if off.size == 0 or abs(np.median(off)) < _rounded_s(sidecar):
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
        if abs(off[k] - np.median(off)) > _rounded_s(sidecar) > np.ptp(others):
            why = f"{field} of frame {k} (from 0) belongs to another start or duration than the sidecar's"
            return [Blunder("frame_duration", _PROVED, why)]
    start, duration = _times(sidecar)
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
    """Injection and scan against the frame times.

    No evidence: frames and blood are timed from TimeZero, from which the injection may lie as far as it likes.
    """
    first, injected, started = sidecar.frame_times_start[0], sidecar.injection_start, sidecar.scan_start
    if injected:
        why = f"InjectionStart is {injected:g} s; blood timed from the injection would lie as far off the frames"
        return [_said("frame_offset", why)]
    if started is not None and abs(started - first) > _ROUNDED_S:
        return [_said("frame_offset", f"ScanStart is {started:g} s but the first frame starts at {first:g} s")]
    return []


def _references(sidecar: PetSidecar) -> tuple[str, NDArray[np.float64]]:
    """Field of the factors, and by how much (s) the reference that each implies is later than stated; empty for none.

    Of the stated half-life, the nuclide's and one that differs slightly and made the factors, the one counts with which
    all factors imply the same reference.
    """
    field, factors = stated_factors(sidecar)
    growth = _growth(sidecar)
    if factors is None or not sidecar.image_decay_corrected or np.allclose(factors, 1.0):
        return field, np.zeros(0)
    if any(found.odds > _SAID for found in growth):
        return field, np.zeros(0)
    natural = half_life(sidecar.nuclide) * SECONDS_PER_MINUTE
    lives = [sidecar.radionuclide_half_life or natural, natural]
    ratio = _grown(sidecar)
    if growth and ratio is not None:
        if abs(ratio - 1.0) > _SAME_NUCLIDE:  # so little decay that rounding may have made it
            return field, np.zeros(0)
        lives.append(natural / ratio)
    found = [implied_references(factors, *_times(sidecar), h) for h in lives]
    steadiest = min(found, key=lambda references: float(np.ptp(references)))
    return field, np.asarray(steadiest - (sidecar.image_decay_correction_time or 0.0), np.float64)


def _times(sidecar: PetSidecar) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Start and duration of the frames, s."""
    return np.asarray(sidecar.frame_times_start, np.float64), np.asarray(sidecar.frame_duration, np.float64)


def _natural(sidecar: PetSidecar) -> float:
    """lam of the nuclide, 1/s."""
    return math.log(2.0) / (half_life(sidecar.nuclide) * SECONDS_PER_MINUTE)


def _rounded_s(sidecar: PetSidecar) -> float:
    """By how much rounding may move the reference that a factor implies, s."""
    return max(_ROUNDED_S, _ROUNDED / _natural(sidecar))
