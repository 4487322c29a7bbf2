"""The report of a diagnosis: verdict, where, which, how far, and what cannot be told, on one page."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.reporting.canvas import DATA_INK, FIT_INK, QUIET, Picture, drawable, drawing, new_figure, picture
from petkin.reporting.canvas import square_root_time as spread_early
from petkin.reporting.contents import MapSet, RegionCurves
from petkin.reporting.html import environment
from petkin.reporting.map_figures import signed_picture
from petkin.reporting.state_figures import LackingTerm, state_pictures

Array = NDArray[np.float64]

_LIMIT = 4.0
#: Colours of the voxel map end here; beyond the second, noise alone seldom comes.
_BRAIN_LIMIT, _CLEAR = 6.0, 3.0
_SHOWN = 6
_BEFORE = "#3f7cac"


@dataclass(frozen=True)
class GapReport:
    """What the page shows.

    Args:
        title: heading.
        answer: as written to JSON.
        curves: measured curves.
        before, after: predicted (R, K), without and with the leading cause; None where there is none.
        residual, residual_after: in units of the noise (R, K).
        alike: pairs of causes and their cosine.
        visible: every hypothesis with d' at the end of its range, share kept by the refit, and its likeliest double.
        gap_map: z of every voxel; None without an image.
        lacking: what learned residuals find missing; None where none were given.
        shown: effects that the sidecar itself speaks for, and why.
        scan: label and value.
        warnings: what was odd about the files.
        command_line: as typed.
    """

    title: str
    answer: dict[str, Any]
    curves: RegionCurves
    before: Array
    after: Array | None
    residual: Array
    residual_after: Array | None
    alike: tuple[tuple[tuple[str, ...], float], ...]
    visible: tuple[tuple[str, float, float, tuple[tuple[str, float], ...]], ...]
    shown: tuple[tuple[str, str], ...]
    gap_map: MapSet | None
    lacking: LackingTerm | None
    scan: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    command_line: str


def render_gap_report(report: GapReport) -> str:
    """The page as HTML text; the same report gives the same bytes."""
    with drawing():
        heat = [_heat(report, report.residual, "before")]
        if report.residual_after is not None:
            heat.append(_heat(report, report.residual_after, "after"))
        pictures = [_curve(report, r) for r in _most_changed(report)]
        brain = None if report.gap_map is None else _brain(report.gap_map)
        states = [] if report.lacking is None else state_pictures(report.lacking)
        bars = cause_bars(report.answer) if report.answer["causes"] else None
        return (
            environment()
            .get_template("gap_report.html.j2")
            .render(
                report=report,
                answer=report.answer,
                heat=heat,
                curves=pictures,
                bars=bars,
                brain=brain,
                states=states,
                grade=grade_of(report.answer),
            )
        )


def grade_of(answer: dict[str, Any]) -> str:
    """How the page marks a verdict."""
    return {"none": "clear", "named": "care", "ambiguous": "care", "unknown": "unusable"}[answer["verdict"]["kind"]]


def _most_changed(report: GapReport) -> list[int]:
    energy = (report.residual**2).sum(axis=1)
    return sorted(np.argsort(-energy, kind="stable")[:_SHOWN].tolist())


def _brain(maps: MapSet) -> Picture:
    """The gap voxel by voxel, in three planes."""
    beyond = float(np.mean(np.abs(np.asarray(maps.maps[0].value)) > _CLEAR))
    alt = (
        f"Gap by voxel, z of the leading cause's course after the refit: {beyond:.1%} beyond {_CLEAR:g} "
        f"(0.3 % expected of noise alone)."
    )
    shown = signed_picture(maps, maps.maps[0], _BRAIN_LIMIT, alt=alt)
    return replace(shown, heading="Gap by voxel", caption=alt)


def _heat(report: GapReport, residual: Array, when: str) -> Picture:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    rows, columns = residual.shape
    height = 1.1 + max(0.2 * rows, 0.8)
    figure = new_figure(9.0, height)
    ax = figure.add_axes((0.2, 0.55 / height, 0.68, (height - 0.65) / height))
    colouring = ScalarMappable(Normalize(-_LIMIT, _LIMIT, clip=True), "RdBu_r")
    ax.imshow(np.asarray(colouring.to_rgba(residual)), aspect="auto", interpolation="none")
    ax.set_yticks(range(rows), [drawable(name) for name in report.curves.names], fontsize=7)
    ticks = np.unique(np.linspace(0, columns - 1, min(columns, 12)).round().astype(int))
    ax.set_xticks(ticks, [f"{k}\n{report.curves.frames.mid[k]:.3g}" for k in ticks])
    ax.set_xlabel("frame (from 0), and its middle (min)")
    ax.tick_params(length=0)
    bar = figure.colorbar(colouring, cax=figure.add_axes((0.9, 0.55 / height, 0.014, (height - 0.65) / height)))
    bar.set_label("residual (noise SD)")
    beyond = float(np.mean(np.abs(residual) > 2))
    alt = f"Residuals by region and frame {when} the leading cause is added: {beyond:.0%} beyond 2 SD (5 % expected)."
    return picture(figure, alt=alt, heading=f"Residuals {when}", caption=alt)


def _curve(report: GapReport, region: int) -> Picture:
    frames = report.curves.frames
    figure = new_figure(4.4, 2.7)
    ax = figure.add_axes((0.13, 0.17, 0.84, 0.78))
    ax.plot(frames.mid, report.curves.tacs[region], "o", ms=2.6, color=DATA_INK, label="measured")
    ax.plot(frames.mid, report.before[region], color=_BEFORE, lw=1.1, label="simulator")
    if report.after is not None:
        ax.plot(frames.mid, report.after[region], color=FIT_INK, lw=1.1, ls="--", label="with the cause")
    if np.median(frames.mid) < 0.25 * frames.end[-1]:
        spread_early(ax, float(frames.end[-1]))
    ax.set_xlabel("time (min)")
    ax.set_ylabel("kBq/mL")
    ax.legend(loc="lower right")
    name = report.curves.names[region]
    return picture(figure, alt=f"{name}: measured curve, and predictions without and with the cause.", heading=name)


def cause_bars(answer: dict[str, Any]) -> Picture:
    """Posterior over the causes of an answer and their closure, the verdict's set marked."""
    causes = answer["causes"][:_SHOWN]
    chosen = set(answer["verdict"]["set"])
    labels = ["+".join(c["effects"]) for c in causes]
    figure = new_figure(9.0, 0.9 + 0.32 * len(causes))
    left = figure.add_axes((0.33, 0.2, 0.3, 0.68))
    right = figure.add_axes((0.67, 0.2, 0.3, 0.68))
    y = np.arange(len(causes))[::-1]
    colours = [FIT_INK if label in chosen else QUIET for label in labels]
    left.barh(y, [c["probability"] for c in causes], color=colours, height=0.6)
    left.set_yticks(y, [drawable(label, 46) for label in labels], fontsize=8)
    left.set_xlim(0, 1)
    left.set_xlabel("probability")
    for place, cause in zip(y, causes):
        closed = cause["closure"]
        if closed is not None:
            right.plot([closed["low"], closed["high"]], [place, place], color=QUIET, lw=2)
            right.plot(closed["value"], place, "o", color=DATA_INK, ms=4)
    right.set_yticks([])
    right.set_ylim(left.get_ylim())
    right.set_xlim(-0.02, 1.02)
    right.set_xlabel("share of the gap closed, 90 % interval")
    alt = "; ".join(f"{label}: probability {c['probability']:.2g}" for label, c in zip(labels, causes))
    return picture(figure, alt=alt, heading="Causes", caption="Marked: the set that these data cannot split.")
