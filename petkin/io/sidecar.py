"""The `_pet.json` beside an image: strict where a wrong number would follow, tolerant elsewhere."""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, WrapValidator
from pydantic.alias_generators import to_pascal

from petkin import units
from petkin.errors import InputError
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.imaging.decay import nuclide
from petkin.io.jsonfile import merge_json

#: Radioactivity units met in files, as factors to MBq. 1 Ci = 3.7e10 Bq (exact by definition).
MEGABECQUEREL = {"Bq": 1e-6, "kBq": 1e-3, "MBq": 1.0, "GBq": 1e3, "uCi": 0.037, "µCi": 0.037, "mCi": 37.0, "Ci": 37e3}


def _or_none(value: Any, handler: Callable[[Any], Any]) -> Any:
    """A field that no number depends on: unreadable means absent."""
    try:
        return handler(value)
    except ValidationError:
        return None


def _listed(value: Any) -> Any:
    return [value] if isinstance(value, int | float) else value


_Number = Annotated[float | None, WrapValidator(_or_none)]
_Numbers = Annotated[tuple[float, ...] | None, WrapValidator(_or_none), BeforeValidator(_listed)]
_Text = Annotated[str, BeforeValidator(lambda value: "" if value is None else str(value))]
_Given = Annotated[str, Field(min_length=1)]


class PetSidecar(BaseModel):
    """Fields of `_pet.json` that petkin uses, the file's names in snake case. Times in s, as the file has them."""

    model_config = ConfigDict(
        frozen=True, extra="ignore", allow_inf_nan=False, alias_generator=to_pascal, populate_by_name=True
    )

    frame_times_start: Annotated[tuple[float, ...], Field(min_length=1)]
    frame_duration: Annotated[tuple[float, ...], Field(min_length=1)]
    units: _Given
    tracer_radionuclide: _Given
    image_decay_corrected: bool
    image_decay_correction_time: float | None = None
    scan_start: float | None = None
    injection_start: float | None = None
    time_zero: _Text = ""
    tracer_name: _Text = ""
    mode_of_administration: _Text = ""
    injected_radioactivity: _Number = None
    injected_radioactivity_units: _Text = ""
    radionuclide_total_dose: _Number = None
    radionuclide_half_life: _Number = None
    decay_correction: _Text = ""
    decay_correction_factor: _Numbers = None
    decay_factor: _Numbers = None
    body_weight: _Number = None
    dispersion_constant_s: Annotated[_Number, Field(alias="DispersionConstant_s")] = None
    where: Annotated[str, Field(exclude=True, alias="petkin:where")] = "_pet.json"

    @property
    def frames(self) -> FrameSchedule:
        """Frames, min.

        Raises:
            InputError: they overlap, or one does not last.
        """
        return FrameSchedule.from_seconds(self.frame_times_start, self.frame_duration, where=self.where)

    @property
    def nuclide(self) -> str:
        """Radionuclide in BIDS spelling, e.g. "C11" for a file's "11C"."""
        return nuclide(self.tracer_radionuclide).symbol

    @property
    def half_life(self) -> float:
        """Half-life (min) with which values decay: the nuclide's.

        Of an image that is not corrected, it is RadionuclideHalfLife where that is stated and within a factor of two
        of the nuclide's: a simulation may let its frames decay by another law than nature's.
        """
        natural = nuclide(self.tracer_radionuclide).half_life
        stated = units.minutes(self.radionuclide_half_life or 0.0)
        return stated if not self.image_decay_corrected and natural / 2 < stated < natural * 2 else natural

    @property
    def decay_constant(self) -> float:
        """lambda of `half_life`, 1/min."""
        return units.decay_constant(self.half_life)

    def to_time_zero(self, frames: FrameSchedule) -> NDArray[np.float64]:
        """Factors (K,) that take frame values as they are stored to values decay-corrected to time zero.

        Corrected to t_ref already: e^{lam t_ref}. Not corrected: d / int_frame e^{-lam t} dt
        = lam d / (1 - e^{-lam d}) e^{lam start}, exact for a frame mean.
        """
        if self.image_decay_corrected:
            reference = units.minutes(self.image_decay_correction_time or 0.0)
            return np.full(len(frames), np.exp(self.decay_constant * reference))
        return frames.duration / FrameObservation(frames, self.decay_constant).mean_decay_times_duration

    @property
    def kbq_per_ml(self) -> float:
        """Factor that takes the image's values to kBq/mL."""
        return units.kbq_per_ml_factor(self.units, where=f"{self.where}: Units")

    @property
    def dose_mbq(self) -> float | None:
        """InjectedRadioactivity as stated, MBq; None where it or its unit is missing or unknown."""
        factor = MEGABECQUEREL.get(self.injected_radioactivity_units.strip())
        return None if factor is None or self.injected_radioactivity is None else self.injected_radioactivity * factor


def read_sidecar(paths: Path | Sequence[Path]) -> PetSidecar:
    """A `_pet.json`, or several by inheritance (top first, the last one names the scan).

    Raises:
        InputError: a field is missing or of the wrong kind, the radionuclide or unit is unknown; one line that names
            file and field.
    """
    files = [paths] if isinstance(paths, Path) else list(paths)
    where = files[-1].name
    try:
        sidecar = PetSidecar.model_validate({**merge_json(files), "petkin:where": where})
    except ValidationError as error:
        raise InputError(_one_line(error, where)) from error
    _check_frames(sidecar)
    try:
        nuclide(sidecar.tracer_radionuclide)
    except InputError as error:
        raise InputError(f"{where}: TracerRadionuclide: {error}") from error
    units.kbq_per_ml_factor(sidecar.units, where=f"{where}: Units")
    return sidecar


def _one_line(error: ValidationError, where: str) -> str:
    first = error.errors()[0]
    field = "".join(f"[{part}]" if isinstance(part, int) else str(part) for part in first["loc"])
    if first["type"] == "missing":
        return f"{where}: {field} is missing; add it to the sidecar (PET-BIDS requires it)."
    others = len({problem["loc"][0] for problem in error.errors()}) - 1
    more = f" ({others} more field(s) are wrong)" if others else ""
    return f"{where}: {field} is {reprlib.repr(first['input'])}; {first['msg'][0].lower()}{first['msg'][1:]}{more}."


def _check_frames(sidecar: PetSidecar) -> None:
    starts, durations = sidecar.frame_times_start, sidecar.frame_duration
    if len(starts) != len(durations):
        raise InputError(
            f"{sidecar.where}: {len(starts)} values in FrameTimesStart but {len(durations)} in FrameDuration."
        )
    for k, duration in enumerate(durations):
        if duration <= 0:
            raise InputError(
                f"{sidecar.where}: FrameDuration[{k}] is {duration:g} s; every frame must last longer than 0 s: "
                "correct it, or remove the frame from FrameTimesStart, FrameDuration and the image."
            )
