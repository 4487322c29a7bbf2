"""Traps of images, sidecars and frame times: each is one function that returns remarks, or refuses with one line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.imaging.decay import half_life
from petkin.io.remarks import Remark, note, severe, warning
from petkin.io.sidecar import MEGABECQUEREL, PetSidecar
from petkin.units import SECONDS_PER_MINUTE

#: Doses in MBq outside which a scan of a human or a large animal is hard to believe (Rb-82 reaches 2 GBq).
_PLAUSIBLE_DOSE_MBQ = (1.0, 5000.0)
#: Decay references are stated in whole seconds.
_REFERENCE_TOLERANCE_S = 1.0
#: Decay corrected for two half-lives may differ by this share at the end of the scan before it is worth a remark.
_DECAY_TOLERANCE = 0.01
#: Rounds after which the decay constant that factors imply has settled (a few do, unless one frame is the whole scan).
_ROUNDS = 100
#: More frames than this in less than five minutes: a long-lived tracer's schedule is then in minutes.
_MANY_FRAMES, _SHORT_SCAN_S, _SHORT_LIVED_MIN = 10, 300.0, 15.0


def check_sidecar(sidecar: PetSidecar) -> tuple[Remark, ...]:
    """All remarks on one `_pet.json`.

    Raises:
        InputError: frame times that cannot be right.
    """
    refuse_minutes(sidecar.frames, sidecar.nuclide, fields="FrameTimesStart and FrameDuration")
    return tuple(remark for check in SIDECAR_CHECKS for remark in check(sidecar))


def refuse_minutes(frames: FrameSchedule, nuclide: str | None, *, fields: str) -> None:
    """Refuse frame times that look like minutes where seconds are due.

    Raises:
        InputError: a frame under 1 s, or more than 10 frames within 5 minutes for a nuclide that lives longer (where
            it is known).
    """
    shortest, end = frames.duration.min() * SECONDS_PER_MINUTE, frames.end[-1] * SECONDS_PER_MINUTE
    lives = half_life(nuclide) if nuclide else 0.0
    hurried = len(frames) > _MANY_FRAMES and end < _SHORT_SCAN_S and lives > _SHORT_LIVED_MIN
    if shortest < 1.0 - 1e-6 or hurried:
        raise InputError(
            f"{frames.where}: {len(frames)} frames end at {end:g} s and the shortest lasts {shortest:g} s, which looks "
            f"like minutes; {fields} are in seconds: multiply them by 60."
        )


def dose(sidecar: PetSidecar) -> tuple[Remark, ...]:
    """The dose against RadionuclideTotalDose (DICOM, Bq), and against what people are given."""
    stated, unit = sidecar.injected_radioactivity, sidecar.injected_radioactivity_units
    if stated is None:
        return ()
    if sidecar.dose_mbq is None:
        known = ", ".join(MEGABECQUEREL)
        text = f"InjectedRadioactivityUnits is {unit!r}; the dose is not used until it is one of {known}."
        return (warning("dose-unit", sidecar.where, text),)
    total = sidecar.radionuclide_total_dose
    ratio = total * 1e-6 / sidecar.dose_mbq if total and sidecar.dose_mbq else 1.0
    if abs(ratio - 1.0) > 0.05:
        text = (
            f"InjectedRadioactivity is {stated:g} {unit} but RadionuclideTotalDose is {total:g} Bq, {ratio:.4g} times "
            "as much; kinetic parameters do not depend on it, an SUV would: correct the unit."
        )
        remark = severe if not 0.1 < ratio < 10.0 else warning
        return (remark("dose-mismatch", sidecar.where, text),)
    low, high = _PLAUSIBLE_DOSE_MBQ
    if not low <= sidecar.dose_mbq <= high:
        text = (
            f"InjectedRadioactivity is {stated:g} {unit} = {sidecar.dose_mbq:.4g} MBq, which is hard to believe; "
            "kinetic parameters do not depend on it, an SUV would: check the unit."
        )
        return (severe("dose-implausible", sidecar.where, text),)
    return ()


def nuclide_spelling(sidecar: PetSidecar) -> tuple[Remark, ...]:
    """The radionuclide as BIDS spells it."""
    if sidecar.tracer_radionuclide == sidecar.nuclide:
        return ()
    text = f"TracerRadionuclide is {sidecar.tracer_radionuclide!r}; read as {sidecar.nuclide}, as BIDS spells it."
    return (warning("nuclide-spelling", sidecar.where, text),)


def stated_half_life(sidecar: PetSidecar) -> tuple[Remark, ...]:
    """RadionuclideHalfLife against the table of nuclides."""
    stated, table = sidecar.radionuclide_half_life, half_life(sidecar.nuclide) * SECONDS_PER_MINUTE
    end = sidecar.frames.end[-1] * SECONDS_PER_MINUTE
    if not stated or stated <= 0 or abs(1 / stated - 1 / table) * np.log(2) * end < _DECAY_TOLERANCE:
        return ()
    found = f"RadionuclideHalfLife is {stated:g} s but that of {sidecar.nuclide} is {table:.6g} s"
    if sidecar.half_life * SECONDS_PER_MINUTE != table:
        text = f"{found}; the image is not corrected for decay, and the former is used to correct it."
    else:
        text = f"{found}; the latter is used, and a decay correction made with the former is off at late frames."
    return (warning("half-life", sidecar.where, text),)


def implied_references(
    factors: NDArray[np.float64], start_s: NDArray[np.float64], duration_s: NDArray[np.float64], half_life_s: float
) -> NDArray[np.float64]:
    """Reference t_ref (s) that each frame's factor f = lam d / (1 - e^{-lam d}) e^{lam (start - t_ref)} implies."""
    lam = np.log(2.0) / half_life_s
    return start_s - np.log(factors / _within(lam * duration_s)) / lam


