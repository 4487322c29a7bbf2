"""What the pictures of maps show, read back from their SVG and the PNGs in it."""

from __future__ import annotations

import base64
import io
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from petkin.fitting.results import Status
from petkin.reporting import ParameterMap
from petkin.reporting.canvas import Picture
from petkin.reporting.map_figures import (
    STATUS_COLOURS,
    error_picture,
    map_pictures,
    robust_limits,
    status_picture,
    value_picture,
)
from petkin.reporting.quantiles import ordered, percentiles
from petkin.reporting.svg import png

from . import report_examples as examples

_SVG, _LINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}href"
_GREY = [184, 184, 184, 255]


def _drawn(picture: Picture) -> ElementTree.Element:
    return ElementTree.fromstring(base64.b64decode(picture.uri.split(",")[1]))


def _texts(picture: Picture) -> list[str]:
    return ["".join(text.itertext()) for text in _drawn(picture).iter(f"{_SVG}text")]


def _images(picture: Picture) -> list[np.ndarray]:
    """Pixels of all images as red, green, blue and opacity, from top to bottom."""
    data = [base64.b64decode(image.get(_LINK, "").split(",")[1]) for image in _drawn(picture).iter(f"{_SVG}image")]
    return [np.asarray(Image.open(io.BytesIO(content)).convert("RGBA")) for content in data]


def _box(image: ElementTree.Element) -> list[float]:
    return [float(image.get(name, "nan")) for name in ("x", "y", "width", "height")]


def test_map_has_three_planes_at_one_scale_and_one_bar_with_unit() -> None:
    maps = examples.map_set((16, 20, 16))
    picture = value_picture(maps, maps.maps[0])
    texts = _texts(picture)
    assert [t for t in texts if " = " in t] == ["axial, k = 8", "coronal, j = 10", "sagittal, i = 8"]
    assert [t for t in texts if len(t) == 1 and t.isalpha()] == list("LRLRPA")
    assert texts[-1] == "K1 (mL/cm³/min)"
    assert _texts(error_picture(maps, maps.maps[1]))[-1] == "SE of VT (%)"
    assert _texts(value_picture(maps, maps.maps[2]))[-1] == "vB (unitless)"
    *planes, bar = list(_drawn(picture).iter(f"{_SVG}image"))
    boxes = [_box(image) for image in planes]
    for plane, (_, _, width, height), pixels in zip(maps.planes, boxes, _images(picture), strict=False):
        assert width / plane.size_mm[0] == pytest.approx(boxes[0][2] / maps.planes[0].size_mm[0], rel=1e-3)
        assert height / plane.size_mm[1] == pytest.approx(width / plane.size_mm[0], rel=1e-3)
        assert pixels.shape[:2] == plane.cut(maps.mask).shape
    boxes.append(_box(bar))
    assert all(left[0] + left[2] < right[0] for left, right in pairwise(boxes))
    assert boxes[-1][0] + boxes[-1][2] < float(_drawn(picture).get("width", "nan")[:-2])


def test_scale_bar_is_as_long_as_it_says() -> None:
    maps = examples.map_set((16, 20, 16))
    picture = value_picture(maps, maps.maps[0])
    length = next(float(text.split()[0]) for text in _texts(picture) if text.endswith(" mm"))
    bar = next(line for line in _drawn(picture).iter(f"{_SVG}polygon") if line.get("stroke-width") == "1.4")
    start, end = (float(point.split(",")[0]) for point in bar.get("points", "").split())
    points_per_mm = _box(next(_drawn(picture).iter(f"{_SVG}image")))[2] / maps.planes[0].size_mm[0]
    assert end - start == pytest.approx(length * points_per_mm, abs=0.02)


def test_planes_show_the_voxels_they_say_the_upper_rows_first() -> None:
    value = np.arange(4.0 * 5 * 6).reshape(4, 5, 6)
    maps = examples.maps_of((ParameterMap("VT", "mL/cm3", value),), np.zeros(value.shape, np.uint8), (2, 2, 2), "RAS")
    shades = [image[..., 1].astype(int) for image in _images(value_picture(maps, maps.maps[0]))[:3]]
    for plane, shade in zip(maps.planes, shades, strict=True):
        expected = plane.cut(value)[::-1]
        assert shade.shape == expected.shape
        order = np.argsort(expected, axis=None)  # the green of these colours rises with the value
        assert (np.diff(shade.ravel()[order]) >= 0).all()
        assert len(np.unique(shade)) > 10


def test_map_colours_hide_the_background_and_show_missing_values_grey() -> None:
    value = np.arange(64.0).reshape(4, 4, 4)
    status = np.zeros((4, 4, 4), np.uint8)
    status[0, 0, :] = Status.OUTSIDE
    value[1, 0, :] = np.nan
    maps = examples.maps_of((ParameterMap("VT", "mL/cm3", value),), status, (2.0, 2.0, 2.0), "RAS")
    axial = _images(value_picture(maps, maps.maps[0]))[0][::-1]
    assert axial[0, 0, 3] == 0
    assert axial[0, 1].tolist() == _GREY
    assert (axial[1:, :, 3] == 255).all()
    assert not (axial[1:] == _GREY).all(axis=-1).any()


