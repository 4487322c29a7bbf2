"""What a user asks of `petkin fit`, checked at the border."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from petkin.errors import InputError
from petkin.fitting import Choices

LEVELS = ("both", "region", "voxel")
OBSERVATIONS = ("frame", "plain", "mid")


@dataclass(frozen=True)
class FitRequest:
    """One call of `petkin fit`.

    Args:
        target: a PET-BIDS study, or a 4-D image.
        out: folder for the results; None: `derivatives/petkin` of the study, or beside the image.
        models: labels.
        choices: bounds, fixed values, rates, t*.
        level: both, region or voxel.
        subjects, sessions: labels to fit; empty for all.
        seg: which segmentation or table of curves, by its label; None for the first.
        blood, frames, mask, dseg, tacs: files for an image outside BIDS, or instead of the study's.
        nuclide: radionuclide of an image outside BIDS.
        units: activity unit of an image outside BIDS.
        delay: "estimate", or minutes.
        weights: "counting", "constant", or a table with a column `weight`.
        observation: "frame" (decay-weighted mean), "plain" (time average) or "mid" (value at mid-frame).
        parent_fraction: model of the parent fraction.
        plasma_from: "plasma", or "whole_blood" where no plasma was measured.
        dispersion_s: time constant to correct autosampler blood for, s; None takes what the files state.
        command_line: what was typed, for the sidecars.
    """

    target: Path
    out: Path | None = None
    models: tuple[str, ...] = ("2TCM",)
    choices: Choices = field(default_factory=Choices)
    level: str = "both"
    subjects: tuple[str, ...] = ()
    sessions: tuple[str, ...] = ()
    seg: str | None = None
    blood: Path | None = None
    frames: Path | None = None
    mask: Path | None = None
    dseg: Path | None = None
    tacs: Path | None = None
    nuclide: str | None = None
    units: str = "kBq/mL"
    delay: str | float = "estimate"
    weights: str = "counting"
    observation: str = "frame"
    parent_fraction: str = "auto"
    plasma_from: str = "plasma"
    dispersion_s: float | None = None
    command_line: str = ""

    def __post_init__(self) -> None:
        _one_of("level", self.level, LEVELS)
        _one_of("observation", self.observation, OBSERVATIONS)
        if not self.models:
            raise InputError("No model was given; choose at least one, e.g. --model 2TCM.")
        if isinstance(self.delay, str) and self.delay != "estimate":
            raise InputError(f"The delay is {self.delay!r}; give 'estimate' or a number of minutes.")


def _one_of(name: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise InputError(f"--{name} is {value!r}; choose one of {', '.join(allowed)}.")
