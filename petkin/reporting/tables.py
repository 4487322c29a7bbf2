"""The tables of a report as plain cells, ready for the page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from petkin.fitting.results import Estimate, FitResult, Status
from petkin.reporting.comparison import Comparison
from petkin.reporting.contents import MapSet, ModelSection, RegionCurves, TruthRow
from petkin.reporting.quantiles import ordered, percentiles
from petkin.reporting.verdict import headline_symbols, status_counts
from petkin.reporting.wording import (
    MISSING,
    count,
    number,
    percent,
    status_kind,
    status_mark,
    status_short,
    symbol_html,
    unit_text,
    value_with_error,
)

#: Above this many percent a standard error is printed bold.
_UNSURE = 25.0
#: What a fit is made for comes first, before rate constants.
_OUTCOMES = ("VT", "Ki", "BPND")


@dataclass(frozen=True)
class Cell:
    """One cell: text, a smaller second line, and the kind that styles it."""

    text: str | Markup
    note: str | Markup = ""
    kind: str = ""


@dataclass(frozen=True)
class Table:
    """Column heads as (label, unit); the first cell of a row heads it."""

    caption: str
    heads: tuple[tuple[str | Markup, str], ...]
    rows: tuple[tuple[Cell, ...], ...]


def summary_table(curves: RegionCurves, fit: FitResult) -> Table:
    """Every estimate of every region with its standard error, fit quality and status."""
    estimates = sorted(fit.estimates, key=_place)
    heads: list[tuple[str | Markup, str]] = [("Region", ""), ("Status", "")]
    heads += [(symbol_html(e.symbol), unit_text(e.unit) or "unitless") for e in estimates]
    rows = []
    for r, name in enumerate(curves.names):
        quality = Cell(number(float(fit.chi2[r])), f"AICc {number(float(fit.aicc[r]), 4)}")
        values = [_estimate_cell(e, r) for e in estimates]
        rows.append((Cell(f"{r + 1}. {name}"), status_cell(fit.status[r]), *values, quality))
    heads.append((symbol_html("chi2"), "unitless"))
    return Table(
        f"{fit.model} by region: value, and below it ± its standard error (in percent).", tuple(heads), tuple(rows)
    )


def _place(estimate: Estimate) -> int:
    return _OUTCOMES.index(estimate.symbol) if estimate.symbol in _OUTCOMES else len(_OUTCOMES)


def _estimate_cell(estimate: Estimate, region: int) -> Cell:
    error = float(estimate.percent_se[region])
    text, note = value_with_error(float(estimate.value[region]), error)
    return Cell(text, note, "unsure" if error > _UNSURE else "")


def status_cell(code: int | np.integer) -> Cell:
    """A status in words with a mark, coloured by kind."""
    status = Status(int(code))
    return Cell(f"{status_mark(status)} {status_short(status)}", kind=status_kind(status))


def status_table(codes: np.ndarray, noun: str) -> Table:
    """How many curves ended how, and what that means."""
    counts = status_counts(codes)
    total = max(sum(counts.values()), 1)
    rows = [
        (status_cell(s), Cell(count(n)), Cell(percent(100.0 * n / total)), Cell(s.meaning, kind="words"))
        for s, n in counts.items()
    ]
    heads = (("Status", ""), (noun, ""), ("Share", ""), ("Meaning", ""))
    return Table(f"How the {noun.lower()} ended.", heads, tuple(rows))


def map_table(maps: MapSet) -> Table:
    """Spread of every map over the voxels without a flag."""
    good = maps.status == Status.OK
    rows = []
    for entry in maps.maps:
        values = ordered(np.asarray(entry.value)[good])
        errors = np.empty(0) if entry.percent_se is None else ordered(np.asarray(entry.percent_se)[good])
        numbers = [Cell(number(q)) for q in percentiles(values, (25, 50, 75))]
        median_error = Cell(percent(*percentiles(errors, (50,))))
        head = Cell(symbol_html(entry.symbol), unit_text(entry.unit))
        rows.append((head, *numbers, median_error, Cell(count(int(values.size)))))
    names = ("Map", "25th percentile", "Median", "75th percentile", "Median SE", "Voxels")
    return Table("Voxels fitted without a flag.", tuple((n, "") for n in names), tuple(rows))


def comparison_table(comparison: Comparison, names: tuple[str, ...]) -> Table:
    """AICc differences by region, the main estimates beneath them."""
    rows = []
    for r, name in enumerate(names):
        cells = [_delta_cell(comparison, m, r) for m in range(len(comparison.models))]
        rows.append((Cell(f"{r + 1}. {name}"), *cells, Cell(comparison.preferred(r) or MISSING)))
    heads = (("Region", ""), *((f"ΔAICc {m}", "") for m in comparison.models), ("Preferred", ""))
    return Table("AICc above the best model of each region; 0 is best, below 2 undecided.", heads, tuple(rows))


def _delta_cell(comparison: Comparison, model: int, region: int) -> Cell:
    fit, delta = comparison.fits[model], float(comparison.delta[model, region])
    shared = [
        e.symbol for e in fit.estimates if all(e.symbol in {o.symbol for o in f.estimates} for f in comparison.fits)
    ]
    notes = [
        Markup("{} {}").format(symbol_html(s), number(float(fit[s][region]))) for s in headline_symbols(tuple(shared))
    ]
    shown = f"{delta:.1f}" if math.isfinite(delta) else MISSING
    return Cell(shown, Markup(", ").join(notes), "best" if delta == 0 else "")


def truth_table(rows: tuple[TruthRow, ...]) -> Table:
    """One row a region, one column a parameter: error, and below it the estimate and the truth."""
    symbols = {row.symbol: row.unit for row in rows}
    known = {(row.region, row.symbol): row for row in rows}
    regions = dict.fromkeys(row.region for row in rows)
    cells = tuple((Cell(region), *(_truth_cell(known.get((region, s))) for s in symbols)) for region in regions)
    heads = (("Region", ""), *((symbol_html(s), unit_text(unit) or "unitless") for s, unit in symbols.items()))
    return Table("Error in percent of the truth; below it the estimate, and the truth in brackets.", heads, cells)


def _truth_cell(row: TruthRow | None) -> Cell:
    if row is None:
        return Cell(MISSING)
    return Cell(percent(row.percent_error, signed=True), f"{number(row.estimate, 4)} ({number(row.truth, 4)})")


def truth_summary(rows: tuple[TruthRow, ...]) -> Table:
    """Error of each parameter over the regions: bias, median and worst."""
    cells = []
    for symbol in dict.fromkeys(row.symbol for row in rows):
        known = [row for row in rows if row.symbol == symbol and math.isfinite(row.percent_error)]
        if not known:
            cells.append((Cell(symbol_html(symbol)), Cell(MISSING), Cell(MISSING), Cell(MISSING)))
            continue
        errors = np.array([row.percent_error for row in known])
        worst = known[int(np.argmax(np.abs(errors)))]
        cells.append(
            (
                Cell(symbol_html(symbol)),
                Cell(percent(float(np.median(errors)), signed=True)),
                Cell(percent(float(np.median(np.abs(errors))))),
                Cell(percent(worst.percent_error, signed=True), worst.region),
            )
        )
    names = ("Parameter", "Median error", "Median |error|", "Largest error")
    return Table("Errors against the truth, over regions.", tuple((n, "") for n in names), tuple(cells))


def settings_table(section: ModelSection) -> Table | None:
    """What was chosen; regions and voxels side by side where both were fitted."""
    sources: list[tuple[str, Mapping[str, object]]] = []
    if section.regional is not None:
        sources.append(("Regions", section.regional.settings))
    if section.maps is not None:
        sources.append(("Voxels", section.maps.settings))
    sources = [(name, values) for name, values in sources if values]
    if not sources:
        return None
    keys = dict.fromkeys(key for _, values in sources for key in values)
    rows = tuple(
        (Cell(key.replace("_", " ")), *(Cell(plain(v[key]) if key in v else MISSING, kind="words") for _, v in sources))
        for key in keys
    )
    heads = (("Setting", ""), *((name, "") for name, _ in sources))
    return Table("Settings of the fit.", heads, rows)


def plain(value: object) -> str:
    """Any setting as one line of text; a pair of numbers is a range."""
    if isinstance(value, Mapping):
        return "; ".join(f"{k}: {plain(v)}" for k, v in value.items()) or "none"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return f"{float(value):g}"
    if (
        isinstance(value, list | tuple)
        and len(value) == 2
        and all(isinstance(v, int | float | np.number) for v in value)
    ):
        return f"{plain(value[0])} to {plain(value[1])}"
    if isinstance(value, list | tuple | np.ndarray):
        return ", ".join(plain(v) for v in value) or "none"
    return "none" if value is None else str(value)
