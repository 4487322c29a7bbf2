"""From what a user points at, a PET-BIDS study or a few files, to scans made ready to fit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

from petkin.errors import InputError
from petkin.io import (
    BloodRecord,
    Dseg,
    RegionalCurves,
    Remark,
    Scan,
    Severity,
    find_dseg,
    read_study,
    read_tacs,
)
from petkin.io.names import derivatives_folder, image_path, scan_folder, sidecar_path
from petkin.study.arterial import given_blood, remarks_on_given
from petkin.study.dose import suv_factor
from petkin.study.plain_image import from_files
from petkin.study.request import FitRequest
from petkin.study.sources import Source, completed

_Labelled = TypeVar("_Labelled", RegionalCurves, Dseg)
#: What BIDS calls the dataset that petkin's results come from, see DatasetLinks in dataset_description.json.
_RAW = "bids:raw:"


def read_sources(request: FitRequest) -> tuple[str, Path, tuple[Source, ...]]:
    """Name of the study, folder for its results, and its scans.

    Raises:
        InputError: nothing there, or nothing that can be fitted; options that do not go with the target.
    """
    if request.target.is_dir():
        return _from_study(request)
    if not request.target.exists():
        raise InputError(f"{request.target}: no such file or folder; give a PET-BIDS study or a 4-D .nii.gz.")
    return from_files(request)


def _from_study(request: FitRequest) -> tuple[str, Path, tuple[Source, ...]]:
    for option, value in (("--frames", request.frames), ("--isotope", request.nuclide), ("--units", request.units)):
        if value is not None:
            raise InputError(
                f"{option} is for an image outside BIDS; a study states it in _pet.json: correct it there."
            )
    study = read_study(request.target, subjects=request.subjects or None)
    scans = [s for s in study.scans if not request.sessions or s.session in request.sessions]
    if not scans:
        raise InputError(f"{request.target}: no scan of session {', '.join(request.sessions)}; see petkin info.")
    for option, value in (("--blood", request.blood), ("--tacs", request.tacs)):
        if value and len(scans) > 1:
            raise InputError(
                f"{option} belongs to one scan but there are {len(scans)}; choose with --subject, --session."
            )
    sources = tuple(_from_scan(scan, request, study.remarks) for scan in scans)
    return study.name, request.out or derivatives_folder(study.root), sources


def _from_scan(scan: Scan, request: FitRequest, of_study: Sequence[Remark]) -> Source:
    curves, dseg = _regions(scan, request)
    needed = request.level != "region" or (dseg is not None and request.tacs is None)
    image = scan.open_image() if scan.image is not None and needed else None
    blood = given_blood(request.blood) or scan.blood
    if request.level == "voxel" or (image is not None and dseg is not None and request.tacs is None):
        curves = None
    frames = scan.frames if image is not None or curves is None else curves.frames
    remarks = [*of_study, *_of_used(scan, curves, blood)]
    if request.blood and blood is not None:
        remarks += remarks_on_given(blood, scan.sidecar.units, frames)
    if request.tacs and curves is not None:
        remarks += curves.remarks
    source = Source(
        entities=dict(scan.entities),
        frames=frames,
        nuclide=scan.nuclide,
        decay=scan.sidecar.decay_constant,
        blood=blood,
        image=image,
        mask=request.mask,
        dseg=dseg,
        curves=curves,
        remarks=tuple(remark for remark in remarks if remark.severity != Severity.NOTE),
        facts=_facts(scan),
        files=tuple(_files(scan, request, image=image is not None, curves=curves)),
        suv=suv_factor(scan.prefix, scan.sidecar, scan.body_weight, request),
        sidecar=scan.sidecar,
    )
    return completed(source, request)


def _regions(scan: Scan, request: FitRequest) -> tuple[RegionalCurves | None, Dseg | None]:
    """The table of curves and the segmentation to use: as given, else by --seg, else the first of each."""
    labels = list(dict.fromkeys(item.seg for item in (*scan.curves, *scan.dseg)))
    if request.seg is not None and labels and request.seg not in labels:
        named = ", ".join(label or "(none)" for label in labels)
        raise InputError(
            f"{scan.prefix}: there is no segmentation or table of curves {request.seg!r}; there is {named}."
        )
    dseg = find_dseg(request.dseg) if request.dseg else _chosen(scan.dseg, request.seg)
    curves = read_tacs(request.tacs, image=scan.sidecar)[0] if request.tacs else _chosen(scan.curves, request.seg)
    return curves, dseg


def _chosen(found: Sequence[_Labelled], seg: str | None) -> _Labelled | None:
    return next((item for item in found if seg is None or item.seg == seg), None)


def _of_used(scan: Scan, curves: RegionalCurves | None, blood: BloodRecord | None) -> list[Remark]:
    """Remarks on the scan without those on curves and blood that are there but not used."""
    aside = {remark for table in scan.curves if table is not curves for remark in table.remarks}
    if scan.blood is not None and blood is not scan.blood:
        aside |= {r for r in scan.remarks if r in scan.blood.remarks or r.where == scan.blood.where}
    return [remark for remark in scan.remarks if remark not in aside]


def _facts(scan: Scan) -> tuple[tuple[str, str], ...]:
    dose = scan.sidecar.dose_mbq
    return (
        ("Tracer", scan.sidecar.tracer_name or "not stated"),
        ("Radionuclide", scan.nuclide),
        ("Dose", f"{dose:.4g} MBq as stated" if dose else "not stated"),
        ("Body weight", f"{scan.body_weight:g} kg" if scan.body_weight else "not stated"),
    )


def _files(scan: Scan, request: FitRequest, *, image: bool, curves: RegionalCurves | None) -> list[str]:
    """What the results of a scan come from, as BIDS URIs or, of files given beside the study, their names."""
    folder = scan_folder(scan.entities)
    files = [f"{_RAW}{sidecar_path(image_path(scan.entities))}"]
    if image and scan.image is not None:
        files.append(f"{_RAW}{folder / scan.image.name}")
    if not request.blood and scan.blood is not None:
        files += [f"{_RAW}{folder / name}" for name in scan.blood.where.split(", ")]
    if curves is not None and request.tacs is None:
        files.append(curves.where)
    beside = (*request.blood, request.tacs, request.dseg, request.mask, request.reference_mask)
    return files + [path.name for path in beside if path]