def test_standard_error_colours_end_at_a_hundred_percent() -> None:
    status = np.zeros((5, 5, 5), np.uint8)
    spread = np.linspace(0.9, 1.1, 125).reshape(status.shape)
    for percent, last, beyond in ((400.0, "100", 1), (8.0, "8", 1)):
        entry = ParameterMap("K1", "mL/cm3/min", spread, percent * spread)
        maps = examples.maps_of((entry,), status, (2.0, 2.0, 2.0))
        picture = error_picture(maps, maps.maps[0])
        numbers = [text for text in _texts(picture) if text.isdigit()]
        assert (numbers[0], numbers[-1]) == ("0", last)
        triangles = [p for p in _drawn(picture).iter(f"{_SVG}polygon") if len(p.get("points", "").split()) == 3]
        assert len(triangles) == beyond


def test_arrows_mark_values_beyond_the_colours() -> None:
    status, arrows = np.zeros((5, 5, 5), np.uint8), []
    for low, high in ((0.5, 0.5), (-9.0, 0.5), (0.5, 9.0), (-9.0, 9.0)):
        value = np.full(status.shape, 0.5)
        value[0, 0, 0], value[0, 0, 1] = low, high
        maps = examples.maps_of((ParameterMap("VT", "mL/cm3", value),), status, (2.0, 2.0, 2.0))
        shapes = _drawn(value_picture(maps, maps.maps[0])).iter(f"{_SVG}polygon")
        arrows.append([p.get("fill") for p in shapes if len(p.get("points", "").split()) == 3])
    assert arrows == [[], ["#440154"], ["#fde724"], ["#fde724", "#440154"]]  # the ends of viridis


def test_status_map_legend_counts_each_status_with_its_own_colour() -> None:
    status = np.zeros((10, 10, 1), np.uint8)
    status[0, :5], status[1, :] = Status.AT_BOUND, Status.OUTSIDE
    picture = status_picture(examples.maps_of((), status, (2.0, 2.0, 2.0)))
    labels = [text for text in _texts(picture) if "%" in text]
    assert labels == ["fitted (94\u202f%)", "on a bound (5.6\u202f%)"]
    pixels = _images(picture)
    assert len(pixels) == 1
    counts = {tuple(c): int(n) for c, n in zip(*np.unique(pixels[0].reshape(-1, 4), axis=0, return_counts=True))}
    assert counts.pop(next(c for c in counts if c[3] == 0)) == 10
    colours = {(*bytes.fromhex(STATUS_COLOURS[s][1:]), 255): n for s, n in ((Status.OK, 85), (Status.AT_BOUND, 5))}
    assert counts == colours
    assert len(set(STATUS_COLOURS.values())) == len(Status) - 1


def test_each_map_is_described_by_its_own_numbers() -> None:
    value = np.linspace(1.0, 3.0, 1000).reshape(10, 10, 10)
    entry = ParameterMap("VT", "mL/cm3", value, 10 * value)
    maps = examples.maps_of((entry, entry), np.zeros(value.shape, np.uint8), (2.0, 2.0, 2.0))
    (first, error), *_ = map_pictures(maps)
    assert first.alt == "Map of VT in 1\u202f000 voxels: median 2.00 mL/cm³, 2nd to 98th percentile 1.04 to 2.96."
    assert error is not None
    assert error.alt == "Map of the standard error of VT: median 20\u202f%, 90th percentile 28\u202f%."


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
    assert robust_limits(ordered(values)) == pytest.approx(limits)


@pytest.mark.parametrize("size", [1, 2, 7, 1000])
def test_percentiles_are_those_of_numpy(size: int) -> None:
    values = np.random.default_rng(size).normal(size=size).astype(np.float32)
    at = (0, 2, 33.3, 50, 98, 100)
    with_gaps = np.append(values, [np.nan, np.inf])
    np.testing.assert_allclose(percentiles(ordered(with_gaps), at), np.percentile(values.astype(float), at), rtol=1e-12)


def test_percentiles_of_nothing_are_unknown() -> None:
    assert np.isnan(percentiles(ordered([np.nan]), (2, 98))).all()


def test_any_palette_image_is_read_back_by_others() -> None:
    rng = np.random.default_rng(1)
    for shape, colours in (((1, 1), 1), ((3, 200), 256), ((200, 3), 17)):
        codes = rng.integers(0, colours, shape, np.uint8)
        palette = rng.integers(0, 256, (colours, 4), np.uint8)
        read = np.asarray(Image.open(io.BytesIO(png(codes, palette))).convert("RGBA"))
        np.testing.assert_array_equal(read, palette[codes])
