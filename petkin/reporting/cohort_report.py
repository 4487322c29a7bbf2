"""The page about several diagnosed scans: what they share, who has it, how strong it is in each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from petkin.reporting.canvas import DATA_INK, FIT_INK, QUIET, Picture, drawable, drawing, new_figure, picture
from petkin.reporting.html import environment

#: Causes shown at most, and inches a scan.
_SHOWN, _ROW = 8, 0.19
_MANY = 60


@dataclass(frozen=True)
class CohortReport:
    """What the page shows: a heading, the answer as written to JSON, links to the scans' own pages, how their
    noise goes, the command."""

    title: str
    answer: dict[str, Any]
    links: tuple[str, ...]
    noise: str
    command_line: str


def render_cohort_report(report: CohortReport) -> str:
    """The page as HTML text; the same report gives the same bytes."""
    answer = report.answer
    grade = {"none": "clear", "named": "care", "ambiguous": "care", "unknown": "unusable"}[answer["verdict"]["kind"]]
    with drawing():
        tables = _tables(answer)
        every = [cause for _, causes in tables for cause in causes]
        pictures = [_carriers(every, answer["members"])] if every else []
        pictures += [drawn for _, causes in tables for drawn in _strengths(causes)]
        page = environment().get_template("cohort_report.html.j2")
        return page.render(report=report, answer=answer, tables=tables, pictures=pictures, grade=grade)


def _tables(answer: dict[str, Any]) -> list[tuple[str, list[dict[str, Any]]]]:
    """Captions and causes of everything that is shared, what the first scans share first."""
    found = [("Shared causes, likeliest first", answer["causes"])]
    found += [("What other scans share, likeliest first", group["causes"]) for group in answer["further"]]
    found += [("A gap of no name", [answer["unnamed"]] if answer["unnamed"] is not None else [])]
    return [(caption, causes) for caption, causes in found if causes]


def _carriers(causes: list[dict[str, Any]], members: list[dict[str, Any]]) -> Picture:
    """Scans against causes, the probability that each has each."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    causes, members = causes[:_SHOWN], members[:_MANY]
    table = np.array([[m["probability"] for m in c["members"][:_MANY]] for c in causes]).T
    height = 1.6 + _ROW * len(members)
    figure = new_figure(7.0, height)
    ax = figure.add_axes((0.26, 1.35 / height, 0.58, (height - 1.45) / height))
    colouring = ScalarMappable(Normalize(0, 1), "viridis")
    ax.imshow(np.asarray(colouring.to_rgba(table)), aspect="auto", interpolation="none")
    ax.set_yticks(range(len(members)), [drawable(m["subject"]) for m in members], fontsize=7)
    labels = [drawable("+".join(c["effects"]), 30) or "no name" for c in causes]
    ax.set_xticks(range(len(causes)), labels, rotation=25, ha="right", fontsize=7)
    ax.tick_params(length=0)
    bar = figure.colorbar(colouring, cax=figure.add_axes((0.87, 1.35 / height, 0.02, (height - 1.45) / height)))
    bar.set_label("probability that the scan has it")
    alt = f"Probability of each of {len(causes)} causes in {len(members)} scans."
    return picture(figure, alt=alt, heading="Which scans share which cause")


def _strengths(causes: list[dict[str, Any]]) -> list[Picture]:
    """The leading cause in every scan where it was fitted, with the mean over scans."""
    leader = causes[0]
    known = [m for m in leader["members"] if m["amplitude"] is not None][:_MANY]
    if leader["amplitude"] is None or len(known) < 2:
        return []
    height = 0.8 + _ROW * len(known)
    figure = new_figure(7.0, height)
    ax = figure.add_axes((0.26, 0.5 / height, 0.7, (height - 0.6) / height))
    mean = leader["amplitude"]
    ax.axvspan(mean["low"], mean["high"], color=QUIET, alpha=0.25, lw=0)
    ax.axvline(mean["value"], color=FIT_INK, lw=1.0)
    for place, member in enumerate(reversed(known)):
        size = member["amplitude"]
        ax.plot([size["low"], size["high"]], [place, place], color=QUIET, lw=1.5)
        ax.plot(size["value"], place, "o", color=DATA_INK, ms=3.5)
    ax.set_yticks(range(len(known)), [drawable(m["subject"]) for m in reversed(known)], fontsize=7)
    name = "+".join(leader["effects"])
    ax.set_xlabel(f"{name} ({mean['unit']})" if mean["unit"] != "1" else f"{name} (relative)")
    alt = f"{name} in {len(known)} scans with 90 % intervals; mean {mean['value']:.3g} in the band."
    return [picture(figure, alt=alt, heading="How strong it is in each scan", caption="Band: the mean, 90 % interval.")]
