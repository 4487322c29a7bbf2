"""The command line application: verbs, and what happens when one fails."""

from __future__ import annotations

import sys

import typer

from petkin.cli.demo import demo
from petkin.cli.fit import fit
from petkin.cli.info import info
from petkin.cli.simulate import simulate
from petkin.cli.tacs import tacs
from petkin.errors import PetkinError

app = typer.Typer(
    name="petkin",
    help="Dynamic PET kinetic modelling: simulate a study, fit it, and say how sure the numbers are.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
for verb in (simulate, fit, tacs, info, demo):
    app.command()(verb)


@app.callback(invoke_without_command=True)
def root(version: bool = typer.Option(False, "--version", help="Print the version and exit.")) -> None:
    if version:
        from petkin import __version__

        print(__version__)
        raise typer.Exit


def main() -> None:
    """Run the command line; a `PetkinError` becomes one line on standard error and exit status 2."""
    try:
        app()
    except PetkinError as error:
        print(f"petkin: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("petkin: interrupted; nothing half-written was left behind.", file=sys.stderr)
        sys.exit(130)
