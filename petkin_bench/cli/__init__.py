"""`petkin-bench`: measure, print, and keep what was measured."""

from __future__ import annotations

import sys

import typer

from petkin.errors import PetkinError
from petkin_bench.cli import fitting, gaps, learning

app = typer.Typer(
    name="petkin-bench",
    help="Benchmarks of petkin against named baselines, measured in one run.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
speed = typer.Typer(help="How fast, against what, and how good.", no_args_is_help=True)
app.add_typer(speed, name="speed")
speed.command("fit")(fitting.speed_fit)
speed.command("train")(learning.speed_train)
speed.command("diagnose")(gaps.speed_diagnose)
for command in (fitting.accuracy, learning.run, learning.tables, learning.forecast):
    app.command()(command)
for command in (gaps.diagnose, gaps.real_scans, gaps.survey, gaps.withheld):
    app.command()(command)


def main() -> None:
    """Run the command line; a `PetkinError` becomes one line on standard error and exit status 2."""
    try:
        app()
    except PetkinError as error:
        print(f"petkin-bench: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
