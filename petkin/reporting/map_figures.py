"""Pictures of parameter maps: three planes, one colour bar with its unit, failures in plain sight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from petkin.fitting.results import Status
from petkin.reporting.canvas import INK, QUIET, Picture, embedded
from petkin.reporting.contents import MapSet, ParameterMap
from petkin.reporting.planes import Plane
from petkin.reporting.quantiles import ordered, percentiles
from petkin.reporting.svg import image, shape, svg, words
from petkin.reporting.verdict import status_counts
from petkin.reporting.wording import count, number, percent, round_values, status_short, symbol_svg, unit_text

#: Perceptually uniform, ordered in grey, safe for colour-blind readers (Smith & van der Walt 2015; Nunez et al. 2018).
_VALUE_COLOURS, _ERROR_COLOURS, _SIGNED_COLOURS = "viridis", "cividis", "RdBu_r"
#: Colours of a scale; behind them in a palette come those of a voxel without a value and of none.
_COLOURS = 254
_NO_VALUE, _OUTSIDE = (184, 184, 184, 255), (255, 255, 255, 0)
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
#: Of a picture, in points: planes at most, between them, around them; the colour bar; room for what is right of planes.
_WIDEST, _TALLEST, _GAP, _TOP, _BOTTOM, _SIDE = 353.0, 180.0, 17.0, 22.0, 9.0, 9.0
_BAR, _TALLEST_BAR, _ARROW, _RESERVE = 9.5, 137.0, 0.05, 71.0
_LEGEND, _LEGEND_LINE = 140.0, 14.0
_ZOOM = 1.25
_SMALL, _SMALLER, _SIZE, _LARGER = 6.5, 7.5, 8.0, 9.0
#: Width of a digit, and height of a capital, in font sizes.
_DIGIT, _CAPITAL = 0.64, 0.73


@dataclass(frozen=True)
class Scale:
    """Colours from `low` to `high`, and whether values lie beyond them."""

    low: float
    high: float
    colours: str
    below: bool
    above: bool

    def codes(self, values: NDArray[np.floating]) -> NDArray[np.uint8]:
        """Palette entry of every value."""
        place = (np.where(np.isfinite(values), values, self.low) - self.low) / (self.high - self.low)
        known = np.rint(np.clip(place, 0.0, 1.0) * (_COLOURS - 1)).astype(np.uint8)
        return np.where(np.isfinite(values), known, np.uint8(_COLOURS))


@dataclass(frozen=True)
class _Layout:
    """Planes side by side at one scale: the whole picture's size, the box of each plane, where they end."""

    width: float
    height: float
    boxes: tuple[tuple[float, float, float, float], ...]
    right: float

    @property
    def middle(self) -> float:
        return _TOP + (self.height - _TOP - _BOTTOM) / 2


def map_pictures(maps: MapSet) -> list[tuple[Picture, Picture | None]]:
    """Value and standard error of every map."""
    return [
        (value_picture(maps, entry), None if entry.percent_se is None else error_picture(maps, entry))
        for entry in maps.maps
    ]


def value_picture(maps: MapSet, entry: ParameterMap) -> Picture:
    """Planes of one parameter with its colour bar."""
    values = np.asarray(entry.value)
    finite = ordered(values)
    label = symbol_svg(entry.symbol, f" ({unit_text(entry.unit) or 'unitless'})")
    scale = _scale(finite, *robust_limits(finite), _VALUE_COLOURS)
    return _coloured(maps, values, scale, label, alt=_describe(entry, finite), zoom=_ZOOM)


def error_picture(maps: MapSet, entry: ParameterMap) -> Picture:
    """Planes of its standard error in percent, from 0 to at most 100."""
    values = np.asarray(entry.percent_se)
    finite = ordered(values)
    high = min(robust_limits(finite)[1], 100.0)
    scale = _scale(finite, 0.0, high if high > 0 else 1.0, _ERROR_COLOURS)
    alt = _describe_error(entry, ordered(values[maps.status == Status.OK]))
    return _coloured(maps, values, scale, Markup("SE of ") + symbol_svg(entry.symbol, " (%)"), alt=alt, zoom=1.0)