def implied_constant(
    factors: NDArray[np.float64], start_s: NDArray[np.float64], duration_s: NDArray[np.float64]
) -> float:
    """lam (1/s) with which the factors of three frames or more were made, whatever their reference.

    log f = lam (mid - t_ref) + log(x / sinh x), x = lam d / 2: lam is the slope of what the last term leaves, found in
    rounds. The slope is the median of pairs of frames, weighted by their distance: one wrong frame hardly counts.
    """
    middle = start_s + 0.5 * duration_s
    first, second = np.triu_indices(len(middle), 1)
    apart, lam = middle[second] - middle[first], 0.0
    for _ in range(_ROUNDS):
        left = np.log(factors / _within(lam * duration_s)) + 0.5 * lam * duration_s
        before, lam = lam, _middlemost((left[second] - left[first]) / apart, apart)
        if abs(lam - before) <= 1e-12 * abs(lam):
            break
    return lam


def _within(decayed: NDArray[np.float64]) -> NDArray[np.float64]:
    """y / (1 - e^{-y}) for y = lam d: what a frame's mean loses to decay since its start; 1 where nothing decays."""
    y = np.where(decayed == 0.0, 1.0, decayed)
    return np.where(decayed == 0.0, 1.0, y / -np.expm1(-y))


def _middlemost(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """Weighted median."""
    order = np.argsort(values)
    passed = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(passed, 0.5 * passed[-1])])


def decay_factors(sidecar: PetSidecar) -> tuple[Remark, ...]:
    """Stated decay factors against ImageDecayCorrectionTime.

    The half-life is RadionuclideHalfLife (what the scanner used) or else the table's.
    """
    frames = len(sidecar.frame_duration)
    field, factors = stated_factors(sidecar)
    remarks: list[Remark] = []
    given = sidecar.decay_correction_factor
    if given is not None and len(given) != frames:
        text = f"DecayCorrectionFactor has {len(given)} values for {frames} frames; it is not used."
        remarks.append(note("decay-factor-count", sidecar.where, text))
    if factors is None:
        return tuple(remarks)
    if not sidecar.image_decay_corrected:
        if np.allclose(factors, 1.0):
            return tuple(remarks)
        text = f"{field} reaches {factors.max():.4g} though ImageDecayCorrected is false; check which of them is right."
        return (*remarks, severe("decay-contradiction", sidecar.where, text))
    lives = sidecar.radionuclide_half_life or half_life(sidecar.nuclide) * SECONDS_PER_MINUTE
    start, duration = np.asarray(sidecar.frame_times_start), np.asarray(sidecar.frame_duration)
    off = implied_references(factors, start, duration, lives) - (sidecar.image_decay_correction_time or 0.0)
    if np.abs(off).max() > _REFERENCE_TOLERANCE_S:
        remarks.append(_off_reference(sidecar, field, off, np.log(2.0) / lives))
    return tuple(remarks)


def stated_factors(sidecar: PetSidecar) -> tuple[str, NDArray[np.float64] | None]:
    """The field that states a decay factor for every frame, and the factors; None where neither field does."""
    for field, values in (
        ("DecayCorrectionFactor", sidecar.decay_correction_factor),
        ("DecayFactor", sidecar.decay_factor),
    ):
        if values is not None and len(values) == len(sidecar.frame_duration) and min(values) > 0:
            return field, np.asarray(values)
    return "", None


def _off_reference(sidecar: PetSidecar, field: str, off: NDArray[np.float64], lam: float) -> Remark:
    least, most = sorted(np.abs([off.min(), off.max()]))
    side = "before" if off.max() <= 0 else "after" if off.min() >= 0 else "around"
    percent, stated = 100 * np.expm1(lam * most), sidecar.image_decay_correction_time or 0.0
    text = (
        f"{field} implies a decay reference {least:.1f} to {most:.1f} s {side} ImageDecayCorrectionTime ({stated:g} "
        f"s); the stated time is used, values may be off by {percent:.2g} percent."
    )
    return (severe if percent > 5 else warning)("decay-reference", sidecar.where, text)


