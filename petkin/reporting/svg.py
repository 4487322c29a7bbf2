"""Pictures as SVG text, for what is only images, words and boxes: a hundred times as fast as figures with axes.

All lengths are points, from the upper left corner.
"""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

if TYPE_CHECKING:
    from jaxtyping import UInt8

_FONT = "'DejaVu Sans', Verdana, Arial, sans-serif"
_PNG = b"\x89PNG\r\n\x1a\n"
#: PNG: 8 bits a pixel, colours from a palette.
_INDEXED = (8, 3, 0, 0, 0)


def svg(width: float, height: float, parts: Iterable[str]) -> str:
    """A whole picture on white."""
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'width="{width:.2f}pt" height="{height:.2f}pt" viewBox="0 0 {width:.2f} {height:.2f}" font-family="{_FONT}">'
        f'<rect width="100%" height="100%" fill="white"/>{"".join(parts)}</svg>'
    )


def words(
    x: float, y: float, content: str, *, size: float, colour: str, anchor: str = "start", upwards: bool = False
) -> str:
    """One line of text whose base line begins (or has its middle or end) at a place; `Markup` may hold tspans."""
    turned = f' transform="rotate(-90 {x:.2f} {y:.2f})"' if upwards else ""
    return Markup('<text x="{:.2f}" y="{:.2f}" font-size="{:g}" fill="{}" text-anchor="{}"{}>{}</text>').format(
        x, y, size, colour, anchor, Markup(turned), content
    )


def shape(points: Iterable[tuple[float, float]], *, fill: str = "none", line: str = "none", width: float = 0.5) -> str:
    """A polygon, or with two points a line."""
    path = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
    return f'<polygon points="{path}" fill="{fill}" stroke="{line}" stroke-width="{width:g}"/>'


def image(
    box: tuple[float, float, float, float], codes: UInt8[NDArray, "rows columns"], palette: UInt8[NDArray, "colours 4"]
) -> str:
    """Pixels in a box (left, top, width, height), with sharp edges; rows from top to bottom."""
    data = base64.b64encode(png(codes, palette)).decode("ascii")
    x, y, width, height = box
    return (
        f'<image x="{x:.2f}" y="{y:.2f}" width="{width:.2f}" height="{height:.2f}" preserveAspectRatio="none" '
        f'style="image-rendering:pixelated" xlink:href="data:image/png;base64,{data}"/>'
    )


def png(codes: UInt8[NDArray, "rows columns"], palette: UInt8[NDArray, "colours 4"]) -> bytes:
    """A PNG of palette entries.

    Reference: ISO/IEC 15948, Portable Network Graphics.

    Args:
        codes: entry of every pixel.
        palette: red, green, blue, opacity of at most 256 entries.
    """
    rows, columns = codes.shape
    lines = np.insert(codes, 0, 0, axis=1)  # each line begins with the number of its filter: none
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", columns, rows, *_INDEXED)),
        (b"PLTE", palette[:, :3].tobytes()),
        (b"tRNS", palette[:, 3].tobytes()),
        (b"IDAT", zlib.compress(lines.tobytes(), 6)),
        (b"IEND", b""),
    )
    return _PNG + b"".join(
        struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        for kind, content in chunks
    )
