"""Figures without pyplot: one style, one way to turn a figure into bytes that do not depend on clock or settings."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, QUIET, FAINT = "#1c2430", "#5b6675", "#d5dae1"
DATA_INK, EXCLUDED_INK, FIT_INK = "#1c2430", "#a9b1bc", "#d1495b"
#: Text stays text in the SVG: sharp, searchable, small. `hashsalt` fixes the ids.
_STYLE = {
    "svg.hashsalt": "petkin",
    "svg.fonttype": "none",
    "font.family": ["DejaVu Sans"],
    "font.size": 9,
    "axes.labelsize": 9,
    "axes.linewidth": 0.7,
    "axes.edgecolor": QUIET,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "xtick.color": QUIET,
    "ytick.color": QUIET,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "figure.facecolor": "white",
    "path.simplify": True,
    "path.simplify_threshold": 0.1,
}
_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}
_PIXELS_PER_INCH, _POINTS_PER_INCH = 96, 72
_ROUND_MINUTES = (
    0.0,
    0.1,
    0.2,
    0.5,
    1.0,
    2.0,
    5.0,
    10.0,
    20.0,
    30.0,
    45.0,
    60.0,
    90.0,
    120.0,
    180.0,
    240.0,
    360.0,
    480.0,
)


@dataclass(frozen=True)
class Picture:
    """An image ready for an `<img>`: data URI, size in CSS pixels, the text that replaces it, and a heading."""

    uri: str
    width: int
    height: int
    alt: str
    heading: str = ""
    caption: str = ""


@contextmanager
def drawing() -> Iterator[None]:
    """matplotlib in the report's style, whatever the user's own settings are."""
    from matplotlib import style

    with style.context(["default", _STYLE]):
        yield


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of so many inches that no pyplot knows of."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def picture(figure: Figure, *, alt: str, heading: str = "", caption: str = "", zoom: float = 1.0) -> Picture:
    """The figure as an SVG data URI, shown `zoom` times its size. Call within `drawing()`."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", dpi=144, metadata=_NO_METADATA)
    width, height = _POINTS_PER_INCH * figure.get_size_inches()
    size = float(width), float(height)
    return embedded(_shortened(buffer.getvalue()), size, alt=alt, heading=heading, caption=caption, zoom=zoom)


def embedded(
    svg: str, size: tuple[float, float], *, alt: str, heading: str = "", caption: str = "", zoom: float = 1.0
) -> Picture:
    """An SVG of so many points as a data URI, shown `zoom` times its size."""
    uri = "data:image/svg+xml;base64," + base64.b64encode(svg.encode()).decode("ascii")
    width, height = (round(zoom * _PIXELS_PER_INCH * points / _POINTS_PER_INCH) for points in size)
    return Picture(uri, width, height, alt, heading, caption)


def _shortened(svg: str) -> str:
    """Half the size, no visible difference: no prologue, comments or group names, path coordinates to 0.01 point.

    The font is named once, with others to fall back on where a reader's machine has no DejaVu Sans.
    """
    svg = re.sub(r"<!--.*?-->", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    svg = re.sub(r' d="[^"]*"', lambda m: re.sub(r"(\.\d\d)\d+", r"\1", m.group()).replace(" \n", " "), svg)
    svg = re.sub(r'<g id="[a-zA-Z_.]+\d+">', "<g>", svg)
    svg = re.sub(r"font-family: 'DejaVu Sans';? ?", "", svg)
    svg = svg.replace("</style>", "text{font-family: 'DejaVu Sans', Verdana, Arial, sans-serif}</style>", 1)
    return re.sub(r">\s+<(?!/?tspan|/text)", "><", svg)


def drawable(text: str, longest: int = 28) -> str:
    """Any text as one line that the figure font can draw: foreign glyphs become "□", what is too long ends in "…"."""
    known = _glyphs()
    line = "".join(c if ord(c) in known else "□" for c in " ".join(text.split()))
    return line if len(line) <= longest else f"{line[: longest - 1]}…"


@cache
def _glyphs() -> frozenset[int]:
    from matplotlib.font_manager import findfont, get_font

    return frozenset(get_font(findfont("DejaVu Sans")).get_charmap())


def square_root_time(ax: Axes, end: float) -> None:
    """Spread early frames: time on a square-root scale, ticks at round minutes."""
    import numpy as np
    from matplotlib.ticker import FixedLocator, NullLocator

    ax.set_xscale("function", functions=(lambda t: np.sign(t) * np.sqrt(np.abs(t)), lambda u: np.sign(u) * u**2))
    ax.xaxis.set_major_locator(FixedLocator(_round_minutes(end)))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter("{x:g}")


def _round_minutes(end: float) -> list[float]:
    """Round times up to `end` that stand at least a twelfth of the axis apart on a square-root scale."""
    kept: list[float] = []
    for t in _ROUND_MINUTES:
        if t <= end and (not kept or t**0.5 - kept[-1] ** 0.5 >= end**0.5 / 12):
            kept.append(t)
    return kept
