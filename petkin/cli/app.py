"""The command line application: verbs, and what happens when one fails."""

from __future__ import annotations

import signal
import sys
from types import FrameType

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


class _Stopped(BaseException):
    """A signal that ends the program; not an Exception, so that nothing on the way out takes it for its own."""


def _stop(number: int, _: FrameType | None) -> None:
    raise _Stopped(number)


def main() -> None:
    """Run the command line.

    A `PetkinError` becomes one line on standard error and exit status 2, as does a disk that is full or gone; Ctrl-C
    ends it with status 130, a termination with 143. Nothing half-written is left behind in any case.
    """
    before = {number: signal.signal(number, _stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        app()
    except (PetkinError, OSError) as error:
        print(f"petkin: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
    except _Stopped as stopped:
        print("petkin: interrupted; nothing half-written was left behind.", file=sys.stderr)
        sys.exit(128 + stopped.args[0])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
