"""What a user asks of `petkin fit`, checked at the border."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from petkin.errors import InputError
from petkin.fitting import Choices, Need, Resampling
from petkin.inputs import PARENT_FRACTION_MODELS
from petkin.methods import Method, check_choices, find_method

LEVELS = ("both", "region", "voxel")
OBSERVATIONS = ("frame", "plain", "mid")
PARENT_FRACTIONS = ("auto", *PARENT_FRACTION_MODELS, "interpolated", "none")
CORRECTIONS = ("gtm",)
PLASMA_SOURCES = ("plasma", "whole_blood")
#: What --share calls the delay of the input, and what --delay and --dispersion call for.
DELAY, ESTIMATE = "delay", "estimate"
#: Longer delays (min) are times in another unit, or blood of another clock.
_LONGEST_DELAY = 5.0


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
        blood: recordings (manual, autosampler) of an image outside BIDS, or instead of the study's.
        frames, mask, dseg, tacs: files for an image outside BIDS, or instead of the study's.
        nuclide: radionuclide of an image outside BIDS.
        units: activity unit of an image outside BIDS; None takes what a JSON of frames states, or else kBq/mL.
        delay: "estimate", or minutes.
        share_delay: estimate the delay from all regions at once instead of the whole brain.
        weights: "counting", "constant", or a table with a column `weight`.
        until: min; frames that end later are forecast, not fitted. None fits all.
        observation: "frame" (decay-weighted mean), "plain" (time average) or "mid" (value at mid-frame).
        parent_fraction: model of the parent fraction.
        plasma_from: "plasma", or "whole_blood" where no plasma was measured.
        hypr: FWHM of the kernel (mm) that denoises the image by HYPR-LR before voxels are fitted; None for none.
        pvc: "gtm" to correct regional curves for partial volume by the geometric transfer matrix; None for not.
        psf: FWHM of the point spread (mm) that `pvc` corrects for.
        dispersion_s: time constant to correct autosampler blood for, s; None takes what the files state.
        estimate_dispersion: look for it together with the delay.
        reference: names of the regions that make up the reference region.
        reference_mask: image that is above 0 there, instead.
        dose: MBq; or "stated" or "total", which field of the sidecar to believe; None where they agree.
        body_weight: kg; None takes what the study states.
        profiles: regions whose profile likelihoods are wanted, each with a symbol, or "" for all.
        bootstrap: resampling of the regional curves, or None.
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
    blood: tuple[Path, ...] = ()
    frames: Path | None = None
    mask: Path | None = None
    dseg: Path | None = None
    tacs: Path | None = None
    nuclide: str | None = None
    units: str | None = None
    delay: str | float = "estimate"
    share_delay: bool = False
    weights: str = "counting"
    until: float | None = None
    observation: str = "frame"
    parent_fraction: str = "auto"
    plasma_from: str = "plasma"
    dispersion_s: float | None = None
    estimate_dispersion: bool = False
    reference: tuple[str, ...] = ()
    reference_mask: Path | None = None
    dose: str | float | None = None
    body_weight: float | None = None
    hypr: float | None = None
    pvc: str | None = None
    psf: float | None = None
    profiles: tuple[tuple[str, str], ...] = ()
    bootstrap: Resampling | None = None
    command_line: str = ""

    def __post_init__(self) -> None:
        _one_of("level", self.level, LEVELS)
        _one_of("observation", self.observation, OBSERVATIONS)
        _one_of("parent-fraction", self.parent_fraction, PARENT_FRACTIONS)
        _one_of("plasma-from", self.plasma_from, PLASMA_SOURCES)
        if not self.models:
            raise InputError("No model was given; choose at least one, e.g. --model 2TCM.")
        object.__setattr__(self, "models", tuple(dict.fromkeys(find_method(label).label for label in self.models)))
        check_choices(self.methods, self.choices)
        _check_numbers(self)
        _check_reference(self)
        _check_dose(self)
        _check_geometry(self)
        _check_certainty(self)

    @property
    def methods(self) -> tuple[Method, ...]:
        """What the models' labels stand for."""
        return tuple(find_method(label) for label in self.models)

    @property
    def shared_by_regions(self) -> str:
        """What of the request needs all regions of a scan at once and no voxels; "" for nothing."""
        labels = [method.label for method in self.methods if method.regions_only]
        return next(iter((*labels, *(f"--share {symbol}" for symbol in self.choices.share))), "")

    def needs(self, need: Need) -> bool:
        """Whether one of the models cannot do without it."""
        return any(need in method.needs for method in self.methods)


