"""Pictures of parameter maps: three planes, one colour bar with its unit, failures in plain sight."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.results import Status
from petkin.reporting.canvas import INK, QUIET, Picture, new_figure, picture
from petkin.reporting.contents import MapSet, ParameterMap
from petkin.reporting.planes import Plane
from petkin.reporting.verdict import status_counts
from petkin.reporting.wording import count, number, percent, status_short, symbol_math, unit_text, with_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Perceptually uniform, ordered in grey, safe for colour-blind readers (Smith & van der Walt 2015; Nunez et al. 2018).
_VALUE_COLOURS, _ERROR_COLOURS = "viridis", "cividis"
_NO_VALUE = (0.72, 0.72, 0.72, 1.0)
_LIMITS = (2.0, 98.0)
#: Okabe & Ito 2008, pale for what is in order, so that what is not stands out.
STATUS_COLOURS = {
    Status.OK: "#cfe3ec",
    Status.NOT_FINITE: "#000000",
    Status.NO_SIGNAL: "#8a8a8a",
    Status.AT_BOUND: "#e69f00",
    Status.NOT_IDENTIFIABLE: "#0072b2",
    Status.NOT_CONVERGED: "#d55e00",
    Status.SECOND_MINIMUM: "#cc79a7",
}
_OTHER_COLOUR = "#56b4e9"
_WIDEST, _TALLEST, _GAP, _TOP, _BOTTOM, _SIDE = 4.9, 2.5, 0.24, 0.3, 0.12, 0.12
_ZOOM = 1.25
_BAR, _BAR_LABELS, _LEGEND = 0.13, 0.85, 1.95


def map_pictures(maps: MapSet) -> list[tuple[Picture, Picture | None]]:
    """Value and standard error of every map. Call within `canvas.drawing()`."""
    pairs = []
    for entry in maps.maps:
        value = picture(value_figure(maps, entry), alt=_describe(maps, entry), zoom=_ZOOM)
        error = None
        if entry.percent_se is not None:
            error = picture(error_figure(maps, entry), alt=_describe_error(maps, entry))
        pairs.append((value, error))
    return pairs


def status_picture(maps: MapSet) -> Picture:
    """Where fits are missing or doubtful, with a legend that counts them."""
    counts = status_counts(maps.status)
    text = ", ".join(f"{count(n)} {status_short(s)}" for s, n in counts.items()) or "the mask is empty"
    return picture(status_figure(maps), alt=f"Status map of {count(sum(counts.values()))} voxels: {text}.")


def value_figure(maps: MapSet, entry: ParameterMap) -> Figure:
    """Planes of one parameter with its colour bar."""
    return _coloured(maps, entry.value, _VALUE_COLOURS, with_unit(symbol_math(entry.symbol), entry.unit))


def error_figure(maps: MapSet, entry: ParameterMap) -> Figure:
    """Planes of its standard error in percent, from 0 to at most 100."""
    values = np.full(maps.status.shape, np.nan) if entry.percent_se is None else entry.percent_se
    high = min(robust_limits(values[maps.inside])[1], 100.0)
    label = f"SE of {symbol_math(entry.symbol)} (%)"
    return _coloured(maps, values, _ERROR_COLOURS, label, limits=(0.0, high if high > 0 else 1.0))


def status_figure(maps: MapSet) -> Figure:
    """Planes of the status codes with a legend."""
    from matplotlib.colors import to_rgba
    from matplotlib.patches import Patch

    figure, axes, left = _laid_out(maps.planes, _LEGEND)
    for plane, ax in zip(maps.planes, axes):
        codes = plane.cut(maps.status)
        rgba = np.zeros((*codes.shape, 4))
        for code in np.unique(codes[codes != Status.OUTSIDE]):
            rgba[codes == code] = to_rgba(_status_colour(Status(int(code))))
        _show(ax, rgba, plane)
    counts = status_counts(maps.status)
    total = max(sum(counts.values()), 1)
    patches = [
        Patch(
            facecolor=_status_colour(s), edgecolor=QUIET, linewidth=0.5, label=f"{status_short(s)} {_share(n, total)}"
        )
        for s, n in counts.items()
    ]
    figure.legend(
        handles=patches, loc="center left", bbox_to_anchor=(left, 0.5), handlelength=1.2, handleheight=1.1, borderpad=0
    )
    return figure


def _share(n: int, total: int) -> str:
    return f"({percent(100.0 * n / total)})"


def _status_colour(status: Status) -> str:
    return STATUS_COLOURS.get(status, _OTHER_COLOUR)


def robust_limits(values: NDArray[np.floating]) -> tuple[float, float]:
    """The 2nd and 98th percentile of the finite values, widened where they fall together; (0, 1) without any."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(finite, _LIMITS))
    if high - low <= 1e-9 * max(abs(high), abs(low)):
        spread = 0.1 * abs(high) or 1.0
        return low - spread, high + spread
    return low, high


