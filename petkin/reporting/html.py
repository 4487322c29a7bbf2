"""The report as one HTML file that needs nothing else: no network, no fonts, no scripts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from petkin.fitting.results import FitResult
from petkin.io.atomic import write_bytes
from petkin.reporting import tables
from petkin.reporting.canvas import Picture, drawing
from petkin.reporting.comparison import compare
from petkin.reporting.contents import FitReport, ModelSection, RegionCurves
from petkin.reporting.curve_figures import chosen_regions, curve_pictures, heat_picture
from petkin.reporting.input_figures import input_pictures
from petkin.reporting.map_figures import map_pictures, status_picture
from petkin.reporting.plots import plot_pictures
from petkin.reporting.tables import Table
from petkin.reporting.verdict import judge
from petkin.reporting.wording import number, rounded_to_error

#: From this many regions on, one picture of all residuals says more than many small ones.
_MANY_REGIONS = 4


def write_fit_report(path: Path, report: FitReport) -> None:
    """Write the report to `path`, whole or not at all. The same report gives the same bytes.

    Raises:
        InputError: the folder cannot be written.
    """
    write_bytes(Path(path), render_fit_report(report).encode("utf-8", errors="replace"))


def render_fit_report(report: FitReport) -> str:
    """The report as HTML text."""
    comparison = compare(report)
    names = report.regions.names if report.regions is not None else ()
    with drawing():
        return (
            environment()
            .get_template("fit_report.html.j2")
            .render(
                report=report,
                verdict=judge(report),
                comparison=comparison,
                comparison_table=tables.comparison_table(comparison, names) if comparison else None,
                input_pictures=input_pictures(report.input) if report.input is not None else [],
                models=[_model_view(section, report) for section in report.models],
                citations=_citations(report),
            )
        )


@dataclass(frozen=True)
class RegionalView:
    """What the page shows of one model's regions."""

    summary: Table
    delay: str
    first: list[Picture]
    rest: list[Picture]
    chosen: bool
    plots: list[Picture]
    heat: Picture | None


@dataclass(frozen=True)
class VoxelView:
    """What the page shows of one model's maps."""

    table: Table
    status: Picture
    status_table: Table
    pairs: list[tuple[Picture, Picture | None]]
    oriented: bool


@dataclass(frozen=True)
class ModelView:
    """What the page shows of one model."""

    section: ModelSection
    regional: RegionalView | None
    voxels: VoxelView | None
    truth: Table | None
    truth_summary: Table | None
    settings: Table | None
    limits: tuple[str, ...]


def _model_view(section: ModelSection, report: FitReport) -> ModelView:
    curves = report.regions
    regional = _regional_view(curves, section.regional) if curves is not None and section.regional is not None else None
    remarks = section.regional.remarks if section.regional is not None else ()
    if section.maps is not None:
        remarks = tuple(dict.fromkeys((*remarks, *section.maps.remarks)))
    return ModelView(
        section=section,
        regional=regional,
        voxels=_voxel_view(section),
        truth=tables.truth_table(section.truth) if section.truth else None,
        truth_summary=tables.truth_summary(section.truth) if section.truth else None,
        settings=tables.settings_table(section),
        limits=tuple(remark for remark in remarks if remark not in report.limits),
    )


def _regional_view(curves: RegionCurves, fit: FitResult) -> RegionalView:
    first = chosen_regions(fit)
    rest = [r for r in range(len(curves)) if r not in set(first)]
    return RegionalView(
        summary=tables.summary_table(curves, fit),
        delay=delay_text(fit),
        first=curve_pictures(curves, fit, first),
        rest=curve_pictures(curves, fit, rest),
        chosen=bool(rest),
        plots=plot_pictures(fit.plots, curves.names),
        heat=heat_picture(curves, fit) if len(curves) >= _MANY_REGIONS else None,
    )


def _voxel_view(section: ModelSection) -> VoxelView | None:
    if section.maps is None:
        return None
    return VoxelView(
        table=tables.map_table(section.maps),
        status=status_picture(section.maps),
        status_table=tables.status_table(section.maps.status, "Voxels"),
        pairs=map_pictures(section.maps),
        oriented=bool(section.maps.axes),
    )


def delay_text(fit: FitResult) -> str:
    """The input's delay in minutes and seconds, and where it came from."""
    if math.isfinite(fit.delay_se) and fit.delay_se > 0:
        in_minutes = " ± ".join(rounded_to_error(fit.delay, fit.delay_se))
        in_seconds = " ± ".join(rounded_to_error(60 * fit.delay, 60 * fit.delay_se))
        return f"{in_minutes} min ({in_seconds} s), estimated"
    if fit.delay == 0:
        return "none"
    return f"{number(fit.delay)} min ({number(60 * fit.delay)} s), not estimated with an error"


def _citations(report: FitReport) -> list[str]:
    every = [*report.citations, *(c for section in report.models for c in section.citations)]
    return list(dict.fromkeys(every))


def environment() -> Environment:
    """Where templates are found, and how strict they are."""
    return Environment(
        loader=PackageLoader("petkin.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
