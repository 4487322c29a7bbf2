"""`petkin demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the study and its results; must not exist yet.")] = Path(
        "petkin-demo"
    ),
    seed: Annotated[int, typer.Option(help="Seed of the simulated study.")] = 1,
) -> None:
    """Simulate a study, fit it with one and two tissue compartments, compare with the truth, and ask what one lacks.

    Takes about a minute. Open the reports that it names in a browser.
    """
    from petkin.cli.parsing import typed_command
    from petkin.cli.progress import progress_bar
    from petkin.cli.tell import tell_diagnoses, tell_errors, tell_fits
    from petkin.study.demo import run_demo

    with progress_bar() as step:
        shown = run_demo(out, seed=seed, command_line=typed_command(), progress=step)
    tell_fits(shown.fitted)
    tell_errors(shown.fitted, out)
    print("What a simulator of one tissue compartment lacks:")
    tell_diagnoses(shown.diagnosed)
