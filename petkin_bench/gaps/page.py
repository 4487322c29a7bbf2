"""The answer about runs as a page: verdict, residuals, tracks without and with the cause, causes, what is hidden."""

from __future__ import annotations

from typing import Any

import numpy as np
from jinja2 import ChoiceLoader, PackageLoader
from numpy.typing import NDArray

from petkin.diagnosis import Diagnosis
from petkin.reporting.canvas import DATA_INK, FIT_INK, Picture, drawing, new_figure, picture
from petkin.reporting.gap_report import cause_bars, grade_of
from petkin.reporting.html import environment
from petkin.reporting.tables import Cell, Table
from petkin_bench.gaps.moving import MovingBodies

Array = NDArray[np.float64]

#: Tracks that are drawn, those of the largest residuals; colours of residuals end here, in units of the noise; d' that
#: is next to nothing.
_SHOWN, _LIMIT, _LEAST = 6, 4.0, 0.1
_BEFORE = "#3f7cac"


def render_body_page(simulator: MovingBodies, found: Diagnosis, answer: dict[str, Any]) -> str:
    """The page as HTML text; the same diagnosis gives the same bytes."""
    leader = found.causes[0].fit if found.causes else None
    env = environment()
    env.loader = ChoiceLoader([*filter(None, [env.loader]), PackageLoader("petkin_bench.gaps")])
    with drawing():
        heat = [_heat(simulator, found.base.residual, "without a cause")]
        if leader is not None:
            heat.append(_heat(simulator, leader.residual, "with the likeliest cause"))
        return env.get_template("body_report.html.j2").render(
            title=f"{simulator.body.name.replace('_', ' ').capitalize()}: where the law and the runs part",
            answer=answer,
            grade=grade_of(answer),
            facts=_facts(simulator, answer),
            heat=heat,
            tracks=_tracks(simulator, found.base.values, None if leader is None else leader.values),
            bars=cause_bars(answer) if answer["causes"] else None,
            causes=_causes(answer),
            parameters=_parameters(answer),
            visible=_visible(found),
        )


def _facts(simulator: MovingBodies, answer: dict[str, Any]) -> list[tuple[str, str]]:
    body, gap = simulator.body, answer["gap"]
    return [
        ("Runs", f"{len(simulator.data)} of {body.frames} frames, {body.interval:.3g} s apart"),
        ("Points in a picture", str(body.shown)),
        ("Gap", f"p = {gap['p_value']:.2g}, chi-square {gap['chi2_per_dof']:.3g} a degree of freedom"),
    ]


def _tracks(simulator: MovingBodies, before: Array, after: Array | None) -> list[Picture]:
    """Coordinates over time, those of the largest residuals."""
    body = simulator.body
    measured, without = (_places(simulator, values) for values in (simulator.samples, before))
    there = None if after is None else _places(simulator, after)
    energy = ((measured - without) ** 2).sum(axis=-1)
    times, found = np.arange(body.frames) * body.interval, []
    for place in np.sort(np.argsort(-energy.ravel(), kind="stable")[:_SHOWN]):
        run, point, axis = np.unravel_index(place, energy.shape)
        figure = new_figure(4.4, 2.7)
        ax = figure.add_axes((0.15, 0.17, 0.82, 0.78))
        ax.plot(times, measured[run, point, axis], "o", ms=2.2, color=DATA_INK, label="seen")
        ax.plot(times, without[run, point, axis], color=_BEFORE, lw=1.1, label="law as it is")
        if there is not None:
            ax.plot(times, there[run, point, axis], color=FIT_INK, lw=1.1, ls="--", label="with the cause")
        ax.set_xlabel("time (s)")
        ax.set_ylabel(f"{'xy'[axis]} (halves of the picture)")
        ax.legend(loc="best")
        name = f"Run {run + 1}" + (f", point {point + 1}" if body.shown > 1 else "") + f", {'xy'[axis]}"
        found.append(picture(figure, alt=f"{name}: seen, and predicted without and with the cause.", heading=name))
    return found


def _places(simulator: MovingBodies, samples: Array) -> Array:
    """Samples as places (trials, P, 2, T)."""
    return simulator.places(samples).reshape(len(samples), -1, 2, simulator.body.frames)


def _heat(simulator: MovingBodies, residual: Array, when: str) -> Picture:
    """Residuals of every run over frames, the root of their mean square over what a frame shows."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    runs = len(simulator.data)
    values = np.sqrt((residual.reshape(runs, -1, simulator.body.frames) ** 2).mean(axis=1))
    height = 1.1 + max(0.24 * runs, 0.6)
    figure = new_figure(9.0, height)
    ax = figure.add_axes((0.1, 0.55 / height, 0.78, (height - 0.65) / height))
    colouring = ScalarMappable(Normalize(0.0, _LIMIT, clip=True), "Reds")
    ax.imshow(np.asarray(colouring.to_rgba(values)), aspect="auto", interpolation="none")
    ax.set_yticks(range(runs), [f"run {r + 1}" for r in range(runs)], fontsize=7)
    ax.set_xlabel("frame (from 0)")
    ax.tick_params(length=0)
    bar = figure.colorbar(colouring, cax=figure.add_axes((0.9, 0.55 / height, 0.014, (height - 0.65) / height)))
    bar.set_label("residual (noise SD)")
    alt = f"Residuals by run and frame {when}: {np.sqrt((residual**2).mean()):.2g} noise SD on average (1 expected)."
    return picture(figure, alt=alt, heading=f"Residuals {when}", caption=alt)


def _words(text: str) -> Cell:
    return Cell(text, kind="words")


def _causes(answer: dict[str, Any]) -> Table:
    rows = []
    for cause in answer["causes"]:
        closed = cause["closure"]
        sizes = [
            f"{key} {e['value']:.3g}{'' if e['unit'] == '1' else ' ' + e['unit']} ({e['low']:.3g} to {e['high']:.3g})"
            for key, e in cause["estimate"].items()
        ]
        share = "" if closed is None else f"{closed['value']:.0%} ({closed['low']:.0%} to {closed['high']:.0%})"
        cells = (
            " + ".join(cause["effects"]),
            f"{cause['probability']:.2g}",
            f"{cause['log_evidence_gain']:.3g}",
            share,
        )
        rows.append((*map(Cell, cells), _words("; ".join(sizes))))
    heads = (("cause", ""), ("probability", ""), ("log evidence", ""), ("closes", ""), ("estimates", "90 % interval"))
    return Table("Causes, likeliest first", heads, tuple(rows))


def _parameters(answer: dict[str, Any]) -> Table:
    rows = tuple(
        (
            Cell(p["symbol"], p["unit"]),
            Cell(f"{p['before']:.4g}"),
            Cell("" if p["after"] is None else f"{p['after']:.4g}"),
        )
        for p in answer["parameters"]
    )
    return Table(
        "What the cause does to the law's parameters", (("parameter", ""), ("before", ""), ("after", "")), rows
    )


def _visible(found: Diagnosis) -> Table:
    rows = []
    for v in found.visible:
        partner, cosine = v.partners[0] if v.partners else ("", 0.0)
        cells = f"{v.detectability:.3g}" if v.detectability >= _LEAST else "0", f"{v.kept:.1%}"
        rows.append(
            (Cell(v.hypothesis.name), *map(Cell, cells), _words(partner), Cell(f"{cosine:.2f}" if partner else ""))
        )
    heads = (("effect", ""), ("d'", ""), ("kept by the refit", ""), ("taken for", ""), ("cosine", ""))
    return Table("Every effect in these runs", heads, tuple(rows))