def _coloured(
    maps: MapSet, values: NDArray[np.floating], colours: str, label: str, *, limits: tuple[float, float] | None = None
) -> Figure:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    inside = values[maps.inside]
    low, high = limits or robust_limits(inside)
    colouring = ScalarMappable(Normalize(low, high, clip=True), colours)
    figure, axes, left = _laid_out(maps.planes, _BAR + _BAR_LABELS)
    for plane, ax in zip(maps.planes, axes):
        flat = plane.cut(values)
        rgba = np.asarray(colouring.to_rgba(np.where(np.isfinite(flat), flat, low)))
        rgba[~np.isfinite(flat)] = _NO_VALUE
        rgba[~plane.cut(maps.inside)] = 0.0
        _show(ax, rgba, plane)
    _draw_bar(figure, colouring, left, label, _beyond(inside, low, high))
    return figure


def _beyond(values: NDArray[np.floating], low: float, high: float) -> str:
    below, above = bool((values < low).any()), bool((values > high).any())
    return {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[below, above]


def _draw_bar(figure: Figure, colouring, left: float, label: str, extend: str) -> None:
    """One colour bar; arrows where values lie beyond its ends."""
    width, height = figure.get_size_inches()
    tall = min(height - _TOP - _BOTTOM, 1.9)
    bottom = (_BOTTOM + (height - _TOP - _BOTTOM - tall) / 2) / height
    ax = figure.add_axes((left, bottom, _BAR / width, tall / height))
    bar = figure.colorbar(colouring, cax=ax, extend=extend, extendfrac=0.05)
    bar.set_label(label)
    bar.outline.set_linewidth(0.5)  # pyright: ignore[reportCallIssue, reportAttributeAccessIssue]
    if bar.solids is not None:
        bar.solids.set_rasterized(True)


def _laid_out(planes: list[Plane], reserve: float) -> tuple[Figure, list[Axes], float]:
    """A figure with one axes a plane, all at one scale; `reserve` inches stay free from the returned fraction on."""
    widths, heights = [p.size_mm[0] for p in planes], [p.size_mm[1] for p in planes]
    free = _WIDEST - _GAP * max(len(planes) - 1, 0)
    scale = min(free / max(sum(widths), 1e-9), _TALLEST / max(heights, default=1.0))
    tall = scale * max(heights, default=1.0)
    used = scale * sum(widths) + _GAP * max(len(planes) - 1, 0)
    width, height = max(_SIDE + used + 0.15 + reserve, 2.5), max(tall, 1.0) + _TOP + _BOTTOM
    figure = new_figure(width, height)
    axes, x = [], _SIDE
    for w, h in zip(widths, heights):
        y = _BOTTOM + (height - _TOP - _BOTTOM - scale * h) / 2
        axes.append(figure.add_axes((x / width, y / height, scale * w / width, scale * h / height)))
        x += scale * w + _GAP
    if axes:
        _draw_scale(axes[0], planes[0])
    return figure, axes, (_SIDE + used + 0.15) / width


def _draw_scale(ax: Axes, plane: Plane) -> None:
    width, height = plane.size_mm
    length = max((mm for mm in (1, 2, 5, 10, 20, 50, 100) if mm <= 0.3 * width), default=1)
    ax.plot([0, length], [0.0, 0.0], color=INK, linewidth=1.4, solid_capstyle="butt", zorder=3, clip_on=False)
    ax.text(0, 0.015 * height, f"{length} mm", fontsize=6.5, color=INK, va="bottom", zorder=3)


def _show(ax: Axes, rgba: NDArray[np.floating], plane: Plane) -> None:
    width, height = plane.size_mm
    ax.imshow(rgba, interpolation="none", origin="lower", extent=(0, width, 0, height), aspect="equal")
    ax.set_axis_off()
    ax.set_title(plane.label, fontsize=7.5, color=QUIET, pad=3, y=1.0)  # told where, it need not look for ticks
    for letter, x, side in zip(plane.sides, (0.0, 1.0), ("left", "right")):
        ax.text(x, 0.97, letter, transform=ax.transAxes, fontsize=7.5, color=QUIET, ha=side, va="top")


def _describe(maps: MapSet, entry: ParameterMap) -> str:
    values = entry.value[maps.inside]
    values = values[np.isfinite(values)]
    if values.size == 0:
        return f"Map of {entry.symbol}: no voxel has a value."
    low, median, high = np.percentile(values, (_LIMITS[0], 50, _LIMITS[1]))
    unit = unit_text(entry.unit)
    return (
        f"Map of {entry.symbol} in {count(values.size)} voxels: median {number(median)} {unit}".rstrip()
        + f", 2nd to 98th percentile {number(low)} to {number(high)}."
    )


def _describe_error(maps: MapSet, entry: ParameterMap) -> str:
    errors = entry.percent_se[maps.status == Status.OK] if entry.percent_se is not None else np.empty(0)
    errors = errors[np.isfinite(errors)]
    if errors.size == 0:
        return f"Map of the standard error of {entry.symbol}: no voxel has one."
    median, high = np.percentile(errors, (50, 90))
    return f"Map of the standard error of {entry.symbol}: median {percent(median)}, 90th percentile {percent(high)}."
