"""What the figures draw, read back from the Figure objects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from petkin.fitting.results import Status
from petkin.imaging import FrameSchedule
from petkin.reporting import InputCurves, MapSet, ParameterMap, RegionCurves
from petkin.reporting.canvas import drawable, drawing
from petkin.reporting.curve_figures import CurvePanel, chosen_regions, heat_figure
from petkin.reporting.input_figures import course_figure, early_end, parent_figure, rise_figure
from petkin.reporting.map_figures import (
    STATUS_COLOURS,
    error_figure,
    robust_limits,
    status_figure,
    value_figure,
)
from petkin.reporting.residuals import standardised_residuals

from . import report_examples as examples


@pytest.fixture(autouse=True)
def _in_style():
    with drawing():
        yield


def _panel(report, fit=None) -> CurvePanel:
    fit = fit or report.models[0].regional
    return CurvePanel(report.regions, fit, standardised_residuals(report.regions, fit))


def test_curve_axes_carry_units_and_say_their_scale() -> None:
    figure = _panel(examples.report(2, maps=None)).figure
    assert [ax.get_ylabel() for ax in figure.axes] == ["activity (kBq/mL)", "residual (SD)"]
    assert figure.axes[1].get_xlabel() == "time (min), square-root scale"


def test_even_frames_keep_a_linear_time_axis() -> None:
    report = examples.report(1, maps=None)
    schedule = examples.frames([120] * 40)
    even = replace(report, regions=RegionCurves(("a",), schedule, report.regions.tacs))
    assert _panel(even).figure.axes[1].get_xlabel() == "time (min)"
    assert _panel(even).figure.axes[1].get_xscale() == "linear"


def test_frame_averages_are_bars_over_their_frames() -> None:
    report = examples.report(3, maps=None)
    panel = _panel(report)
    panel.show(2)
    schedule, tac = report.regions.frames, report.regions.tacs[2]
    bars = next(line for line in panel.figure.axes[0].lines if np.size(line.get_xdata()) == 3 * len(schedule))
    x, y = (np.reshape(v, (-1, 3)) for v in (bars.get_xdata(), bars.get_ydata()))
    fit_line, measured = panel.figure.axes[0].lines[:2]
    np.testing.assert_allclose(x[:, 0], schedule.start)
    np.testing.assert_allclose(x[:, 1], schedule.end)
    np.testing.assert_allclose(y[:, :2], np.stack([tac, tac], 1))
    assert np.isnan(y[:, 2]).all()
    assert measured is bars
    np.testing.assert_allclose(fit_line.get_xdata(), schedule.mid)


def test_frames_without_weight_are_drawn_apart_and_leave_no_residual() -> None:
    report = examples.report(1, maps=None)
    weights = np.array(report.models[0].regional.weights)
    weights[3] = 0
    fit = replace(report.models[0].regional, weights=weights)
    panel = _panel(report, fit)
    panel.show(0)
    measured, excluded = (np.reshape(line.get_ydata(), (-1, 3))[:, 0] for line in panel.figure.axes[0].lines[1:3])
    assert np.flatnonzero(np.isnan(measured)).tolist() == [3]
    assert np.flatnonzero(np.isfinite(excluded)).tolist() == [3]
    assert np.isnan(standardised_residuals(report.regions, fit)[0, 3])


def test_the_fitted_line_breaks_where_the_scan_was_interrupted() -> None:
    schedule = FrameSchedule(np.array([0.0, 5, 60, 65]), np.array([5.0, 10, 65, 70]))
    report = examples.report(1, maps=None)
    tacs = np.array([[1.0, 2, 3, 4]])
    fit = replace(report.models[0].regional, predicted=tacs, weights=np.ones(4))
    panel = CurvePanel(RegionCurves(("a",), schedule, tacs), fit, np.zeros((1, 4)))
    panel.show(0)
    line = panel.figure.axes[0].lines[0]
    assert np.flatnonzero(np.isnan(np.asarray(line.get_ydata()))).tolist() == [2]
    assert len(panel.figure.axes[0].patches) == 1


def test_residuals_are_weighted_and_scaled_by_chi2() -> None:
    curves = RegionCurves(("a", "b"), examples.frames([60, 60]), np.array([[3.0, 1.0], [1.0, 1.0]]))
    fit = replace(
        examples.report(2, maps=None).models[0].regional,
        predicted=np.array([[1.0, 2.0], [1.0, 1.0]]),
        weights=np.array([4.0, 1.0]),
        chi2=np.array([4.0, 0.0]),
    )
    np.testing.assert_allclose(standardised_residuals(curves, fit), [[2.0, -0.5], [0.0, 0.0]])


def test_twelve_regions_are_chosen_and_hold_the_worst() -> None:
    fit = examples.report(40, maps=None).models[0].regional
    chi2 = np.ones(40)
    chi2[[5, 17]] = 9.0, np.nan
    chosen = chosen_regions(replace(fit, chi2=chi2))
    assert len(chosen) == 12
    assert {5, 17} <= set(chosen)
    assert chosen == sorted(chosen)
    assert chosen_regions(examples.report(7, maps=None).models[0].regional) == list(range(7))


def test_heat_map_has_a_row_a_region_and_a_labelled_bar() -> None:
    report = examples.report(30, maps=None)
    report = replace(report, regions=replace(report.regions, names=("$x_1$ 左", *report.regions.names[1:])))
    figure = heat_figure(report.regions, report.models[0].regional)
    axes, bar = figure.axes
    assert axes.images[0].get_array().shape[:2] == (30, 40)
    assert axes.get_yticklabels()[0].get_text() == "1  $x_1$ □"
    assert axes.get_xlabel() == "frame number, and its middle (min)"
    assert bar.get_ylabel() == "residual (SD)"


def test_input_axes_carry_units_and_samples_are_points() -> None:
    curves = examples.input_curves()
    rise, course, parent = (f(curves).axes[0] for f in (rise_figure, course_figure, parent_figure))
    assert [a.get_xlabel() for a in (rise, course, parent)] == ["time (min)"] * 3
    assert [a.get_ylabel() for a in (rise, course)] == ["activity (kBq/mL)"] * 2
    assert parent.get_ylabel() == "parent fraction (unitless)"
    assert (rise.get_yscale(), course.get_yscale()) == ("linear", "log")
    assert rise.get_xlim()[1] == pytest.approx(early_end(curves))
    assert course.get_xlim()[1] >= 90
    for ax in (rise, course):
        points = [line for line in ax.lines if line.get_linestyle() == "None"]
        assert [np.size(line.get_xdata()) for line in points] == [16, 16]
        lines = [line for line in ax.lines if line.get_linestyle() != "None"]
        assert len({line.get_linestyle() for line in lines}) == 3


def test_input_that_is_zero_or_unknown_is_drawn() -> None:
    t = np.linspace(0, 60, 61)
    for aif in (np.zeros(61), np.full(61, np.nan)):
        curves = InputCurves(t, aif, end=40.0)
        assert rise_figure(curves).axes[0].get_ylim()[0] == 0
        low, high = course_figure(curves).axes[0].get_ylim()
        assert 0 < low < high


def test_map_has_three_planes_at_one_scale_and_one_bar_with_unit() -> None:
    maps = examples.map_set((16, 20, 16))
    figure = value_figure(maps, maps.maps[0])
    assert [ax.get_title() for ax in figure.axes] == ["axial, k = 8", "coronal, j = 10", "sagittal, i = 8", ""]
    assert figure.axes[-1].get_ylabel() == "K$_{\\mathrm{1}}$ (mL/cm³/min)"
    assert error_figure(maps, maps.maps[1]).axes[-1].get_ylabel() == "SE of V$_{\\mathrm{T}}$ (%)"
    assert value_figure(maps, maps.maps[2]).axes[-1].get_ylabel() == "v$_{\\mathrm{B}}$ (unitless)"
    width, height = figure.get_size_inches()
    scales = set()
    for ax in figure.axes[:3]:
        box, (left, right), (low, high) = ax.get_position(), ax.get_xlim(), ax.get_ylim()
        scales |= {round(box.width * width / (right - left), 6), round(box.height * height / (high - low), 6)}
    assert len(scales) == 1


def test_map_colours_hide_the_background_and_show_missing_values_grey() -> None:
    value = np.arange(64.0).reshape(4, 4, 4)
    status = np.zeros((4, 4, 4), np.uint8)
    status[0, 0, :] = Status.OUTSIDE
    value[1, 0, :] = np.nan
    maps = MapSet((ParameterMap("VT", "mL/cm3", value),), status, (2.0, 2.0, 2.0), "RAS")
    axial = np.asarray(value_figure(maps, maps.maps[0]).axes[0].images[0].get_array())
    assert axial[0, 0, 3] == 0
    np.testing.assert_allclose(axial[0, 1], [0.72, 0.72, 0.72, 1])
    assert (axial[1:, :, 3] == 1).all()


def test_standard_error_colours_end_at_a_hundred_percent() -> None:
    status = np.zeros((5, 5, 5), np.uint8)
    ones = np.ones((5, 5, 5))
    for percent, top in ((400.0, 100.0), (8.0, 8.8)):
        maps = MapSet((ParameterMap("K1", "mL/cm3/min", ones, percent * ones),), status, (2.0, 2.0, 2.0))
        low, high = error_figure(maps, maps.maps[0]).axes[-1].get_ylim()
        assert (low, high) == pytest.approx((0, top))


def test_status_map_legend_counts_each_status_with_its_own_colour() -> None:
    status = np.zeros((10, 10, 1), np.uint8)
    status[0, :5], status[1, :] = Status.AT_BOUND, Status.OUTSIDE
    figure = status_figure(MapSet((), status, (2.0, 2.0, 2.0)))
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["fitted (94\u202f%)", "on a bound (5.6\u202f%)"]
    assert len(figure.axes) == 1
    assert len(set(STATUS_COLOURS.values())) == len(Status) - 1


@pytest.mark.parametrize(
    ("values", "limits"),
    [
        (np.array([np.nan, np.inf]), (0.0, 1.0)),
        (np.zeros(5), (-1.0, 1.0)),
        (np.full(5, 2.0), (1.8, 2.2)),
        (np.append(np.linspace(0, 1, 101), np.nan), (0.02, 0.98)),
    ],
)
def test_robust_limits(values: np.ndarray, limits: tuple[float, float]) -> None:
    assert robust_limits(values) == pytest.approx(limits)


def test_any_name_becomes_one_drawable_line() -> None:
    assert drawable("a\n\tb  c") == "a b c"
    assert drawable("海馬 left") == "□□ left"
    assert drawable("x" * 40) == "x" * 27 + "…"
