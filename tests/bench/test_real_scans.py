"""`petkin-bench real-scans` on one person's two scans: no alarm in twins, a late clock named, each with its d'."""

from __future__ import annotations

from pathlib import Path

import pytest

from petkin.errors import InputError
from petkin_bench.real_scans import measure_real, summary


def test_a_late_clock_is_named_and_a_twin_is_not_accused(shared_data: Path) -> None:
    rows = measure_real(shared_data / "pbr28", subjects=("cgyu",), only=("twin", "delay+10s"))
    assert [row["case"] for row in rows] == 2 * ["twin", "delay+10s"]
    late = [row for row in rows if row["case"] == "delay+10s"]
    assert all(isinstance(row["detectability"], float) and row["detectability"] > 10.0 for row in late)
    twins, clocks = summary(rows)
    assert (twins["scans"], twins["alarms"]) == (2, 0)
    assert (clocks["alarms"], clocks["in_set"], clocks["agree"]) == (2, 2, "1/1")


def test_no_rows_are_no_summary() -> None:
    with pytest.raises(InputError, match="no scans"):
        summary([])
