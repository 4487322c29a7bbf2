"""A scan made ready to fit, whether it comes from a PET-BIDS study or from a few files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from petkin import units
from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.imaging.decay import nuclide
from petkin.io import (
    BloodRecord,
    Dseg,
    RegionalCurves,
    Remark,
    Scan,
    Series,
    Severity,
    find_dseg,
    open_series,
    read_blood,
    read_schedule,
    read_study,
    read_tacs,
)
from petkin.io.names import SCAN_ENTITIES, FileName, derivatives_folder, prefix
from petkin.study.request import FitRequest

_Labelled = TypeVar("_Labelled", RegionalCurves, Dseg)


@dataclass(frozen=True)
class Source:
    """One scan to fit.

    Args:
        entities: BIDS labels that name its outputs.
        frames: schedule, min.
        nuclide: symbol, e.g. "C11".
        blood: samples; None where there are none.
        image: opened series in kBq/mL at time zero, or None.
        mask: mask image, or None.
        dseg: segmentation on the image's grid, or None.
        curves: regional curves, or None to take them from image and dseg.
        remarks: what was odd.
        facts: label and value, for the report.
        files: what the results come from.
    """

    entities: dict[str, str]
    frames: FrameSchedule
    nuclide: str
    blood: BloodRecord | None
    image: Series | None
    mask: Path | None
    dseg: Dseg | None
    curves: RegionalCurves | None
    remarks: tuple[str, ...]
    facts: tuple[tuple[str, str], ...]
    files: tuple[str, ...]

    @property
    def label(self) -> str:
        return prefix(self.entities)

    @property
    def decay(self) -> float:
        """lambda, 1/min."""
        return units.decay_constant(nuclide(self.nuclide).half_life)


def read_sources(request: FitRequest) -> tuple[str, Path, tuple[Source, ...]]:
    """Name of the study, folder for its results, and its scans.

    Raises:
        InputError: nothing there, or nothing that can be fitted.
    """
    if request.target.is_dir():
        return _from_study(request)
    if not request.target.exists():
        raise InputError(f"{request.target}: no such file or folder; give a PET-BIDS study or a 4-D .nii.gz.")
    return _from_files(request)


def _from_study(request: FitRequest) -> tuple[str, Path, tuple[Source, ...]]:
    study = read_study(request.target, subjects=request.subjects or None)
    scans = [s for s in study.scans if not request.sessions or s.session in request.sessions]
    if not scans:
        raise InputError(f"{request.target}: no scan of session {', '.join(request.sessions)}; see petkin info.")
    sources = tuple(_from_scan(scan, request, study.remarks) for scan in scans)
    return study.name, request.out or derivatives_folder(study.root), sources


def _from_scan(scan: Scan, request: FitRequest, remarks: Sequence[Remark]) -> Source:
    curves = _chosen(scan.curves, request.seg, scan.prefix, "table of curves")
    dseg = find_dseg(request.dseg) if request.dseg else _chosen(scan.dseg, request.seg, scan.prefix, "segmentation")
    if request.tacs:
        curves, _ = read_tacs(request.tacs, default_unit=scan.sidecar.units)
    needed = request.level != "region" or (dseg is not None and request.tacs is None)
    image = scan.open_image() if scan.image is not None and needed else None
    blood = read_blood(request.blood) if request.blood else scan.blood
    frames = scan.frames if image is not None or curves is None else curves.frames
    noticed = tuple(str(r) for r in (*remarks, *scan.remarks) if r.severity != Severity.NOTE)
    facts = (
        ("Tracer", scan.sidecar.tracer_name or "not stated"),
        ("Radionuclide", scan.nuclide),
        ("Dose", f"{scan.sidecar.dose_mbq:.4g} MBq as stated" if scan.sidecar.dose_mbq else "not stated"),
        ("Body weight", f"{scan.body_weight:g} kg" if scan.body_weight else "not stated"),
    )
    source = Source(
        entities=dict(scan.entities),
        frames=frames,
        nuclide=scan.nuclide,
        blood=blood,
        image=image,
        mask=request.mask,
        dseg=dseg,
        curves=None if image is not None and dseg is not None and not request.tacs else curves,
        remarks=noticed,
        facts=facts,
        files=(f"bids::{scan.prefix}_pet.json",),
    )
    return _complete(source, request)


def _from_files(request: FitRequest) -> tuple[str, Path, tuple[Source, ...]]:
    if request.frames is None:
        raise InputError(f"{request.target}: an image outside BIDS needs its frame times: give --frames TSV or JSON.")
    if request.nuclide is None:
        raise InputError(f"{request.target}: an image outside BIDS needs its radionuclide: give --isotope, e.g. F18.")
    frames = read_schedule(request.frames)
    scale = units.kbq_per_ml_factor(request.units, where="--units")
    image = open_series(request.target, frames=frames, factors=np.full(len(frames), scale))
    named = {k: v for k, v in FileName.parse(request.target).entities.items() if k in SCAN_ENTITIES}
    stem = re.sub(r"[^0-9A-Za-z]", "", request.target.name.partition(".")[0]) or "image"
    source = Source(
        entities=named if "sub" in named else {"sub": stem},
        frames=frames,
        nuclide=nuclide(request.nuclide).symbol,
        blood=read_blood(request.blood) if request.blood else None,
        image=image,
        mask=request.mask,
        dseg=find_dseg(request.dseg) if request.dseg else None,
        curves=read_tacs(request.tacs, default_unit=request.units)[0] if request.tacs else None,
        remarks=(),
        facts=(("Radionuclide", nuclide(request.nuclide).symbol),),
        files=tuple(str(p.name) for p in (request.target, request.frames, request.blood) if p),
    )
    out = request.out or request.target.parent / f"{stem}-petkin"
    return stem, out, (_complete(source, request),)


def _chosen(found: Sequence[_Labelled], seg: str | None, where: str, what: str) -> _Labelled | None:
    if seg is None:
        return found[0] if found else None
    for item in found:
        if item.seg == seg:
            return item
    if not found:
        return None
    labels = ", ".join(item.seg or "(none)" for item in found)
    raise InputError(f"{where}: there is no {what} with seg-{seg}; there is {labels}.")


def _complete(source: Source, request: FitRequest) -> Source:
    if source.image is None and source.curves is None:
        raise InputError(f"{source.label}: neither an image nor a table of regional curves to fit; see petkin info.")
    if request.level == "voxel" and source.image is None:
        raise InputError(f"{source.label}: there is no image to fit by voxel; use --level region.")
    if request.level == "region" and source.curves is None and source.dseg is None:
        raise InputError(f"{source.label}: regions need --dseg or --tacs; there is neither a segmentation nor curves.")
    if source.curves is not None and len(source.curves.frames) != len(source.frames):
        raise InputError(
            f"{source.curves.where}: has {len(source.curves.frames)} frames but the image has {len(source.frames)}."
        )
    span = f"{len(source.frames)} frames, {source.frames.start[0]:g} to {source.frames.end[-1]:g} min"
    gaps = [g for g in source.frames.gaps if g > 1e-3]
    more = f", {len(gaps)} gaps of {sum(gaps):.3g} min in all" if gaps else ""
    return replace(source, facts=(*source.facts, ("Frames", span + more)))
