"""What commands print when they are done."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from petkin.fitting import FitResult, Status, find_method
from petkin.reporting import TruthRow
from petkin.study.fit import Fitted
from petkin.study.fit_scan import ScanFit
from petkin.study.truth import known_truth


def tell_fits(fitted: Sequence[Fitted]) -> None:
    """One table over all scans, the warnings, and where the reports are."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Fits", title_justify="left")
    for heading in ("scan", "model", "level", "fitted", "flagged", "outcome (median)", "its SE (median)", "delay"):
        table.add_column(heading, justify="left" if heading in ("scan", "model", "level") else "right")
    for one in fitted:
        for level, results in (("region", one.fit.regional), ("voxel", one.fit.by_voxel)):
            for result in results:
                delay = f"{one.fit.applied[0] * 60:+.1f} s"
                table.add_row(one.fit.source.label, result.model, level, *_figures(result), delay)
    console = Console()
    console.print(table)
    for one in fitted:
        for remark in one.fit.remarks:
            console.print(f"{one.fit.source.label}: {remark}", markup=False, highlight=False, soft_wrap=True)
    for one in fitted:
        console.print(f"Report: {one.report}", markup=False, highlight=False, soft_wrap=True)


def _figures(result: FitResult) -> tuple[str, str, str, str]:
    """Counts, and the median of the outcome over the curves that are not in doubt."""
    outcome = find_method(result.model).outcome
    estimate = next(e for e in result.estimates if e.symbol == outcome)
    sure = np.isin(result.status, (Status.OK, Status.AT_BOUND)) & np.isfinite(estimate.value)
    fitted = int(np.isfinite(estimate.value).sum())
    if not sure.any():
        return str(fitted), str(fitted - result.count(Status.OK)), f"{outcome} n/a", "n/a"
    errors = estimate.percent_se[sure]
    se = f"{np.nanmedian(errors):.2g} %" if np.isfinite(errors).any() else "n/a"
    flagged = fitted - result.count(Status.OK)
    return str(fitted), str(max(flagged, 0)), f"{outcome} {np.median(estimate.value[sure]):.4g}", se


def tell_errors(fitted: Sequence[Fitted], study: Path) -> None:
    """How far regional estimates lie from the truth of a simulated study, a line a model and quantity."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Against the truth, by region", title_justify="left")
    for heading in ("scan", "model", "quantity", "median |error|", "largest |error|", "within 2 SE"):
        table.add_column(heading, justify="right" if "error" in heading or "SE" in heading else "left")
    for one in fitted:
        truth = known_truth(study, one.fit.source)
        for result in one.fit.regional:
            for symbol in dict.fromkeys(row.symbol for row in truth):
                figures = _against(symbol, truth, one.fit, result)
                if figures is not None:
                    table.add_row(one.fit.source.label, result.model, symbol, *figures)
    if table.row_count:
        Console().print(table)


def _against(symbol: str, truth: Sequence[TruthRow], fit: ScanFit, result: FitResult) -> tuple[str, str, str] | None:
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
    return f"{np.nanmedian(error):.2g} %", f"{np.nanmax(error):.2g} %", f"{int(within.sum())} of {len(index)}"
