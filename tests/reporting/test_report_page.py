"""The page as a whole: complete, safe, self-contained, the same every time, and never broken by a bad fit."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from petkin.errors import InputError
from petkin.fitting.results import FitResult, Status
from petkin.reporting import (
    FitReport,
    MapSet,
    ModelSection,
    ParameterMap,
    RegionCurves,
    render_fit_report,
    write_fit_report,
)

from . import report_examples as examples

_VOID = {"meta", "img", "br"}


class _Page(HTMLParser):
    """Tags, attributes and visible text; fails on tags that do not nest."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self._open: list[str] = []
        self.feed(html)
        self.close()
        assert not self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in _VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] != "style":
            self.text += data


@pytest.fixture(scope="module")
def full() -> str:
    return render_fit_report(examples.report())


@pytest.fixture(scope="module")
def page(full: str) -> _Page:
    return _Page(full)


def _without(report: FitReport, **changes: object) -> FitReport:
    """The report's first model with some fields of its regional fit replaced."""
    section = report.models[0]
    assert section.regional is not None
    return replace(report, models=(replace(section, regional=replace(section.regional, **changes)),))


def _failed(fit: FitResult, code: Status) -> FitResult:
    nan = np.full(fit.status.shape, np.nan)
    assert fit.predicted is not None
    return replace(
        fit,
        estimates=tuple(replace(e, value=nan, percent_se=nan) for e in fit.estimates),
        chi2=nan,
        aicc=nan,
        status=np.full(fit.status.shape, code, np.uint8),
        predicted=np.full(fit.predicted.shape, np.nan),
    )


def test_every_region_symbol_unit_and_setting_is_on_the_page(page: _Page) -> None:
    for name in examples.NAMES:
        assert name in page.text
    for text in ("mL/cm³/min", "min⁻¹", "mL/cm³", "unitless", "kBq/mL", "minutes"):
        assert text in page.text
    for text in ("petkin fit study --model 2TCM 1TCM", "370 MBq", "mid frame", "counting statistics", "dC_S/dt"):
        assert text in page.text


def test_says_what_was_fitted_flagged_warned_and_cannot_be_told(page: _Page) -> None:
    assert "all 12 regions fitted, 1 flagged (on a bound)" in page.text
    assert "See Thalamus (on a bound)." in page.text
    assert "Blood samples end at 75 min" in page.text
    assert "Partial volume is not corrected" in page.text
    assert "read VT, not BPND" in page.text
    assert "AICc prefers 2TCM in 12 of 12 regions." in page.text


def test_a_remark_shown_for_the_whole_report_is_not_repeated_by_model() -> None:
    report = examples.report(1, maps=None)
    assert report.models[0].regional is not None
    html = render_fit_report(replace(report, limits=report.models[0].regional.remarks))
    assert html.count("read VT, not BPND") == 1


def test_status_is_told_in_words_not_by_colour_alone(page: _Page) -> None:
    assert "▲ on a bound" in page.text
    assert "✓ fitted" in page.text


def test_every_picture_has_a_text_with_numbers(page: _Page) -> None:
    pictures = [attributes for tag, attributes in page.tags if tag == "img"]
    assert len(pictures) == 3 + 2 * 13 + 4 + 3 + 1
    for attributes in pictures:
        assert re.search(r"\d", attributes["alt"] or "")


def test_tables_have_captions_and_headed_rows_and_columns(page: _Page) -> None:
    names = [tag for tag, _ in page.tags]
    assert names.count("table") == names.count("caption") > 5
    assert {a.get("scope") for tag, a in page.tags if tag == "th"} == {"col", "row"}


def test_needs_no_network_script_or_font(full: str, page: _Page) -> None:
    assert not {"script", "link", "iframe", "object"} & {tag for tag, _ in page.tags}
    sources = [a["src"] or "" for tag, a in page.tags if tag == "img"]
    assert all(s.startswith("data:image/svg+xml;base64,") for s in sources)
    assert all((a["href"] or "").startswith("#") for tag, a in page.tags if tag == "a")
    assert "http:" not in full
    assert "https:" not in full
    assert "url(" not in full
    for source in sources:
        svg = base64.b64decode(source.split(",")[1]).decode()
        assert all(target.startswith(("#", "data:")) for target in re.findall(r'href="([^"]*)"', svg))
        assert "<script" not in svg
        assert set(re.findall(r"https?://[^\"' ]+", svg)) <= {
            "http://www.w3.org/2000/svg",
            "http://www.w3.org/1999/xlink",
        }


@pytest.mark.parametrize(
    "name",
    [
        "<script>alert(1)</script>",
        '"><img src=x onerror=alert(1)>',
        "{{ 7 * 7 }}",
        r"$\frac{1",
        "a\nb\0c",
        "左海馬",
        "\ud800",
        "%s & co",
    ],
)
def test_names_from_strangers_stay_text(name: str) -> None:
    report = replace(examples.report(4, maps=None), input=None)
    assert report.regions is not None
    regions = replace(report.regions, names=(name, *report.regions.names[1:]))
    settings = {name: {name: name}}
    section = replace(report.models[0], model=name, citations=(name,), equations=(name,))
    assert section.regional is not None
    section = replace(section, regional=replace(section.regional, settings=settings, remarks=(name,)))
    hostile = replace(
        report,
        title=name,
        command_line=name,
        scan=((name, name),),
        warnings=(name,),
        regions=regions,
        models=(section,),
    )
    html = render_fit_report(hostile)
    assert "<script" not in html
    assert "<img src=x" not in html
    assert name.replace("\0", "") in _Page(html).text.replace("\0", "").replace("\ufffd", "")


