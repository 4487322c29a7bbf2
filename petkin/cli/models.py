"""`petkin models`: every way of fitting a curve, what it needs and what it gives."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from petkin.methods import Method


def models(
    label: Annotated[str | None, typer.Argument(help="Tell more of this one.", show_default=False)] = None,
) -> None:
    """List the models that `petkin fit --model` knows; of one, its equation, parameters and source.

    Examples:

      petkin models

      petkin models 2TCM
    """
    from petkin.methods import METHODS, find_method

    if label is None:
        _list(METHODS)
    else:
        _one(find_method(label))


def _list(methods: tuple[Method, ...]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("label", "model", "gives", "needs", box=None, pad_edge=False, header_style="bold")
    for method in methods:
        table.add_row(method.label, method.name, method.outcome, _needs(method))
    Console().print(table)


def _one(method: Method) -> None:
    typer.echo(f"{method.label}: {method.name}")
    typer.echo(f"  {method.equation}")
    typer.echo(f"  gives {method.outcome}; needs {_needs(method)}; --fix and --bounds take {', '.join(method.symbols)}")
    typer.echo(f"  {method.how}")
    typer.echo(f"  {method.reference}")


def _needs(method: Method) -> str:
    return ", ".join(sorted(need.value for need in method.needs)) or "nothing else"
