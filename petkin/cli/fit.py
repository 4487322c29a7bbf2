"""`petkin fit`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_INPUT, _MODEL, _OUTPUT = "What is fitted", "How it is fitted", "Where results go"
_SURE = "How sure"
_RUN = "How it is run (changes no result)"
_GEOMETRY = "Noise and resolution"


def fit(
    target: Annotated[Path, typer.Argument(help="A PET-BIDS study folder, or a 4-D image (.nii, .nii.gz).")],
    model: Annotated[
        list[str],
        typer.Option(
            "--model",
            "-m",
            help="1TCM, 2TCM, Logan, ...: `petkin models` lists all; repeat it to compare.",
            rich_help_panel=_MODEL,
        ),
    ] = ["2TCM"],  # noqa: B006 (typer reads it once)
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the results. Default: derivatives/petkin inside the study.", rich_help_panel=_OUTPUT
        ),
    ] = None,
    level: Annotated[str, typer.Option(help="both, region or voxel.", rich_help_panel=_INPUT)] = "both",
    subject: Annotated[
        list[str] | None,
        typer.Option(help="Only this subject (label without sub-); repeatable.", rich_help_panel=_INPUT),
    ] = None,
    session: Annotated[
        list[str] | None, typer.Option(help="Only this session; repeatable.", rich_help_panel=_INPUT)
    ] = None,
    seg: Annotated[
        str | None,
        typer.Option(help="Which segmentation or table of curves, by its seg- label.", rich_help_panel=_INPUT),
    ] = None,
    blood: Annotated[
        list[Path] | None,
        typer.Option(
            help="Blood table: time (s), plasma_radioactivity, ... or a ready AIF column; one a recording.",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    frames: Annotated[
        Path | None,
        typer.Option(help="Frame times of an image outside BIDS: TSV or JSON, in s.", rich_help_panel=_INPUT),
    ] = None,
    isotope: Annotated[
        str | None, typer.Option(help="Radionuclide of an image outside BIDS, e.g. F18, C11.", rich_help_panel=_INPUT)
    ] = None,
    units: Annotated[
        str | None,
        typer.Option(
            help="Unit of an image outside BIDS. Default: what a JSON of frames states, or kBq/mL.",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    mask: Annotated[
        Path | None, typer.Option(help="Voxels to fit: an image that is 1 there.", rich_help_panel=_INPUT)
    ] = None,
    dseg: Annotated[
        Path | None, typer.Option(help="Regions: a label image on the image's grid.", rich_help_panel=_INPUT)
    ] = None,
    tacs: Annotated[
        Path | None,
        typer.Option(help="Regional curves: a table with frame_start, frame_end (s).", rich_help_panel=_INPUT),
    ] = None,
    reference: Annotated[
        list[str] | None,
        typer.Option(
            help="Region without specific binding, by name; repeatable (mean by volume).", rich_help_panel=_INPUT
        ),
    ] = None,
    reference_mask: Annotated[
        Path | None,
        typer.Option("--reference-mask", help="The same as an image that is 1 there.", rich_help_panel=_INPUT),
    ] = None,
    dose: Annotated[
        str | None,
        typer.Option(
            help="Injected dose for SUV: MBq, or which field of the sidecar to believe: stated or total.",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    body_weight: Annotated[
        float | None,
        typer.Option("--body-weight", help="Body weight for SUV, kg. Default: the study's.", rich_help_panel=_INPUT),
    ] = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(help="What petkin train learned, for --model hybrid.", rich_help_panel=_MODEL),
    ] = None,
    bounds: Annotated[
        list[str] | None, typer.Option(help="Bounds of a parameter, e.g. K1=0:2; repeatable.", rich_help_panel=_MODEL)
    ] = None,
    fix: Annotated[
        list[str] | None, typer.Option(help="Hold a parameter, e.g. vB=0.05; repeatable.", rich_help_panel=_MODEL)
    ] = None,
    rates: Annotated[
        str,
        typer.Option(
            help="Interval of the rates of the exponentials, 1/min. A higher lower end steadies VT of noisy voxels.",
            rich_help_panel=_MODEL,
        ),
    ] = "0.001:5",
    t_star: Annotated[
        str,
        typer.Option(
            "--t-star",
            help="Methods that hold late use frames after this, min; auto: told by the regions of each scan.",
            rich_help_panel=_MODEL,
        ),
    ] = "30",
    window: Annotated[
        str | None,
        typer.Option(
            help="SUV and SUVR average frames in START:END, min. Default: from t* to the end.", rich_help_panel=_MODEL
        ),
    ] = None,
    hypr: Annotated[
        float | None,
        typer.Option(help="Denoise voxels by HYPR-LR with a kernel of this FWHM, mm.", rich_help_panel=_GEOMETRY),
    ] = None,
    pvc: Annotated[
        str | None,
        typer.Option(
            help="gtm: correct regional curves for partial volume by the geometric transfer matrix.",
            rich_help_panel=_GEOMETRY,
        ),
    ] = None,
    psf: Annotated[
        float | None,
        typer.Option(help="Point spread that --pvc corrects for, FWHM in mm.", rich_help_panel=_GEOMETRY),
    ] = None,
    share: Annotated[
        list[str] | None,
        typer.Option(
            help="One value for all regions: a parameter (k4, VND, ...), or delay; repeatable.",
            rich_help_panel=_MODEL,
        ),
    ] = None,
    delay: Annotated[
        str,
        typer.Option(help="Blood-to-brain delay: estimate (from the whole brain), or seconds.", rich_help_panel=_MODEL),
    ] = "estimate",
    weights: Annotated[
        str, typer.Option(help="counting, constant, or a table with a column 'weight'.", rich_help_panel=_MODEL)
    ] = "counting",
    until: Annotated[
        float | None,
        typer.Option(
            metavar="MIN", help="Fit frames that end by then; forecast the later ones.", rich_help_panel=_MODEL
        ),
    ] = None,
    observation: Annotated[
        str,
        typer.Option(
            help="frame: decay-weighted frame mean; plain: time average; mid: mid-frame value.", rich_help_panel=_MODEL
        ),
    ] = "frame",
    parent_fraction: Annotated[
        str,
        typer.Option(
            "--parent-fraction",
            help="auto, hill, power, exponential, sigmoid, interpolated or none.",
            rich_help_panel=_MODEL,
        ),
    ] = "auto",
    plasma_from: Annotated[
        str,
        typer.Option(
            "--plasma-from", help="plasma, or whole_blood where no plasma was measured.", rich_help_panel=_MODEL
        ),
    ] = "plasma",
    dispersion: Annotated[
        str | None,
        typer.Option(
            help="Time constant (s) of the autosampler's line, or estimate; default: what the files state.",
            rich_help_panel=_MODEL,
        ),
    ] = None,
    memory: Annotated[
        str | None,
        typer.Option(
            help="What petkin may hold, e.g. 4G; the rest waits on disk. Default: half of what is free.",
            rich_help_panel=_RUN,
        ),
    ] = None,
    workers: Annotated[
        int, typer.Option(help="Processes on this machine that fit scans side by side.", rich_help_panel=_RUN)
    ] = 0,
    scheduler: Annotated[
        str,
        typer.Option(help="Address of a dask scheduler that you trust, e.g. tcp://head:8786.", rich_help_panel=_RUN),
    ] = "",
    device: Annotated[
        str | None,
        typer.Option(
            help="Where torch searches voxels of 1TCM, 2TCM and 2TCM3k, e.g. cuda; equal within rounding. "
            "Default: compiled code on the CPU.",
            rich_help_panel=_RUN,
        ),
    ] = None,
    again: Annotated[
        bool, typer.Option("--again", "--force", help="Fit scans again that are finished.", rich_help_panel=_RUN)
    ] = False,
    profile: Annotated[
        list[str] | None,
        typer.Option(
            help="Profile likelihood of REGION or REGION:SYMBOL, e.g. putamen:VT; repeatable.", rich_help_panel=_SURE
        ),
    ] = None,
    bootstrap: Annotated[
        int | None,
        typer.Option(help="Parametric bootstrap of the regions: how many resamples.", rich_help_panel=_SURE),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the bootstrap's noise.", rich_help_panel=_SURE)] = 0,
    certify: Annotated[
        bool,
        typer.Option(
            "--certify", help="Prove of every voxel how far from the best of all fits it can be.", rich_help_panel=_SURE
        ),
    ] = False,
) -> None:
    """Fit kinetic models by voxel and by region; write maps, tables and a report.

    Model curves are compared with the data as frame means, by weighted least squares. Every estimate comes with its
    percent standard error and a status that says why it is missing or doubtful.

    Examples:

      petkin fit study --model 2TCM

      petkin fit pet.nii.gz --blood blood.tsv --frames frames.json --isotope F18 --mask brain.nii.gz --model 2TCM3k
    """
    from petkin.cli.loading import loading

    with loading():
        from petkin.cli.parsing import (
            bounds_by_symbol,
            delay_in_minutes,
            dose_in_mbq,
            interval,
            labels,
            memory_size,
            minutes_or_auto,
            numbers_by_symbol,
            regions_and_symbols,
            seconds,
            typed_command,
        )
        from petkin.cli.progress import progress_bar
        from petkin.cli.tell import tell_fits
        from petkin.fitting import Choices, Resampling
        from petkin.study.fit import fit_study
        from petkin.study.request import DELAY, ESTIMATE, FitRequest
        from petkin.study.resources import Execution

    choices = Choices(
        bounds=bounds_by_symbol(bounds or [], option="--bounds"),
        fixed=numbers_by_symbol(fix or [], option="--fix"),
        rate_bounds=interval(rates, option="--rates"),
        t_star=minutes_or_auto(t_star, option="--t-star"),
        window=None if window is None else interval(window, option="--window"),
        share=tuple(dict.fromkeys(s for s in share or () if s != DELAY)),
        certify=certify,
        device=device,
        checkpoint=checkpoint,
    )
    request = FitRequest(
        target=target,
        out=out,
        models=tuple(dict.fromkeys(model)),
        choices=choices,
        level=level,
        subjects=labels(subject, "sub-"),
        sessions=labels(session, "ses-"),
        seg=seg,
        blood=tuple(blood or ()),
        frames=frames,
        mask=mask,
        dseg=dseg,
        tacs=tacs,
        nuclide=isotope,
        units=units,
        delay=delay_in_minutes(delay),
        share_delay=DELAY in (share or ()),
        weights=weights,
        until=until,
        observation=observation,
        parent_fraction=parent_fraction,
        plasma_from=plasma_from,
        dispersion_s=None if dispersion in (None, ESTIMATE) else seconds(dispersion, option="--dispersion"),
        estimate_dispersion=dispersion == ESTIMATE,
        reference=tuple(dict.fromkeys(reference or ())),
        reference_mask=reference_mask,
        dose=None if dose is None else dose_in_mbq(dose),
        body_weight=body_weight,
        hypr=hypr,
        pvc=pvc,
        psf=psf,
        profiles=regions_and_symbols(profile or []),
        bootstrap=None if bootstrap is None else Resampling(bootstrap, seed),
        command_line=typed_command(
            without=("--memory", "--workers", "--scheduler", "--device"), flags=("--again", "--force")
        ),
    )
    execution = Execution(memory_size(memory) if memory else None, workers, scheduler, again)
    with progress_bar() as step:
        fitted = fit_study(request, step, execution)
    tell_fits(fitted)
