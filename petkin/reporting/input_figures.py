"""Pictures of the input function: its rise, its tail, and how much of it is still the tracer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from petkin.reporting.canvas import Picture, new_figure, picture
from petkin.reporting.input_curves import InputCurves
from petkin.reporting.wording import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Colour, line and marker of each curve: told apart without colour, too.
_LOOKS = {
    "AIF": ("#d1495b", "-", "o"),
    "total plasma": ("#c77700", "--", "s"),
    "whole blood": ("#0072b2", "-.", "^"),
    "parent fraction": ("#2a7f62", "-", "D"),
}
_LONG_NAMES = {"AIF": "AIF (parent in plasma)"}
_DECADES = 4.0
#: More samples than this come from an autosampler and get small points.
_DENSE = 60
#: Such points are left out where they would hide each other: their distance as a share of the plot's diagonal.
_APART = 0.004


def input_pictures(curves: InputCurves) -> list[Picture]:
    """Rise (linear), whole course (logarithmic) and, where known, parent fraction. Call within `canvas.drawing()`."""
    peak = int(np.nanargmax(curves.aif)) if np.isfinite(curves.aif).any() else 0
    rise = (
        f"Input function, first {number(early_end(curves), 2)} min: AIF peak {number(float(curves.aif[peak]))} kBq/mL "
        f"at {number(float(curves.time[peak]), 2)} min."
    )
    last = (
        f"Input function to {number(float(curves.time[-1]))} min: AIF ends at {number(float(curves.aif[-1]))} kBq/mL."
    )
    pictures = [
        picture(rise_figure(curves), alt=rise, heading="Rise"),
        picture(course_figure(curves), alt=last, heading="Whole course, logarithmic"),
    ]
    if curves.parent_fraction is not None or any(s.curve == "parent fraction" for s in curves.samples):
        pictures.append(picture(parent_figure(curves), alt=_describe_parent(curves), heading="Parent fraction"))
    return pictures


def early_end(curves: InputCurves) -> float:
    """End of the close-up, min: four times the time of the peak, between 2 min and the end of the scan."""
    at_peak = float(curves.time[np.nanargmax(curves.aif)]) if np.isfinite(curves.aif).any() else 1.0
    return min(max(2.0, 4.0 * at_peak), float(curves.time[-1]))


def rise_figure(curves: InputCurves) -> Figure:
    """The first minutes on linear axes."""
    figure, ax = _activity_axes()
    end = early_end(curves)
    _draw_activity(ax, curves, end)
    shown = [v[t <= end] for t, v in _activities(curves).values()] + [
        s.value[s.time <= end] for s in curves.samples if s.curve != "parent fraction"
    ]
    high = max((float(np.nanmax(v)) for v in shown if np.isfinite(v).any()), default=1.0)
    ax.set_xlim(0, end)
    ax.set_ylim(0, 1.07 * high if high > 0 else 1.0)
    ax.legend(loc="upper right", handlelength=2.2)
    return figure


def course_figure(curves: InputCurves) -> Figure:
    """The whole scan on a logarithmic axis; values at or below zero have no place on it."""
    from matplotlib.ticker import LogLocator, NullFormatter

    figure, ax = _activity_axes()
    ax.set_ylim(*_log_limits(curves))
    ax.set_yscale("log", nonpositive="mask")
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter(NullFormatter())
    _draw_activity(ax, curves, float(curves.time[-1]))
    ax.set_xlim(0, 1.02 * float(curves.time[-1]))
    if curves.end < curves.time[-1]:
        ax.axvline(curves.end, color="#5b6675", linewidth=0.8, linestyle=":")
        ax.text(curves.end, 0.98, "last sample ", transform=ax.get_xaxis_transform(), ha="right", va="top", fontsize=8)
    return figure


def _log_limits(curves: InputCurves) -> tuple[float, float]:
    """From 0.6 times the lowest last value (at most four decades below the peak) to 1.5 times the peak."""
    values = np.concatenate([v for _, v in _activities(curves).values()])
    values = values[np.isfinite(values) & (values > 0)]
    if values.size == 0:
        return 0.1, 1.0
    high = float(values.max())
    last = [float(v[-1]) for _, v in _activities(curves).values() if np.isfinite(v[-1]) and v[-1] > 0]
    return max(0.6 * min(last, default=float(values.min())), high * 10**-_DECADES), 1.5 * high


def parent_figure(curves: InputCurves) -> Figure:
    """Fraction of plasma activity that is unchanged tracer."""
    figure, ax = _axes()
    colour, line, marker = _LOOKS["parent fraction"]
    if curves.parent_fraction is not None:
        ax.plot(curves.time, curves.parent_fraction, color=colour, linestyle=line, linewidth=1.3)
    for samples in curves.samples:
        if samples.curve == "parent fraction":
            ax.plot(samples.time, samples.value, color=colour, marker=marker, markersize=4, linestyle="none")
    ax.set_xlim(0, 1.02 * float(curves.time[-1]))
    ax.set_ylim(0, 1.05)
    ax.set_ylabel("parent fraction (unitless)")
    return figure


def _axes() -> tuple[Figure, Axes]:
    figure = new_figure(3.9, 2.7)
    ax = figure.add_axes((0.155, 0.165, 0.825, 0.80))
    ax.set_xlabel("time (min)")
    return figure, ax


def _activity_axes() -> tuple[Figure, Axes]:
    figure, ax = _axes()
    ax.set_ylabel("activity (kBq/mL)")
    return figure, ax


def _activities(curves: InputCurves) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    found = {"AIF": curves.aif, "total plasma": curves.total_plasma, "whole blood": curves.whole_blood}
    return {name: (curves.time, values) for name, values in found.items() if values is not None}


def _draw_activity(ax: Axes, curves: InputCurves, until: float) -> None:
    for name, (time, values) in _activities(curves).items():
        colour, line, _ = _LOOKS[name]
        ax.plot(time, values, color=colour, linestyle=line, linewidth=1.2, label=_LONG_NAMES.get(name, name))
    for samples in curves.samples:
        if samples.curve != "parent fraction":
            colour, _, marker = _LOOKS.get(samples.curve, ("#5b6675", "-", "x"))
            size, apart = (2.8, None) if samples.time.size <= _DENSE else (1.2, _APART)
            look = {"color": colour, "marker": marker, "markersize": size, "markevery": apart}
            shown = samples.time <= until
            ax.plot(samples.time[shown], samples.value[shown], linestyle="none", **look)


def _describe_parent(curves: InputCurves) -> str:
    if curves.parent_fraction is None or not np.isfinite(curves.parent_fraction[-1]):
        return "Parent fraction over time."
    return f"Parent fraction over time: {number(float(curves.parent_fraction[-1]), 2)} at the end of the scan."