def test_same_report_gives_the_same_bytes_whatever_the_users_matplotlib_settings(tmp_path: Path) -> None:
    report = examples.report(4, maps=(10, 12, 1), models=1)
    write_fit_report(tmp_path / "one.html", report)
    with mpl.rc_context({"font.size": 20, "svg.hashsalt": None, "axes.grid": True, "lines.linewidth": 9}):
        write_fit_report(tmp_path / "two.html", report)
        assert mpl.rcParams["font.size"] == 20
    assert (tmp_path / "one.html").read_bytes() == (tmp_path / "two.html").read_bytes()


def test_date_is_shown_only_when_given() -> None:
    report = examples.report(1, maps=None, models=1)
    assert "2031-02-03" not in render_fit_report(report)
    assert "petkin 0.1.0, 2031-02-03" in render_fit_report(replace(report, date="2031-02-03"))


def test_hundred_regions_stay_below_five_megabytes_and_fold_away() -> None:
    html = render_fit_report(examples.report(100, maps=None, models=1))
    assert len(html.encode()) < 5e6 / 2
    assert "The other 88 regions" in html
    assert all(f"ctx-lh-region-{i}" in html for i in range(12, 100))


@pytest.mark.parametrize("code", [Status.NOT_FINITE, Status.NO_SIGNAL, Status.NOT_CONVERGED])
def test_all_failed_is_a_report_too(code: Status) -> None:
    report = examples.report(4, maps=None)
    failed = tuple(replace(s, regional=_failed(s.regional, code)) for s in report.models if s.regional is not None)
    assert report.regions is not None
    empty = replace(report.regions, tacs=np.full(report.regions.tacs.shape, np.nan))
    text = _Page(render_fit_report(replace(report, models=failed, regions=empty))).text
    assert "No usable result" in text
    assert text.count("n/a") >= 4 * 7
    assert "nan" not in re.sub(r"n/a|NaN or infinite", "", text)


def test_one_region_without_maps_input_or_prediction() -> None:
    report = _without(replace(examples.report(1, maps=None, models=1), input=None, scan=(), methods=()), predicted=None)
    text = _Page(render_fit_report(report)).text
    assert "Frontal cortex" in text
    assert "Input function" not in text
    assert "Residuals of all regions" not in text


def test_one_slice_image_is_drawn_in_one_plane() -> None:
    html = render_fit_report(examples.report(5, maps=(32, 32, 1), models=1))
    svgs = [
        base64.b64decode(uri).decode()
        for uri in re.findall(r'base64,([^"]+)" width="\d+" height="\d+" alt="Map of', html)
    ]
    assert len(svgs) == 7
    assert all(svg.count("<image") == 2 for svg in svgs)  # the plane and the colour bar


def test_maps_alone_make_a_report() -> None:
    report = FitReport("maps", (ModelSection("Patlak", maps=examples.map_set((12, 12, 12), axes="")),))
    text = _Page(render_fit_report(report)).text
    assert "orientation is not known" in text
    assert "voxels fitted" in text
    assert "Curves and fits" not in text


def test_empty_mask_and_valueless_maps_are_drawn() -> None:
    maps = examples.map_set((8, 8, 8))
    nothing = MapSet((), np.empty(0, np.uint8), np.zeros((8, 8, 8), np.bool_), (4.0, 4.0, 4.0))
    empty = replace(nothing, maps=(ParameterMap("VT", "mL/cm3", np.empty(0), np.empty(0)),))
    blank = replace(maps, maps=tuple(replace(m, value=np.full(np.shape(m.value), np.nan)) for m in maps.maps))
    for case in (empty, blank):
        text = _Page(render_fit_report(FitReport("maps", (ModelSection("2TCM", maps=case),)))).text
        assert "n/a" in text
    assert "the mask holds no voxel" in render_fit_report(FitReport("maps", (ModelSection("2TCM", maps=nothing),)))


def test_interrupted_scan_negative_start_and_excluded_frames() -> None:
    report = examples.report(3, maps=None, models=1)
    schedule = examples.frames()
    late = replace(
        schedule,
        start=np.append(-0.2, schedule.start[1:] + 30.0),
        end=np.append(schedule.end[0], schedule.end[1:] + 30),
    )
    assert report.regions is not None
    weights = np.ones(len(schedule))
    weights[[0, 7]] = 0
    report = _without(
        replace(report, regions=RegionCurves(report.regions.names, late, report.regions.tacs)), weights=weights
    )
    assert "3. Temporal cortex" in _Page(render_fit_report(report)).text


def test_unwritable_folder_is_refused_in_one_line_and_nothing_is_left(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError) as caught:
        write_fit_report(tmp_path / "file" / "report.html", examples.report(1, maps=None, models=1))
    assert "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
