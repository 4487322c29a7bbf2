"""Numbers, units and symbols as a reader sees them."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from petkin.fitting.results import Status
from petkin.reporting.tables import plain
from petkin.reporting.wording import (
    count,
    joined,
    number,
    percent,
    round_values,
    status_kind,
    status_mark,
    status_short,
    symbol_html,
    symbol_svg,
    unit_text,
    value_with_error,
)


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.41234, 3, "0.412"),
        (-2.5, 3, "−2.50"),
        (12345.6, 3, "12346"),
        (9.999, 3, "10.0"),
        (0.0, 3, "0"),
        (3.2e-7, 2, "3.2e−7"),
        (4.56e8, 3, "4.56e8"),
        (float("nan"), 3, "n/a"),
        (float("inf"), 3, "n/a"),
    ],
)
def test_number(value: float, digits: int, text: str) -> None:
    assert number(value, digits) == text


@pytest.mark.parametrize(
    ("value", "signed", "text"),
    [
        (2.71, False, "2.7 %"),
        (14.4, False, "14 %"),
        (9.97, False, "10 %"),
        (3.0, True, "+3.0 %"),
        (-3.0, True, "−3.0 %"),
        (0.0, True, "0 %"),
        (4000.0, False, "> 1000 %"),
        (-4000.0, True, "−> 1000 %"),
        (1e-7, False, "< 0.001 %"),
        (float("nan"), False, "n/a"),
    ],
)
def test_percent(value: float, signed: bool, text: str) -> None:
    assert percent(value, signed=signed).replace("\u202f", " ") == text


@pytest.mark.parametrize(
    ("value", "error", "shown", "note"),
    [
        (0.41234, 2.7, "0.412", "± 0.011 (2.7 %)"),
        (123.4, 10.0, "123", "± 12 (10 %)"),
        (-0.5, 4.0, "−0.500", "± 0.020 (4.0 %)"),
        (0.02, 340.0, "0.0200", "± 340 %"),
        (1.0, 0.0, "1.00", "± 0 %"),
        (1.0, float("nan"), "1.000", "no SE"),
        (float("nan"), 3.0, "n/a", ""),
        (1.2345, 1e-6, "1.234", "± 1.2e−8 (< 0.001 %)"),
    ],
)
def test_value_is_rounded_to_its_error(value: float, error: float, shown: str, note: str) -> None:
    text, spread = value_with_error(value, error)
    assert (text, spread.replace("\u202f", " ")) == (shown, note)


def test_units_and_symbols() -> None:
    assert unit_text("mL/cm3/min") == "mL/cm³/min"
    assert unit_text("mL cm^-3 min^-1") == "mL cm⁻³ min⁻¹"
    assert unit_text("1/min") == "min⁻¹"
    assert unit_text("1") == ""
    assert symbol_html("BPND") == "BP<sub>ND</sub>"
    assert symbol_html("k2'") == "k<sub>2</sub>′"
    assert symbol_html("<b>") == "&lt;b&gt;"


def test_symbols_in_pictures_keep_their_index_and_what_follows() -> None:
    for symbol, text in (("VT", "VT (mL)"), ("k2'", "k2′ (mL)"), ("chi2", "reduced χ² (mL)"), ("<b>", "<b> (mL)")):
        line = ElementTree.fromstring(f"<text>{symbol_svg(symbol, ' (mL)')}</text>")
        assert "".join(line.itertext()) == text
        spans = [float(span.get("dy", "0")[:-2]) * (0.7 if span.get("font-size") else 1.0) for span in line]
        assert sum(spans) == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("low", "high", "texts"),
    [
        (0.0, 0.8, ["0.0", "0.2", "0.4", "0.6", "0.8"]),
        (-1.0, 1.0, ["−1.0", "−0.5", "0.0", "0.5", "1.0"]),
        (0.07, 1.12, ["0.2", "0.4", "0.6", "0.8", "1.0"]),
        (1000.1, 1000.3, ["1000.10", "1000.15", "1000.20", "1000.25", "1000.30"]),
        (2e-9, 9e-9, ["2e−09", "4e−09", "6e−09", "8e−09"]),
    ],
)
def test_a_scale_has_a_few_round_values(low: float, high: float, texts: list[str]) -> None:
    values = round_values(low, high)
    assert list(values.values()) == texts
    assert [float(text.replace("−", "-")) for text in texts] == pytest.approx(list(values))


def test_counts_and_lists() -> None:
    assert count(1234567) == "1\u202f234\u202f567"
    assert joined([]) == ""
    assert joined(["a"]) == "a"
    assert joined(["a", "b", "c"]) == "a, b and c"


def test_each_status_has_words_a_kind_and_a_mark() -> None:
    assert len({status_short(s) for s in Status}) == len(Status)
    kinds = {"good": "✓", "doubtful": "▲", "missing": "✗"}
    assert all(status_mark(s) == kinds[status_kind(s)] for s in Status)
    assert status_kind(Status.AT_BOUND) == "doubtful"
    assert status_kind(Status.NOT_FINITE) == "missing"


def test_settings_are_told_plainly() -> None:
    assert plain({"K1": (0.0, 2.0), "free": ["k2", "k3"]}) == "K1: 0 to 2; free: k2, k3"
    assert plain([0.001, 5.0]) == "0.001 to 5"
    assert plain(True) == "yes"
    assert plain(None) == "none"
    assert plain(()) == "none"
    assert plain(0.25) == "0.25"
