"""`petkin info`: what a study holds, and what is odd about it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from petkin.study.inspect import ScanOverview, StudyOverview


def info(
    study: Annotated[Path, typer.Argument(help="PET-BIDS folder.", show_default=False)],
    participant_label: Annotated[
        list[str] | None, typer.Option(help="Subject to look at, without 'sub-'; may be repeated. Default: all.")
    ] = None,
    voxels: Annotated[
        bool, typer.Option("--voxels", help="Also count NaN and negative voxels: reads the images.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Everything as JSON, every remark in full.")] = False,
) -> None:
    """Show what a study holds and what is odd about it, without changing anything.

    Remarks are grouped: "severe" makes a number wrong unless it is resolved; "warning" was converted or assumed, or may
    move a number a little; "note" is legal and changes nothing. A scan that cannot be used is listed as refused, with
    the reason.
    """
    from petkin.study.inspect import inspect_study

    labels = [label.removeprefix("sub-") for label in participant_label] if participant_label else None
    overview = inspect_study(study, subjects=labels, voxels=voxels)
    if json:
        from dataclasses import asdict

        from petkin.io.jsonfile import json_text

        typer.echo(json_text(asdict(overview)), nl=False)
    else:
        _show(overview)


def _show(overview: StudyOverview) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    console.print(Text(overview.name, style="bold"))
    if overview.scans:
        columns = ("scan", "tracer", "frames", "minutes", "image", "blood samples", "regions")
        table = Table(*columns, box=None, pad_edge=False, header_style="bold")
        for scan in overview.scans:
            # a tracer's name may look like rich's markup: [carbonyl-11C]WAY-100635
            table.add_row(*map(Text, _cells(scan)))
        console.print(table)
    styles = {"severe": "bold red", "warning": "yellow", "note": "dim"}
    for line in overview.refused:
        console.print(Text("refused", style="bold red"), Text(line), soft_wrap=True)
    for finding in overview.findings:
        severity = finding.severity.value
        more = f" (and {finding.count - 1} more alike)" if finding.count > 1 else ""
        console.print(Text(severity, style=styles[severity]), Text(finding.sentence + more), soft_wrap=True)
    if not overview.refused and not overview.findings:
        console.print("Nothing odd was found.")


def _cells(scan: ScanOverview) -> tuple[str, ...]:
    samples = [str(scan.manual_samples)] if scan.manual_samples else []
    samples += [f"{scan.automatic_samples} auto"] if scan.automatic_samples else []
    return (
        scan.scan,
        f"{scan.tracer} ({scan.nuclide})",
        str(scan.frames),
        f"{scan.minutes:.4g}",
        " x ".join(map(str, scan.image)) or "none",
        " + ".join(samples) or "none",
        ", ".join(f"{count} {seg}" for seg, count in scan.regions.items()) or "none",
    )
