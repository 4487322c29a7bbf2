"""`petkin-bench real-scans` on one person's two scans: no alarm in twins, a late clock named, each with its d'."""

from __future__ import annotations

from pathlib import Path

import pytest

from petkin.errors import InputError
from petkin_bench.real_scans import measure_real, summary


def measured(folder: Path, **asked) -> list[dict[str, object]]:
    """Rows of all cases."""
    return [row for rows in measure_real(folder, **asked) for row in rows]


def test_a_late_clock_is_named_and_a_twin_is_not_accused(shared_data: Path) -> None:
    rows = measured(shared_data / "pbr28", subjects=("cgyu",), only=("twin", "delay+10s"))
    assert [row["case"] for row in rows] == 3 * ["twin"] + 3 * ["delay+10s"]
    assert [row["scan"] for row in rows[2::3]] == ["group", "group"]
    late = [row for row in rows[3:5] if row["case"] == "delay+10s"]
    assert all(isinstance(row["detectability"], float) and row["detectability"] > 10.0 for row in late)
    twins, clocks = summary(rows)
    assert (twins["scans"], twins["alarms"]) == (2, 0)
    assert (clocks["alarms"], clocks["in_set"], clocks["agree"]) == (2, 2, "1/1")
    assert twins["together"] == "none (0)"
    assert str(clocks["together"]).split()[0] in ("arterial_delay", "frame_offset")
    assert str(clocks["together"]).endswith("(2)")


def test_trapping_is_told_from_a_few_rivals(shared_data: Path) -> None:
    """By a simulator that traps nothing, and so has nothing to return."""
    few = ("dispersion", "gain_drift", "gain_step", "randoms_offset", "tissue_metabolite")
    rows = measured(shared_data / "pbr28", subjects=("cgyu",), only=("vascular_trapping",), rivals=few)
    (row,) = summary(rows)
    assert {r["rivals"] for r in rows} == {" ".join(few)}
    assert {str(r["simulator"]) for r in rows} == {"2TCM blood_volume arterial_delay"}
    assert {name for r in rows[:2] for name in str(r["leader"]).split("+")} <= {*few, "vascular_trapping"}
    assert (row["scans"], row["alarms"], row["leads"]) == (2, 2, 2)


def test_what_these_walls_trap_returns(shared_data: Path) -> None:
    """Said of three of these six scans."""
    subjects = ("cgyu", "flfp", "jdcs")
    rows = measured(shared_data / "pbr28", subjects=subjects, only=("vascular_release",), blood="fitted")
    assert sum(bool(row["first"]) for row in rows[:-1]) >= 3
    assert {str(row["simulator"]).split()[-1] for row in rows} == {"vascular_trapping"}


def test_a_missing_compartment_is_named_in_all_scans_but_one(shared_data: Path) -> None:
    """9 of 12 where trapping's return could not leave its limit, and where a law was told beside another fit."""
    rows = measured(shared_data / "pbr28", only=("second_tissue",), blood="fitted")
    assert sum(bool(row["first"]) for row in rows if row["scan"] != "group") >= 11


def test_a_record_that_errs_is_a_gap_only_where_it_is_taken_as_exact(shared_data: Path) -> None:
    cases = ("erring_record", "erring_record_as_exact")
    rows = [
        row
        for seed in (0, 2)
        for row in measured(shared_data / "pbr28", subjects=("flfp",), only=cases, blood="fitted", seed=seed)
    ]
    rows = [row for row in rows if row["scan"] != "group"]
    known, exact = ([row["kind"] != "none" for row in rows if row["case"] == case] for case in cases)
    assert len(known) == len(exact) == 4
    assert not any(known)
    assert sum(exact) >= 3


def test_a_mean_life_is_named_where_blood_may_err(shared_data: Path) -> None:
    """As the record stands a free trapping follows it better in these two scans. By the simulator without it, which is
    asked first."""
    named = {}
    for blood in ("recorded", "fitted"):
        rows = next(measure_real(shared_data / "pbr28", subjects=("cgyu",), only=("mean_life_swap",), blood=blood))
        scans = [row for row in rows if row["scan"] != "group"]
        assert all("vascular_trapping" not in str(row["simulator"]) for row in scans)
        named[blood] = [row["first"] for row in scans]
    assert named == {"recorded": [False, False], "fitted": [True, True]}


def test_a_rival_of_no_catalogue_is_one_line(shared_data: Path) -> None:
    with pytest.raises(InputError, match="nonsense"):
        measured(shared_data / "pbr28", rivals=("nonsense",))


def test_a_part_that_the_engine_has_not_is_one_line(shared_data: Path) -> None:
    with pytest.raises(InputError, match="--without 'nonsense': there are projection, priors"):
        measured(shared_data / "pbr28", lacking="nonsense")


def test_no_rows_are_no_summary() -> None:
    with pytest.raises(InputError, match="no scans"):
        summary([])
