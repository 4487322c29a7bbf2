"""A scan made ready to fit, wherever it comes from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.io import BloodRecord, Dseg, PetSidecar, RegionalCurves, Remark, Series
from petkin.io.names import prefix
from petkin.study.request import FitRequest
from petkin.units import SECONDS_PER_MINUTE

#: Frames of an image and of a table of curves may be rounded differently by this much, s.
_SAME_FRAME_S = 1.0
#: Gaps below this (min) are rounding.
_GAP = 1e-3


@dataclass(frozen=True)
class Source:
    """One scan to fit.

    Args:
        entities: BIDS labels that name its outputs.
        frames: schedule, min.
        nuclide: symbol, e.g. "C11".
        decay: lambda of the values before their correction, 1/min.
        blood: samples; None where there are none.
        image: opened series in kBq/mL at time zero, or None.
        mask: mask image, or None.
        dseg: segmentation on the image's grid, or None.
        curves: regional curves, or None to take them from image and dseg.
        remarks: what was odd.
        facts: label and value, for the report.
        files: what the results come from.
        suv: body weight over injected dose, g/kBq, where it was asked for.
        sidecar: its `_pet.json`; None of files outside a study.
    """

    entities: dict[str, str]
    frames: FrameSchedule
    nuclide: str
    decay: float
    blood: BloodRecord | None
    image: Series | None
    mask: Path | None
    dseg: Dseg | None
    curves: RegionalCurves | None
    remarks: tuple[Remark, ...]
    facts: tuple[tuple[str, str], ...]
    files: tuple[str, ...]
    suv: float | None = None
    sidecar: PetSidecar | None = None

    @property
    def label(self) -> str:
        """Start of its file names."""
        return prefix(self.entities)

    @property
    def segmented(self) -> tuple[Series, Dseg] | None:
        """Its image and the segmentation that its regional curves are means over; None where those are a table."""
        if self.image is None or self.dseg is None or self.curves is not None:
            return None
        return self.image, self.dseg


def completed(source: Source, request: FitRequest) -> Source:
    """The source with what all have in common, once it holds what was asked for.

    Raises:
        InputError: what is to be fitted is not there, or image and curves do not share their frames.
    """
    label = source.label
    if source.image is None and (request.dseg or request.mask):
        option = "--dseg" if request.dseg else "--mask"
        raise InputError(
            f"{label}: {option} lies on an image and there is none; regional curves are fitted without it."
        )
    if request.level == "voxel" and source.image is None:
        raise InputError(f"{label}: there is no image to fit by voxel; use --level region.")
    if request.shared_by_regions and source.image is not None and request.level != "region":
        raise InputError(f"{label}: {request.shared_by_regions} fits regions alone; add --level region.")
    if request.level == "region" and source.curves is None and source.dseg is None:
        raise InputError(
            f"{label}: regions need a segmentation (_dseg.nii.gz) or a table of curves (_tacs.tsv) in the study, or "
            "--dseg or --tacs where the command takes them; there is neither a segmentation nor curves."
        )
    if source.image is None and source.curves is None:
        raise InputError(f"{label}: neither an image nor a table of regional curves to fit; see petkin info.")
    _require_geometry(source, request)
    if source.curves is not None and source.image is not None:
        _require_same_frames(source.curves, source.frames)
    return replace(source, facts=(*source.facts, ("Frames", _span(source.frames))))


def _require_geometry(source: Source, request: FitRequest) -> None:
    if request.hypr is not None and source.image is None:
        raise InputError(f"{source.label}: --hypr denoises an image and there is none; leave it out.")
    if request.pvc is not None and source.segmented is None:
        raise InputError(
            f"{source.label}: --pvc needs an image and a segmentation (--dseg) of it; a table of curves does not tell "
            "where its regions lie."
        )


def _require_same_frames(curves: RegionalCurves, frames: FrameSchedule) -> None:
    if len(curves.frames) != len(frames):
        raise InputError(f"{curves.where}: has {len(curves.frames)} frames but the image has {len(frames)}.")
    edges = np.stack([curves.frames.start - frames.start, curves.frames.end - frames.end])
    off_s = float(np.abs(edges).max()) * SECONDS_PER_MINUTE
    if off_s > _SAME_FRAME_S:
        raise InputError(
            f"{curves.where}: its frame times differ by up to {off_s:.3g} s from the image's; correct them, or fit the "
            "curves alone with --level region."
        )


def _span(frames: FrameSchedule) -> str:
    gaps = [gap for gap in frames.gaps if gap > _GAP]
    more = f", {len(gaps)} gap{'s' if len(gaps) > 1 else ''} of {sum(gaps):.3g} min in all" if gaps else ""
    return f"{len(frames)} frames, {frames.start[0]:g} to {frames.end[-1]:g} min{more}"
