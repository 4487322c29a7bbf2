"""What to simulate: options, and the presets behind them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from petkin.errors import InputError

#: Decay e^{-t/tau} of arXiv 2403.08194: F-18's half-life taken for its mean life, min.
PAPER_MEAN_LIFE = 110.0
NonNegative = Annotated[float, Field(ge=0)]


@dataclass(frozen=True)
class Preset:
    """Defaults that hang together.

    Args:
        tracer: population of kinetics.
        mean_life: tau of the decay, min; None takes the nuclide's own.
        corrected: whether frame values are corrected for decay.
        noise: percent, see `petkin.imaging.CountingNoise`.
    """

    tracer: str
    mean_life: float | None
    corrected: bool
    noise: float


PRESETS = {
    "paper": Preset("paper", PAPER_MEAN_LIFE, corrected=False, noise=0.0),
    "physical": Preset("reversible", None, corrected=True, noise=5.0),
}


class SimulationSettings(BaseModel):
    """Options of a simulated study; None takes what the preset, the tracer or the phantom has.

    Attributes:
        out: folder of the study; it must not hold anything yet.
        preset: "physical", or "paper" for the observation of arXiv 2403.08194 (not decay-corrected, tau = 110 min).
        subjects: how many.
        sessions: how many scans each; above 1 they differ as test and retest do.
        phantom: name, or a .toml file.
        roi: number of regions, picks the phantom that has as many.
        voxel_size: mm.
        subsamples: points an axis in each voxel; above 1, regions share border voxels in fractions.
        tracer: name of a population, or a .toml file.
        isotope: radionuclide.
        model: label of the tissue model.
        frames: count, name, compact text, or a .tsv or .json file.
        noise: percent.
        noise_common: share of the noise variance that all voxels of a frame have in common.
        noise_fwhm: spatial correlation of the noise, mm.
        psf: FWHM of the point spread, mm.
        voxel_spread: whether kinetics vary between the voxels of a region.
        effects: "NAME=VALUE", injected into the image and not into the blood record.
        blood_noise: percent of each blood sample.
        sampler_dispersion: time constant of the autosampler's line, s, left in its record.
        units: of the image.
        truth_tacs: whether to write noise-free curves too.
        seed: of all randomness.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    out: Path
    preset: Literal["physical", "paper"] = "physical"
    subjects: Annotated[int, Field(ge=1, le=9999)] = 1
    sessions: Annotated[int, Field(ge=1, le=99)] = 1
    phantom: str | None = None
    roi: int | None = None
    voxel_size: float | None = None
    subsamples: Annotated[int, Field(ge=1, le=8)] = 1
    tracer: str | None = None
    isotope: str | None = None
    model: str | None = None
    frames: str | None = None
    noise: NonNegative | None = None
    noise_common: Annotated[float, Field(ge=0, le=1)] = 0.0
    noise_fwhm: NonNegative = 0.0
    psf: NonNegative = 0.0
    voxel_spread: bool = False
    effects: tuple[str, ...] = ()
    blood_noise: NonNegative = 0.0
    sampler_dispersion: Annotated[float, Field(ge=0, le=60)] = 0.0
    units: Literal["Bq/mL", "kBq/mL"] = "Bq/mL"
    truth_tacs: bool = False
    seed: Annotated[int, Field(ge=0)] = 0


def read_settings(**options: object) -> SimulationSettings:
    """Settings from options.

    Raises:
        InputError: an option of the wrong kind or out of range; one line that names it.
    """
    try:
        return SimulationSettings.model_validate(options)
    except ValidationError as error:
        first = error.errors()[0]
        option = "--" + str(first["loc"][0]).replace("_", "-")
        said = f"{first['msg'][0].lower()}{first['msg'][1:]}"
        raise InputError(f"{option} {first['input']!r}: {said}.") from error
