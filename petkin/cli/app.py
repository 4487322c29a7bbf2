"""The command line application: verbs, and what happens when one fails."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType
from typing import Any

import typer
from typer.core import TyperCommand

from petkin.cli.demo import demo
from petkin.cli.diagnose import diagnose
from petkin.cli.fit import fit
from petkin.cli.info import info
from petkin.cli.models import models
from petkin.cli.simulate import simulate
from petkin.cli.tacs import tacs
from petkin.cli.train import train
from petkin.errors import PetkinError


class _Panelled(TyperCommand):
    """A command whose help shows its options in panels.

    `petkin --help` itself is plain: what draws panels takes longer to load than all the rest of that answer.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **{**options, "rich_markup_mode": "rich"})


app = typer.Typer(
    name="petkin",
    help="Dynamic PET kinetic modelling: simulate a study, fit it, and say how sure the numbers are.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
)
for verb in (simulate, train, fit, diagnose, models, tacs, info, demo):
    app.command(cls=_Panelled)(verb)


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
    # petkin's parts run side by side themselves: on their small matrices threads of BLAS wait for each other (a delay
    # took seven times as long on a busy machine), and sums of another order would change the last digits.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
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