def decay_state(sidecar: PetSidecar) -> tuple[Remark, ...]:
    """Whether the image is decay-corrected, to what time, and what the reader does about it."""
    where, time = sidecar.where, sidecar.image_decay_correction_time
    if not sidecar.image_decay_corrected:
        factor = "lam d / (1 - exp(-lam d)) exp(lam start)"
        text = f"ImageDecayCorrected is false; every frame is multiplied by {factor} to refer to time zero."
        return (warning("decay-multiplied", where, text),)
    if sidecar.decay_correction.strip().upper() == "NONE":
        text = (
            "ImageDecayCorrected is true but DecayCorrection is NONE; taken as corrected: check which of them is right."
        )
        return (severe("decay-contradiction", where, text),)
    if time is None:
        text = "ImageDecayCorrectionTime is missing; the image is taken as corrected to time zero."
        return (warning("decay-time-missing", where, text),)
    if time != 0:
        factor = float(sidecar.to_time_zero(sidecar.frames)[0])
        text = f"ImageDecayCorrectionTime is {time:g} s; values are multiplied by {factor:.6g} to refer to time zero."
        return (warning("decay-time", where, text),)
    return ()


def clock(sidecar: PetSidecar) -> tuple[Remark, ...]:
    """Offsets of injection and scan start; all times stay on the clock of TimeZero, as the blood's do."""
    remarks = []
    where, injected, started = sidecar.where, sidecar.injection_start, sidecar.scan_start
    first = sidecar.frame_times_start[0]
    if injected:
        text = f"InjectionStart is {injected:g} s; frames, blood and decay stay on the clock of TimeZero."
        late = injected > sidecar.frames.end[-1] * SECONDS_PER_MINUTE
        remarks.append((severe if late else warning)("injection-start", where, text))
    if started is not None and abs(started - first) > _REFERENCE_TOLERANCE_S:
        text = f"ScanStart is {started:g} s but the first frame starts at {first:g} s; the frame times are used."
        remarks.append(note("scan-start", where, text))
    if first < 0:
        text = f"The first frame starts at {first:g} s, before time zero; activity is taken as zero until then."
        remarks.append(note("early-frame", where, text))
    return tuple(remarks)


def gaps(sidecar: PetSidecar) -> tuple[Remark, ...]:
    """Interrupted scans: legal, but worth knowing."""
    return frame_gaps(sidecar.frames)


def frame_gaps(frames: FrameSchedule) -> tuple[Remark, ...]:
    """A remark where frames leave gaps."""
    lengths = frames.gaps * SECONDS_PER_MINUTE
    where = np.flatnonzero(lengths > 0.5)
    if not where.size:
        return ()
    k = int(where[np.argmax(lengths[where])])
    text = (
        f"Frames leave {where.size} gap(s), {lengths[where].sum():g} s in all, the longest of {lengths[k]:g} s after "
        f"frame {k + 1}; an interrupted scan is legal, nothing is assumed about the counts in between."
    )
    return (warning("frame-gap", frames.where, text),)


SIDECAR_CHECKS: tuple[Callable[[PetSidecar], tuple[Remark, ...]], ...] = (
    dose,
    nuclide_spelling,
    stated_half_life,
    decay_state,
    decay_factors,
    clock,
    gaps,
)


@dataclass(frozen=True)
class OddVoxels:
    """How many values of a series are NaN, infinite or negative, of how many."""

    nan: int = 0
    infinite: int = 0
    negative: int = 0
    total: int = 0

    @classmethod
    def of(cls, values: NDArray[np.floating]) -> OddVoxels:
        """Count one frame."""
        nan = int(np.count_nonzero(np.isnan(values)))
        return cls(nan, int(np.count_nonzero(np.isinf(values))), int(np.count_nonzero(values < 0)), values.size)

    def __add__(self, other: OddVoxels) -> OddVoxels:
        mine, theirs = (
            (self.nan, self.infinite, self.negative, self.total),
            (other.nan, other.infinite, other.negative, other.total),
        )
        return OddVoxels(*(a + b for a, b in zip(mine, theirs, strict=True)))

    def remarks(self, where: str) -> tuple[Remark, ...]:
        """One sentence a kind of odd value."""
        remarks = []
        if self.nan or self.infinite:
            counts = f"{self.nan} NaN and {self.infinite} infinite values of {self.total}"
            text = f"{counts}; their voxels get a status code and no estimate."
            remarks.append(warning("voxels-not-finite", where, text))
        if self.negative:
            percent = 100 * self.negative / self.total
            share = f"{self.negative} of {self.total} values ({percent:.2g} percent)"
            text = f"{share} are negative; they are fitted as they are."
            remarks.append(note("voxels-negative", where, text))
        return tuple(remarks)
