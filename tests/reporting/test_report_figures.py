"""What the figures draw, read back from the Figure objects."""

from __future__ import annotations

import base64
from dataclasses import replace

import numpy as np
import pytest

from petkin.imaging import FrameSchedule
from petkin.reporting import BloodSamples, InputCurves, RegionCurves
from petkin.reporting.canvas import drawable, drawing
from petkin.reporting.curve_figures import CurvePanel, chosen_regions, heat_figure
from petkin.reporting.input_figures import course_figure, early_end, input_pictures, parent_figure, rise_figure
from petkin.reporting.residuals import standardised_residuals

from . import report_examples as examples

FIGURES = (rise_figure, course_figure)


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
    for ax, samples in ((rise, 6), (course, 16)):  # the close-up has those of its own time
        points = [line for line in ax.lines if line.get_linestyle() == "None"]
        assert [np.size(line.get_xdata()) for line in points] == [samples, samples]
        lines = [line for line in ax.lines if line.get_linestyle() != "None"]
        assert len({line.get_linestyle() for line in lines}) == 3


def test_of_a_dense_record_only_what_can_be_seen_is_drawn() -> None:
    seconds = np.linspace(0.0, 60.0, 3601)
    sampler = BloodSamples("whole blood", seconds, 50 * np.exp(-seconds / 30))
    curves = InputCurves(seconds, sampler.value, samples=(sampler,), whole_blood=sampler.value)
    shown = [next(line for line in f(curves).axes[0].lines if line.get_linestyle() == "None") for f in FIGURES]
    assert [np.size(line.get_xdata()) for line in shown] == [121, 3601]
    svg = base64.b64decode(input_pictures(curves)[1].uri.split(",")[1]).decode()
    assert 100 < svg.count("<use") < 400


def test_input_that_is_zero_or_unknown_is_drawn() -> None:
    t = np.linspace(0, 60, 61)
    for aif in (np.zeros(61), np.full(61, np.nan)):
        curves = InputCurves(t, aif, end=40.0)
        assert rise_figure(curves).axes[0].get_ylim()[0] == 0
        low, high = course_figure(curves).axes[0].get_ylim()
        assert 0 < low < high


def test_any_name_becomes_one_drawable_line() -> None:
    assert drawable("a\n\tb  c") == "a b c"
    assert drawable("海馬 left") == "□□ left"
    assert drawable("x" * 40) == "x" * 27 + "…"
