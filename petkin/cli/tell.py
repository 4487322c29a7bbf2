"""What commands print when they are done."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from petkin.diagnosis import Visible
    from petkin.fitting import FitResult
    from petkin.reporting import TruthRow
    from petkin.study.diagnose import Diagnosed
    from petkin.study.fit_scan import ScanFit
    from petkin.study.outcome import Fitted, Outcome

#: Columns of text in a pipe or file, where no terminal says how wide it is: no table of petkin's is wider.
_WIDE = 160


def tell_fits(fitted: Sequence[Fitted]) -> None:
    """One table over all scans, the warnings, and where the reports are."""
    console = _console()
    table = _table("scan", "model", "level", right=("fitted", "flagged", "median", "its SE", "delay"))
    for one in fitted:
        for outcome in one.outcomes:
            delay = "n/a" if one.delay is None else f"{round(one.delay * 60, 1) + 0.0:+.1f} s"  # no -0.0
            table.add_row(one.label, outcome.model, outcome.level, *_figures(outcome), delay)
    console.print(table)
    for line in _remarks(fitted):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    before = sum(one.before for one in fitted)
    if before:
        which = "It was" if len(fitted) == 1 else f"{before} of {len(fitted)} scans were"
        console.print(f"{which} finished before by the same request and not fitted again; --again does.")
    for one in fitted:
        console.print(f"Report: {one.report}", markup=False, highlight=False, soft_wrap=True)


def tell_errors(fitted: Sequence[Fitted], study: Path) -> None:
    """How far regional estimates lie from the truth of a simulated study, a line a model and quantity."""
    from petkin.study.truth import known_truth

    table = _table("scan", "model", "quantity", right=("median error", "largest error", "within 2 SE"))
    for fit in (one.fit for one in fitted if one.fit is not None):
        truth = known_truth(study, fit.source)
        for result in fit.regional:
            for symbol in dict.fromkeys(row.symbol for row in truth):
                figures = _against(symbol, truth, fit, result)
                if figures is not None:
                    table.add_row(fit.source.label, result.model, symbol, *figures)
    if table.row_count:
        console = _console()
        console.print("Against the truth, by region:")
        console.print(table)


def tell_diagnoses(found: Sequence[Diagnosed]) -> None:
    """What is odd about the files, as no verdict is better than they are; the verdict on every scan in a sentence, what
    would split it, and where the reports are."""
    for line in _remarks(found):
        print(line)
    for one in found:
        print(f"{one.label}: {one.answer['verdict']['sentence']}")
        if one.answer["verdict"]["split_by"]:
            print(f"  To tell them apart: {one.answer['verdict']['split_by']}.")
        print(f"  Report: {one.report}")


def tell_design(label: str, visible: Sequence[Visible]) -> None:
    """What a design could tell of every effect: d' at the end of its plausible range, the share of it that the refit
    keeps, and what it is taken for."""
    from petkin.diagnosis import ABSORBED

    console = _console()
    table = _table("effect", right=("d'", "kept"))
    table.add_column("taken for", overflow="fold")
    for one in sorted(visible, key=lambda v: -v.detectability):
        alike = ", ".join(f"{name} ({cosine:.2f})" for name, cosine in one.partners[:2])
        kept = _percent(100.0 * one.kept) if one.kept >= ABSORBED else "none"
        table.add_row(
            one.hypothesis.name, f"{one.detectability:.2f}", kept, "cannot be seen" if one.invisible else alike
        )
    console.print(f"{label}: what could be told, at the end of each plausible range", markup=False, highlight=False)
    console.print(table)


def _console() -> Console:
    from rich.console import Console

    plain = Console()
    return plain if plain.is_terminal else Console(width=_WIDE)


def _table(*left: str, right: Sequence[str]) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in left:
        table.add_column(heading, overflow="fold")
    for heading in right:
        table.add_column(heading, justify="right")
    return table


def _remarks(fitted: Sequence[Fitted] | Sequence[Diagnosed]) -> list[str]:
    """Warnings of one scan in full; of several scans the first of each kind, and how many are like it."""
    from petkin.study.inspect import group

    if len(fitted) == 1:
        return [f"{remark.severity} {remark}" for remark in dict.fromkeys(fitted[0].remarks)]
    lines = []
    for found in group(remark for one in fitted for remark in one.remarks):
        more = f" (and {found.count - 1} more alike, see the reports)" if found.count > 1 else ""
        lines.append(f"{found.severity} {found.sentence}{more}")
    return lines


def _figures(outcome: Outcome) -> tuple[str, str, str, str]:
    counts = str(outcome.curves), str(outcome.flagged)
    if math.isnan(outcome.median):
        return *counts, f"{outcome.symbol} n/a", "n/a"
    return *counts, f"{outcome.symbol} {outcome.median:.4g}", _percent(outcome.percent_se)


def _percent(value: float) -> str:
    if math.isnan(value):
        return "n/a"
    return f"{value:.2g} %" if value < 99.5 else f"{value:.0f} %"


def _against(symbol: str, truth: Sequence[TruthRow], fit: ScanFit, result: FitResult) -> tuple[str, str, str] | None:
    import numpy as np

    if fit.curves is None or symbol not in [e.symbol for e in result.estimates]:
        return None
    place = {name: i for i, name in enumerate(fit.curves.names)}
    rows = [(row.truth, place[row.region]) for row in truth if row.symbol == symbol and row.region in place]
    known = np.array([value for value, _ in rows])
    index = [i for _, i in rows]
    with np.errstate(all="ignore"):
        error = 100.0 * np.abs(result[symbol][index] / known - 1.0)
        within = error <= 2.0 * result.percent_se(symbol)[index] * np.abs(result[symbol][index] / known)
    if not np.isfinite(error).any():
        return None
    return _percent(np.nanmedian(error)), _percent(np.nanmax(error)), f"{int(within.sum())} of {len(index)}"
