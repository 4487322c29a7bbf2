"""`petkin tacs`: regional curves out of images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from petkin import __version__
from petkin.errors import InputError
from petkin.io import AtomicFolder, Regions, Remark, read_regions, write_tacs
from petkin.io import descriptions as describe
from petkin.io.names import tacs_path
from petkin.study.fit_scan import Progress
from petkin.study.geometry import partial_volume
from petkin.study.outputs import require_own_folder, write_study_description
from petkin.study.reading import read_sources
from petkin.study.request import FitRequest
from petkin.study.series import extract
from petkin.study.sources import Source


def extract_tacs(request: FitRequest, progress: Progress) -> tuple[tuple[Path, ...], tuple[Remark, ...]]:
    """Mean curves over the regions of every scan's segmentation.

    Returns:
        The tables written, and what was odd about the scans.

    Raises:
        InputError: a scan without image or segmentation, or grids that differ.
    """
    progress("reading", 0.0)
    name, out, found = read_sources(request)
    sources = [_without_blood(source) for source in found]
    require_own_folder(out)
    regions = [_regions(source) for source in sources]
    written = []
    for i, source in enumerate(sources):
        progress(source.label, i / len(sources))
        written.append(_one(source, regions[i], name, out, request))
    progress("done", 1.0)
    return tuple(written), tuple(dict.fromkeys(remark for source in sources for remark in source.remarks))


def _without_blood(source: Source) -> Source:
    """The scan as far as it concerns its curves."""
    blood = set(source.blood.where.split(", ")) if source.blood is not None else set()
    return replace(
        source,
        blood=None,
        remarks=tuple(remark for remark in source.remarks if not set(remark.where.split(", ")) <= blood),
        files=tuple(file for file in source.files if file.rpartition("/")[2] not in blood),
    )


def _regions(source: Source) -> Regions:
    if source.dseg is None:
        raise InputError(f"{source.label}: curves need a segmentation (_dseg.nii.gz); give --dseg.")
    if source.image is None:
        raise InputError(f"{source.label}: there is no image (_pet.nii.gz) to take curves from.")
    return read_regions(source.dseg, source.image)


def _one(source: Source, regions: Regions, name: str, out: Path, request: FitRequest) -> Path:
    assert source.image is not None
    correction = None if request.psf is None else partial_volume(regions, source.image, request.psf)
    curves = extract(source.image, source.frames, correction.regions if correction else regions)
    assert curves is not None
    curves = correction.corrected(curves) if correction else curves
    path = tacs_path(source.entities, seg=curves.seg, pvc=curves.pvc, desc=curves.desc)
    shared = describe.provenance(
        "",
        sources=source.files,
        version=__version__,
        command=request.command_line,
        extra={"Segmentation": curves.where, **(correction.fields if correction else {})},
    )
    with AtomicFolder(out) as folder:
        write_study_description(folder, name, out=out, raw=request.target)
        write_tacs(folder.path(path), curves, describe.tacs_sidecar(shared))
    return out / path
