"""`petkin tacs`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer


def tacs(
    target: Annotated[Path, typer.Argument(help="A PET-BIDS study folder, or a 4-D image (.nii, .nii.gz).")],
    dseg: Annotated[
        Path | None, typer.Option(help="Label image on the image's grid; default: the study's own.")
    ] = None,
    seg: Annotated[str | None, typer.Option(help="Which segmentation of the study, by its seg- label.")] = None,
    frames: Annotated[
        Path | None, typer.Option(help="Frame times of an image outside BIDS: TSV or JSON, in s.")
    ] = None,
    isotope: Annotated[str | None, typer.Option(help="Radionuclide of an image outside BIDS.")] = None,
    units: Annotated[
        str | None,
        typer.Option(help="Unit of an image outside BIDS. Default: what a JSON of frames states, or kBq/mL."),
    ] = None,
    pvc: Annotated[
        str | None, typer.Option(help="gtm: correct for partial volume by the geometric transfer matrix.")
    ] = None,
    psf: Annotated[float | None, typer.Option(help="Point spread that --pvc corrects for, FWHM in mm.")] = None,
    subject: Annotated[
        list[str] | None, typer.Option(help="Only this subject (label without sub-); repeatable.")
    ] = None,
    session: Annotated[list[str] | None, typer.Option(help="Only this session; repeatable.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the results; default: derivatives/petkin.")] = None,
) -> None:
    """Extract regional time-activity curves: the mean over each region of a segmentation, frame by frame.

    Example: petkin tacs study --dseg atlas_dseg.nii.gz
    """
    from petkin.cli.parsing import labels, typed_command
    from petkin.cli.progress import progress_bar
    from petkin.study.extract import extract_tacs
    from petkin.study.request import FitRequest

    request = FitRequest(
        target=target,
        out=out,
        level="region",
        subjects=labels(subject, "sub-"),
        sessions=labels(session, "ses-"),
        seg=seg,
        dseg=dseg,
        frames=frames,
        nuclide=isotope,
        units=units,
        pvc=pvc,
        psf=psf,
        command_line=typed_command(),
    )
    with progress_bar() as step:
        written, remarks = extract_tacs(request, step)
    for remark in remarks:
        print(remark, file=sys.stderr)
    for path in written:
        print(path)
