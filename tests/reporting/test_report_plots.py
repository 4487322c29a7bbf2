"""Pictures that methods add: what is drawn, under which name, on the page."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from petkin.fitting.results import Plot
from petkin.reporting import render_fit_report
from petkin.reporting.canvas import drawing
from petkin.reporting.plots import plot_figure, plot_pictures

from .report_examples import report

X = np.arange(8.0)
PLOT = Plot(
    title="Logan plot",
    x_label="int C_P / C_T (min)",
    y_label="int C_T / C_T (min)",
    points=(("2", X, 2 * X + 1), ("1", X, np.where(X == 3, np.nan, 3 * X)), ("mean $x$", X, X)),
    lines=(("2", X[4:], 2 * X[4:] + 1),),
    mark=4.0,
    text="t* = 30 min.",
)
REGIONS = ("Cortex", "Thalamus & co")


def test_curves_are_drawn_under_their_region_s_name_with_line_and_mark():
    with drawing():
        figure = plot_figure(PLOT, REGIONS)
        (shown,) = plot_pictures((PLOT,), REGIONS)
    (ax,) = figure.axes
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["Thalamus & co", "Cortex", "mean $x$"]
    assert len(ax.lines) == 5  # three sets of points, one line, the mark
    assert ax.lines[-1].get_xdata()[0] == 4.0
    assert (ax.get_xlabel(), ax.get_ylabel()) == (PLOT.x_label, PLOT.y_label)
    assert shown.heading == "Logan plot"
    assert shown.caption == "t* = 30 min."
    assert "Thalamus & co, Cortex, mean" in shown.alt
    assert "A line marks 4" in shown.alt


def test_far_points_do_not_flatten_the_plot():
    far = replace(PLOT, points=(("1", np.arange(200.0), np.r_[1e9, np.ones(199)]),), lines=())
    with drawing():
        assert plot_figure(far, REGIONS).axes[0].get_ylim()[1] < 10


def test_the_page_shows_them_where_a_method_made_them():
    plain = report(2, maps=None, models=1)
    assert "What the method rests on" not in render_fit_report(plain)
    first = plain.models[0]
    assert first.regional is not None
    section = replace(first, regional=replace(first.regional, plots=(PLOT,)))
    page = render_fit_report(replace(plain, models=(section, *plain.models[1:])))
    assert page.count("What the method rests on") == 1
    assert "t* = 30 min." in page
    assert page == render_fit_report(replace(plain, models=(section, *plain.models[1:])))
