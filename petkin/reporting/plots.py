"""Pictures that methods add to a report: points, fitted lines, and a mark on the x axis."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.results import Plot
from petkin.reporting.canvas import QUIET, Picture, drawable, new_figure, picture
from petkin.reporting.wording import number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Colours (Okabe and Ito 2008) and markers, so that curves are told apart without colour, too.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_MARKERS = ("o", "s", "^", "D", "v", "P")


def plot_pictures(plots: tuple[Plot, ...], regions: tuple[str, ...]) -> list[Picture]:
    """One picture a plot. Call within `canvas.drawing()`.

    Args:
        plots: as a method made them; a curve's name is its number from 1.
        regions: names of the regions, shown instead of numbers.
    """
    return [
        picture(plot_figure(plot, regions), alt=_describe(plot, regions), heading=plot.title, caption=plot.text)
        for plot in plots
    ]


def plot_figure(plot: Plot, regions: tuple[str, ...]) -> Figure:
    """Points as measured, lines as fitted, the mark as a dashed vertical line."""
    figure = new_figure(3.9, 3.4)
    ax = figure.add_axes((0.155, 0.30, 0.825, 0.675))
    lines = {name: (x, y) for name, x, y in plot.lines}
    for n, (name, x, y) in enumerate(plot.points):
        colour, marker = _COLOURS[n % len(_COLOURS)], _MARKERS[n % len(_MARKERS)]
        label = drawable(_called(name, regions), 20)
        ax.plot(x, y, color=colour, marker=marker, linestyle="none", markersize=3.5, label=label)
        if name in lines:
            ax.plot(*lines[name], color=colour, linewidth=1.1)
    if plot.mark is not None:
        ax.axvline(plot.mark, color=QUIET, linewidth=0.8, linestyle="--")
    ax.set_xlabel(plot.x_label)
    ax.set_ylabel(plot.y_label)
    ax.set_ylim(_limits([y for _, _, y in (*plot.points, *plot.lines)]))
    legend = figure.legend(loc="lower center", ncols=3, handletextpad=0.1, columnspacing=0.8)
    for text in legend.get_texts():
        text.set_parse_math(False)
    return figure


def _called(name: str, regions: tuple[str, ...]) -> str:
    return regions[int(name) - 1] if name.isdigit() and int(name) <= len(regions) else name


def _limits(curves: list[NDArray[np.floating]]) -> tuple[float, float]:
    """The range of what is drawn; a point or two far outside are left out."""
    values = np.concatenate([*curves, np.zeros(1)])
    values = values[np.isfinite(values)]
    low, high = np.quantile(values, [0.01, 0.99])
    margin = 0.08 * (high - low) or 1.0
    return float(low - margin), float(high + margin)


def _describe(plot: Plot, regions: tuple[str, ...]) -> str:
    names = ", ".join(_called(name, regions) for name, _, _ in plot.points)
    mark = "" if plot.mark is None else f" A line marks {number(plot.mark)} on the x axis."
    return f"{plot.title}: {plot.y_label} against {plot.x_label} of {names}.{mark}"