def _one_of(name: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise InputError(f"--{name} is {value!r}; choose one of {', '.join(allowed)}.")


def _check_numbers(request: FitRequest) -> None:
    delay, t_star, dispersion = request.delay, request.choices.t_star, request.dispersion_s
    if isinstance(delay, str) and delay != "estimate":
        raise InputError(f"The delay is {delay!r}; give 'estimate' or a number of minutes.")
    if not isinstance(delay, str) and not abs(delay) <= _LONGEST_DELAY:
        raise InputError(
            f"--delay is {60 * delay:g} s; blood and brain are at most {60 * _LONGEST_DELAY:g} s apart: give seconds."
        )
    if request.estimate_dispersion and not isinstance(delay, str):
        raise InputError("--dispersion estimate looks for the delay as well; drop --delay.")
    if request.share_delay and not isinstance(delay, str):
        raise InputError(f"The delay is given ({60 * delay:g} s) and to be shared; drop --delay or --share delay.")
    twice = sorted(set(request.choices.bounds) & set(request.choices.fixed))
    if twice:
        raise InputError(f"{twice[0]} is given to --fix and to --bounds; hold it or bound it.")
    if request.choices.bounds.get("vB", (0.0, 1.0))[1] > 1.0:
        raise InputError(f"Bounds of vB reach {request.choices.bounds['vB'][1]:g}; a fraction of volume is at most 1.")
    if request.until is not None and not 0 < request.until < math.inf:
        raise InputError(f"--until is {request.until:g}; give minutes from injection, above 0.")
    if t_star is not None and not 0 <= t_star < math.inf:
        raise InputError(f"--t-star is {t_star:g}; give minutes from injection, 0 or more.")
    if dispersion is not None and not 0 <= dispersion < math.inf:
        raise InputError(f"--dispersion is {dispersion:g}; give a time constant in seconds, 0 or more.")


def _check_reference(request: FitRequest) -> None:
    given = [o for o, v in (("--reference", request.reference), ("--reference-mask", request.reference_mask)) if v]
    if len(given) > 1:
        raise InputError("The reference region is given by --reference and by --reference-mask; choose one of them.")
    asking = [method.label for method in request.methods if Need.REFERENCE in method.needs]
    if asking and not given:
        raise InputError(
            f"{asking[0]} needs a reference region: give --reference NAME (of a region) or --reference-mask FILE."
        )
    if given and not asking:
        raise InputError(f"{given[0]} is given but none of {', '.join(request.models)} uses a reference region.")


def _check_certainty(request: FitRequest) -> None:
    if not (request.profiles or request.bootstrap is not None or request.choices.certify):
        return
    compartments = [m.nonlinear(request.choices, False).model for m in request.methods if m.nonlinear is not None]
    for option, asked in (("--profile", bool(request.profiles)), ("--certify", request.choices.certify)):
        if asked and not compartments:
            raise InputError(f"{option} is for compartment models; {', '.join(request.models)} is none.")
    if request.level == "voxel" and (request.profiles or request.bootstrap is not None):
        option = "--profile" if request.profiles else "--bootstrap"
        raise InputError(f"{option} is for regions, and --level voxel leaves them out.")
    if request.level == "region" and request.choices.certify:
        raise InputError("--certify is for voxels, which --level region leaves out; regions are always certified.")
    if request.profiles and request.choices.share:
        raise InputError("--profile looks at regions one by one; leave --share out.")
    known = dict.fromkeys(quantity.symbol for model in compartments for quantity in model.quantities)
    for region, symbol in request.profiles:
        if symbol and symbol not in known:
            raise InputError(f"--profile {region}:{symbol}: there is no {symbol!r}; choose from {', '.join(known)}.")


def _check_dose(request: FitRequest) -> None:
    dose, weight = request.dose, request.body_weight
    if isinstance(dose, str):
        _one_of("dose", dose, ("stated", "total"))
    elif dose is not None and not 0 < dose < math.inf:
        raise InputError(f"--dose is {dose:g}; give the injected activity in MBq, above 0.")
    if weight is not None and not 0 < weight < math.inf:
        raise InputError(f"--body-weight is {weight:g}; give kg, above 0.")


def _check_geometry(request: FitRequest) -> None:
    for option, value in (("hypr", request.hypr), ("psf", request.psf)):
        if value is not None and not 0 < value < math.inf:
            raise InputError(f"--{option} is {value:g}; give a full width at half maximum in mm, above 0.")
    if request.hypr is not None and request.level == "region":
        raise InputError("--hypr denoises voxels, and --level region fits none; leave one of them out.")
    if request.pvc is not None:
        _one_of("pvc", request.pvc, CORRECTIONS)
        if request.level == "voxel":
            raise InputError("--pvc corrects regional curves, and --level voxel fits none; leave one of them out.")
        if request.reference_mask is not None:
            raise InputError(
                "--pvc corrects the regions of a segmentation: name the reference by --reference, no mask."
            )
    if (request.pvc is None) != (request.psf is None):
        raise InputError("--pvc gtm and --psf go together: what is corrected for, and its width (FWHM) in mm.")
