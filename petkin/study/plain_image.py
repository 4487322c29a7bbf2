"""A 4-D image outside BIDS, with its frame times, blood and regions in files of their own, made ready to fit."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from petkin import units
from petkin.errors import InputError
from petkin.imaging.decay import nuclide
from petkin.io import Remark, Severity, find_dseg, open_series, read_json, read_schedule, read_tacs
from petkin.io.checks import frame_gaps
from petkin.io.names import SCAN_ENTITIES, FileName
from petkin.io.remarks import warning
from petkin.study.arterial import given_blood, remarks_on_given
from petkin.study.dose import suv_factor
from petkin.study.request import FitRequest
from petkin.study.sources import Source, completed


def from_files(request: FitRequest) -> tuple[str, Path, tuple[Source, ...]]:
    """Name, folder for the results, and the one scan.

    Raises:
        InputError: frame times, radionuclide or unit are missing or contradict each other; files that cannot be used.
    """
    frames_file = _frames_file(request)
    stated = read_json(frames_file) if frames_file.suffix == ".json" else {}
    symbol = _nuclide(request, stated)
    unit, assumed = _unit(request, stated)
    frames = read_schedule(frames_file, nuclide=symbol)
    factor = units.kbq_per_ml_factor(unit, where="--units" if request.units else f"{frames_file.name}: Units")
    image = open_series(request.target, frames=frames, factors=np.full(len(frames), factor))
    blood = given_blood(request.blood)
    curves = read_tacs(request.tacs, default_unit=unit)[0] if request.tacs else None
    remarks = [*assumed, *frame_gaps(frames), *(curves.remarks if curves else ())]
    if blood is not None:
        remarks += remarks_on_given(blood, unit, frames)
    named = {k: v for k, v in FileName.parse(request.target).entities.items() if k in SCAN_ENTITIES}
    stem = re.sub(r"[^0-9A-Za-z]", "", request.target.name.partition(".")[0]) or "image"
    beside = (request.tacs, request.dseg, request.mask, request.reference_mask)
    given = (request.target, frames_file, *request.blood, *beside)
    source = Source(
        entities=named if "sub" in named else {"sub": stem},
        frames=frames,
        nuclide=symbol,
        decay=units.decay_constant(nuclide(symbol).half_life),
        blood=blood,
        image=image,
        mask=request.mask,
        dseg=find_dseg(request.dseg) if request.dseg else None,
        curves=curves,
        remarks=tuple(remark for remark in remarks if remark.severity != Severity.NOTE),
        facts=(("Radionuclide", symbol),),
        files=tuple(path.name for path in given if path),
        suv=suv_factor(request.target.name, None, None, request),
    )
    return stem, request.out or request.target.parent / f"{stem}-petkin", (completed(source, request),)


def _frames_file(request: FitRequest) -> Path:
    for option, value in (("--subject", request.subjects), ("--session", request.sessions), ("--seg", request.seg)):
        if value:
            raise InputError(f"{option} chooses within a study, but {request.target} is a file; leave it out.")
    if request.frames is None:
        raise InputError(f"{request.target}: an image outside BIDS needs its frame times: give --frames TSV or JSON.")
    return request.frames


def _nuclide(request: FitRequest, stated: Mapping[str, Any]) -> str:
    """Symbol of the radionuclide, from --isotope or the JSON of frames."""
    there = stated.get("TracerRadionuclide")
    found = {nuclide(str(name)).symbol for name in (request.nuclide, there) if name}
    if not found:
        raise InputError(f"{request.target}: an image outside BIDS needs its radionuclide: give --isotope, e.g. F18.")
    if len(found) > 1:
        raise InputError(f"--isotope is {request.nuclide} but {request.frames} says {there}; correct one of them.")
    return found.pop()


def _unit(request: FitRequest, stated: Mapping[str, Any]) -> tuple[str, list[Remark]]:
    """Unit of the image, from --units or the JSON of frames, or else kBq/mL with a remark."""
    there = stated.get("Units")
    if request.units and there and request.units.lower() != str(there).strip().lower():
        raise InputError(f"--units is {request.units} but {request.frames} says {there}; correct one of them.")
    if request.units or there:
        return str(request.units or there), []
    text = "Its unit is not stated; it is taken to be in kBq/mL: give --units if it is not."
    return "kBq/mL", [warning("image-unit-assumed", request.target.name, text)]