def signed_picture(maps: MapSet, entry: ParameterMap, limit: float, *, alt: str) -> Picture:
    """Planes of values of either sign, coloured from -limit to limit."""
    values = np.asarray(entry.value)
    scale = _scale(ordered(values), -limit, limit, _SIGNED_COLOURS)
    return _coloured(maps, values, scale, symbol_svg(entry.symbol, ""), alt=alt, zoom=_ZOOM)


def status_picture(maps: MapSet) -> Picture:
    """Where fits are missing or doubtful, with a legend that counts them."""
    counts = status_counts(maps.status)
    total = sum(counts.values())
    text = ", ".join(f"{count(n)} {status_short(s)}" for s, n in counts.items()) or "the mask is empty"
    layout = _laid_out(maps.planes, _LEGEND)
    palette = np.array([[*bytes.fromhex(_status_colour(s)[1:]), 255 * (s != Status.OUTSIDE)] for s in Status], np.uint8)
    parts = _planes(maps, layout, lambda numbers: maps.status[numbers], Status.OUTSIDE, palette)
    top = layout.middle - 0.5 * _LEGEND_LINE * len(counts)
    for i, (status, n) in enumerate(counts.items()):
        label = f"{status_short(status)} ({percent(100.0 * n / max(total, 1))})"
        parts += _legend_entry(layout.right, top + i * _LEGEND_LINE, _status_colour(status), label)
    alt = f"Status map of {count(total)} voxels: {text}."
    return embedded(svg(layout.width, layout.height, parts), (layout.width, layout.height), alt=alt)


def _legend_entry(x: float, y: float, colour: str, label: str) -> list[str]:
    box = [(x, y + 3), (x + 10, y + 3), (x + 10, y + 11), (x, y + 11)]
    return [shape(box, fill=colour, line=QUIET), words(x + 15, y + 10, label, size=_SIZE, colour=INK)]


def _status_colour(status: Status) -> str:
    return STATUS_COLOURS.get(status, _OTHER_COLOUR)


def robust_limits(ascending: NDArray[np.floating]) -> tuple[float, float]:
    """The 2nd and 98th percentile of ascending values, widened where they fall together; (0, 1) without any."""
    if ascending.size == 0:
        return 0.0, 1.0
    low, high = percentiles(ascending, _LIMITS)
    if high - low <= 1e-9 * max(abs(high), abs(low)):
        spread = 0.1 * abs(high) or 1.0
        return low - spread, high + spread
    return low, high


def _scale(ascending: NDArray[np.floating], low: float, high: float, colours: str) -> Scale:
    beyond = (bool(ascending[0] < low), bool(ascending[-1] > high)) if ascending.size else (False, False)
    return Scale(low, high, colours, *beyond)


@cache
def _palette(colours: str) -> NDArray[np.uint8]:
    from matplotlib import colormaps

    return np.vstack([colormaps[colours](np.linspace(0, 1, _COLOURS), bytes=True), _NO_VALUE, _OUTSIDE]).astype(
        np.uint8
    )


def _coloured(
    maps: MapSet, values: NDArray[np.floating], scale: Scale, label: Markup, *, alt: str, zoom: float
) -> Picture:
    layout = _laid_out(maps.planes, _RESERVE)
    palette = _palette(scale.colours)
    parts = _planes(maps, layout, lambda numbers: scale.codes(values[numbers]), _COLOURS + 1, palette)
    parts += _bar(layout, scale, palette, label)
    return embedded(svg(layout.width, layout.height, parts), (layout.width, layout.height), alt=alt, zoom=zoom)


def _bar(layout: _Layout, scale: Scale, palette: NDArray[np.uint8], label: Markup) -> list[str]:
    """One colour bar; arrows where values lie beyond its ends."""
    tall = min(layout.height - _TOP - _BOTTOM, _TALLEST_BAR)
    arrow, left, right = _ARROW * tall, layout.right, layout.right + _BAR
    top, bottom = layout.middle - tall / 2 + arrow, layout.middle + tall / 2 - arrow
    parts = [image((left, top, _BAR, bottom - top), np.arange(_COLOURS, dtype=np.uint8)[::-1, None], palette)]
    parts.append(shape([(left, top), (right, top), (right, bottom), (left, bottom)], line=QUIET))
    ends = ((scale.above, top, -arrow, palette[_COLOURS - 1]), (scale.below, bottom, arrow, palette[0]))
    for there, y, up, colour in ends:
        if there:
            tip = [(left, y), (right, y), ((left + right) / 2, y + up)]
            parts.append(shape(tip, fill=f"#{colour[:3].tobytes().hex()}", line=QUIET))
    ticks = round_values(scale.low, scale.high)
    for value, text in ticks.items():
        y = bottom - (bottom - top) * (value - scale.low) / (scale.high - scale.low)
        parts.append(shape([(right, y), (right + 3, y)], line=QUIET))
        parts.append(words(right + 5, y + _CAPITAL * _SIZE / 2, text, size=_SIZE, colour=INK))
    beside = right + 5 + _DIGIT * _SIZE * max(map(len, ticks.values()), default=0) + 1.4 * _SIZE
    x = min(beside, layout.width - 3)
    return [*parts, words(x, layout.middle, label, size=_LARGER, colour=INK, anchor="middle", upwards=True)]


