"""`petkin tacs`: regional curves out of images."""

from __future__ import annotations

from pathlib import Path

from petkin import __version__
from petkin.errors import InputError
from petkin.io import AtomicFolder, read_regions, write_tacs
from petkin.io import descriptions as describe
from petkin.io.names import tacs_path
from petkin.study.fit_scan import Progress
from petkin.study.outputs import write_study_description
from petkin.study.request import FitRequest
from petkin.study.series import extract
from petkin.study.sources import Source, read_sources


def extract_tacs(request: FitRequest, progress: Progress) -> tuple[Path, ...]:
    """Mean curves over the regions of every scan's segmentation; returns the tables written.

    Raises:
        InputError: a scan without image or segmentation, or grids that differ.
    """
    name, out, sources = read_sources(request)
    written = []
    for i, source in enumerate(sources):
        progress(source.label, i / len(sources))
        written.append(_one(source, name, out, request))
    progress("done", 1.0)
    return tuple(written)


def _one(source: Source, name: str, out: Path, request: FitRequest) -> Path:
    if source.image is None or source.dseg is None:
        raise InputError(f"{source.label}: curves need an image and a segmentation; give --dseg.")
    _, curves = extract(source.image, source.frames, None, "", read_regions(source.dseg, source.image))
    assert curves is not None
    path = tacs_path(source.entities, seg=curves.seg, desc=curves.desc)
    shared = describe.provenance(
        "",
        sources=source.files,
        version=__version__,
        command=request.command_line,
        extra={"Segmentation": curves.where},
    )
    with AtomicFolder(out) as folder:
        write_study_description(folder, name)
        write_tacs(folder.path(path), curves, describe.tacs_sidecar(shared))
    return out / path
