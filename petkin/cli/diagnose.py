"""`petkin diagnose`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_SIMULATOR, _INPUT, _OUTPUT = "The simulator", "What is diagnosed", "Where results go"


def diagnose(
    target: Annotated[Path, typer.Argument(help="A PET-BIDS study with regional curves (or images with regions).")],
    model: Annotated[
        str,
        typer.Option(
            help="Tissue model of the simulator: 1tcm, 2tcm or 2tcm3k (irreversible).", rich_help_panel=_SIMULATOR
        ),
    ] = "2tcm",
    include: Annotated[
        list[str] | None,
        typer.Option(help="Effect that the simulator has, e.g. blood_volume; repeatable.", rich_help_panel=_SIMULATOR),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option(help="Effect taken out of the candidates; repeatable.", rich_help_panel=_SIMULATOR),
    ] = None,
    read_blood: Annotated[
        str,
        typer.Option(
            help="recorded: straight lines between samples, exact at those; fitted: the curves that petkin fit reads, "
            "allowed to err as the samples scatter, as measured blood does.",
            rich_help_panel=_SIMULATOR,
        ),
    ] = "recorded",
    participant_label: Annotated[
        list[str] | None,
        typer.Option(
            "--participant-label",
            "--subject",
            help="Only this subject (label without sub-); repeatable.",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    session: Annotated[
        list[str] | None, typer.Option(help="Only this session; repeatable.", rich_help_panel=_INPUT)
    ] = None,
    seg: Annotated[
        str | None,
        typer.Option(help="Which segmentation or table of curves, by its seg- label.", rich_help_panel=_INPUT),
    ] = None,
    checkpoint: Annotated[
        list[Path] | None,
        typer.Option(
            help="What petkin train learned, of five or more values of its --seed; repeatable. Together they map what "
            "the law of one tissue compartment (--model 1tcm) lacks, against time and against C_T, region by region.",
            rich_help_panel=_SIMULATOR,
        ),
    ] = None,
    design: Annotated[
        bool,
        typer.Option("--design", help="Only print what these frames, regions and blood could tell apart."),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the results. Default: derivatives/petkin.", rich_help_panel=_OUTPUT),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the draws of noise behind the test.")] = 0,
) -> None:
    """Find where a simulator and a scan part, which unmodelled effect causes it, and how far the gap shrinks with it.

    The simulator is the tissue model with the effects that --include names; all else in the catalogue is a candidate.
    Of several scans it also says what they share, in group_desc-gap_report.html: a cause too weak for each may be clear
    in all of them.

    Example: petkin diagnose study --model 2tcm --include blood_volume --include arterial_delay
    """
    from petkin.cli.parsing import labels, typed_command
    from petkin.cli.progress import progress_bar
    from petkin.cli.tell import tell_design, tell_diagnoses
    from petkin.study.diagnose import diagnose_study, foresee_study
    from petkin.study.diagnosis.request import DiagnoseRequest

    request = DiagnoseRequest(
        target=target,
        model=model,
        include=tuple(include or ()),
        without=tuple(without or ()),
        subjects=labels(participant_label, "sub-"),
        sessions=labels(session, "ses-"),
        seg=seg,
        blood=read_blood,
        out=out,
        checkpoints=tuple(checkpoint or ()),
        seed=seed,
        command_line=typed_command(),
    )
    with progress_bar() as step:
        foreseen = foresee_study(request, step) if design else ()
        found = () if design else diagnose_study(request, step)
    for label, visible in foreseen:
        tell_design(label, visible)
    tell_diagnoses(found)