def _laid_out(planes: list[Plane], reserve: float) -> _Layout:
    """One box a plane, all at one scale; `reserve` points stay free to their right."""
    widths, heights = [p.size_mm[0] for p in planes], [p.size_mm[1] for p in planes]
    gaps = _GAP * max(len(planes) - 1, 0)
    scale = min((_WIDEST - gaps) / max(sum(widths), 1e-9), _TALLEST / max(heights, default=1.0))
    right = _SIDE + scale * sum(widths) + gaps + 11.0
    height = max(scale * max(heights, default=1.0), 72.0) + _TOP + _BOTTOM
    boxes, x = [], _SIDE
    for w, h in zip(widths, heights):
        boxes.append((x, _TOP + (height - _TOP - _BOTTOM - scale * h) / 2, scale * w, scale * h))
        x += scale * w + _GAP
    return _Layout(max(right + reserve, 180.0), height, tuple(boxes), right)


def _planes(
    maps: MapSet,
    layout: _Layout,
    codes: Callable[[NDArray[np.int32]], NDArray[np.uint8]],
    outside: int,
    palette: NDArray[np.uint8],
) -> list[str]:
    """All planes with their names, sides and one scale bar; `codes` tells the palette entries of voxels by number."""
    parts = []
    for plane, (x, y, width, height) in zip(maps.planes, layout.boxes):
        numbers = plane.cut(maps.numbers)[::-1]
        pixels = np.full(numbers.shape, outside, np.uint8)
        pixels[numbers >= 0] = codes(numbers[numbers >= 0])
        parts.append(image((x, y, width, height), pixels, palette))
        parts.append(words(x + width / 2, y - 4, plane.label, size=_SMALLER, colour=QUIET, anchor="middle"))
        for letter, at, anchor in zip(plane.sides, (x, x + width), ("start", "end")):
            low = y + 0.03 * height + _CAPITAL * _SMALLER
            parts.append(words(at, low, letter, size=_SMALLER, colour=QUIET, anchor=anchor))
    return [*parts, *(_scale_bar(maps.planes[0], layout.boxes[0]) if maps.planes else ())]


def _scale_bar(plane: Plane, box: tuple[float, float, float, float]) -> list[str]:
    (x, y, width, height), wide_mm = box, plane.size_mm[0]
    length = max((mm for mm in (1, 2, 5, 10, 20, 50, 100) if mm <= 0.3 * wide_mm), default=1)
    bar = shape([(x, y + height), (x + width * length / wide_mm, y + height)], line=INK, width=1.4)
    return [bar, words(x, y + 0.985 * height - 1, f"{length} mm", size=_SMALL, colour=INK)]


def _describe(entry: ParameterMap, ascending: NDArray[np.floating]) -> str:
    if ascending.size == 0:
        return f"Map of {entry.symbol}: no voxel has a value."
    low, median, high = percentiles(ascending, (_LIMITS[0], 50, _LIMITS[1]))
    unit = unit_text(entry.unit)
    return (
        f"Map of {entry.symbol} in {count(ascending.size)} voxels: median {number(median)} {unit}".rstrip()
        + f", 2nd to 98th percentile {number(low)} to {number(high)}."
    )


def _describe_error(entry: ParameterMap, ascending: NDArray[np.floating]) -> str:
    if ascending.size == 0:
        return f"Map of the standard error of {entry.symbol}: no voxel has one."
    median, high = percentiles(ascending, (50, 90))
    return f"Map of the standard error of {entry.symbol}: median {percent(median)}, 90th percentile {percent(high)}."
