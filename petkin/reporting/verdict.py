"""The first lines of a report: what was fitted, what was flagged and why, how sure the main numbers are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.results import FitResult, Status
from petkin.reporting.comparison import compare
from petkin.reporting.contents import FitReport, MapSet, ModelSection, RegionCurves
from petkin.reporting.quantiles import ordered, percentiles
from petkin.reporting.residuals import sign_runs
from petkin.reporting.wording import count, joined, percent, status_kind, status_short

#: The first outcome and the first measure of delivery that a model has are quoted.
_OUTCOMES, _DELIVERY = ("VT", "Ki", "BPND"), ("K1", "R1")
#: Share of unflagged voxels below which a report without regions asks for care.
_CALM_SHARE = 0.95
#: From this many curves on, a share says more than a count alone.
_MANY = 100
#: So many flagged regions are named.
_NAMED = 6


@dataclass(frozen=True)
class Verdict:
    """`grade` is "clear", "care" or "unusable"; `headline` one sentence; `sentences` one a model and the comparison."""

    grade: str
    headline: str
    sentences: tuple[str, ...]


def judge(report: FitReport) -> Verdict:
    """Sum a report up in plain words."""
    codes = [_graded_codes(section) for section in report.models]
    shares = [_share_ok(c) for c in codes]
    sentences = [" ".join(_sentences(section, report.regions)) for section in report.models]
    comparison = compare(report)
    if comparison is not None:
        sentences.append(comparison.summary)
    grade = _grade(report, shares)
    return Verdict(grade, _headline(grade, report), tuple(sentences))


def headline_symbols(symbols: tuple[str, ...]) -> tuple[str, ...]:
    """What to quote: one of VT, Ki, BPND and one of K1, R1, or else the first that there is."""
    outcome = [s for s in _OUTCOMES if s in symbols][:1]
    delivery = [s for s in _DELIVERY if s in symbols][:1]
    return (*outcome, *delivery) or symbols[:1]


def status_counts(codes: NDArray[np.uint8]) -> dict[Status, int]:
    """How often each status occurs, without OUTSIDE, in the order of the codes."""
    values, numbers = np.unique(codes, return_counts=True)
    return {Status(int(v)): int(n) for v, n in zip(values, numbers) if v != Status.OUTSIDE}


def _graded_codes(section: ModelSection) -> NDArray[np.uint8]:
    if section.regional is not None:
        return section.regional.status
    return section.maps.status if section.maps is not None else np.empty(0, np.uint8)


def _share_ok(codes: NDArray[np.uint8]) -> float:
    inside = codes[codes != Status.OUTSIDE]
    return float(np.mean(inside == Status.OK)) if inside.size else 0.0


def _grade(report: FitReport, shares: list[float]) -> str:
    if max(shares) == 0.0:
        return "unusable"
    calm = [1.0 if section.regional is not None else _CALM_SHARE for section in report.models]
    if report.warnings or any(share < limit for share, limit in zip(shares, calm)):
        return "care"
    return "clear"


def _headline(grade: str, report: FitReport) -> str:
    if grade == "unusable":
        return "No usable result: every curve is flagged or could not be fitted."
    if grade == "clear":
        return "Nothing was flagged."
    warned = {0: "", 1: " One warning below."}.get(len(report.warnings), f" {len(report.warnings)} warnings below.")
    flagged = any(_share_ok(_graded_codes(s)) < 1 for s in report.models)
    return f"Read with care: {'some fits are flagged' if flagged else 'there is something to know first'}.{warned}"


def _sentences(section: ModelSection, regions: RegionCurves | None) -> list[str]:
    sentences = []
    if section.regional is not None:
        fit = section.regional
        sentences.append(f"{section.model}: {_counted(fit.status, 'region')}{_median_errors(_regional_errors(fit))}.")
        if regions is not None:
            sentences += _named(regions.names, fit.status) + _systematic(regions, fit)
    if section.maps is not None:
        label = "" if sentences else f"{section.model}: "
        errors = _median_errors(_voxel_errors(section.maps))
        counted = _counted(section.maps.status, "voxel")
        sentences.append(f"{label}{counted if label else counted[:1].upper() + counted[1:]}{errors}.")
    return sentences


def _counted(codes: NDArray[np.uint8], noun: str) -> str:
    counts = status_counts(codes)
    total = sum(counts.values())
    if total == 0:
        return f"the mask holds no {noun}"
    fitted = sum(n for s, n in counts.items() if status_kind(s) != "missing")
    nouns = noun if total == 1 else f"{noun}s"
    number_of = (
        f"{'the' if total == 1 else 'all'} {count(total)}" if fitted == total else f"{count(fitted)} of {count(total)}"
    )
    missing = [f"{count(n)} with {status_short(s)}" for s, n in counts.items() if status_kind(s) == "missing"]
    left_out = f"; not fitted: {joined(missing)}" if missing else ""
    return f"{number_of} {nouns} fitted, {_flagged(counts, total)}{left_out}"


def _named(names: tuple[str, ...], codes: NDArray[np.uint8]) -> list[str]:
    """Which regions are flagged or missing, unless all are."""
    marked = [f"{name} ({status_short(Status(int(c)))})" for name, c in zip(names, codes) if c != Status.OK]
    if not marked or len(marked) == len(names):
        return []
    more = [f"{len(marked) - _NAMED} more"] if len(marked) > _NAMED else []
    return [f"See {joined(marked[:_NAMED] + more)}."]


def _systematic(regions: RegionCurves, fit: FitResult) -> list[str]:
    """In how many regions the residuals keep their sign longer than chance would."""
    if fit.predicted is None:
        return []
    number = sum(sign_runs(regions, fit, r).systematic for r in range(len(regions)))
    return [f"Residuals are systematic in {count(number)} of {count(len(regions))} regions."] if number else []


def _flagged(counts: dict[Status, int], total: int) -> str:
    doubtful = {s: n for s, n in counts.items() if status_kind(s) == "doubtful"}
    if not doubtful:
        return "none flagged"
    number = sum(doubtful.values())
    share = f", {percent(100 * number / total)}" if total >= _MANY else ""
    if len(doubtful) == 1:
        return f"{count(number)} flagged ({status_short(next(iter(doubtful)))}{share})"
    reasons = joined([f"{count(n)} {status_short(s)}" for s, n in doubtful.items()])
    return f"{count(number)} flagged ({reasons}{share})"


def _regional_errors(fit: FitResult) -> dict[str, float]:
    symbols = headline_symbols(tuple(e.symbol for e in fit.estimates))
    return {s: _median(fit.percent_se(s)[fit.status == Status.OK]) for s in symbols}


def _voxel_errors(maps: MapSet) -> dict[str, float]:
    errors = {m.symbol: m.percent_se for m in maps.maps if m.percent_se is not None}
    good = maps.status == Status.OK
    return {s: _median(np.asarray(errors[s])[good]) for s in headline_symbols(tuple(errors))}


def _median(values: NDArray[np.floating]) -> float:
    return percentiles(ordered(values), (50,))[0]


def _median_errors(errors: dict[str, float]) -> str:
    known = [f"{symbol} {percent(value)}" for symbol, value in errors.items() if np.isfinite(value)]
    return f"; median standard error {joined(known)}" if known else ""
