from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.io.bids import Study
from petkin.io.blood import join_recordings, read_blood
from petkin.io.blood_table import read_blood_table

Write = Callable[..., Path]
UNITS = {"time": {"Units": "s"}, "plasma_radioactivity": {"Units": "kBq/mL"}}


def test_minutes_kbq_and_missing_values(blood_file: Write) -> None:
    table = read_blood_table(blood_file())
    np.testing.assert_allclose(table.samples["time"], [0, 0.5, 1, 10, 45])
    np.testing.assert_allclose(table.samples["plasma_radioactivity"], [0, 50, 25, 8, 3])
    assert table.samples["metabolite_parent_fraction"].isna().tolist() == [False, True, False, True, False]
    assert table.remarks == ()


@pytest.mark.parametrize(
    ("unit", "factor"), [("Bq/mL", 1e-3), ("kBq/mL", 1.0), ("MBq/mL", 1e3), ("nCi/mL", 0.037), ("uCi/mL", 37.0)]
)
def test_the_unit_of_each_column_is_its_own(blood_file: Write, unit: str, factor: float) -> None:
    fields = {**UNITS, "whole_blood_radioactivity": {"Units": unit}}
    table = read_blood_table(blood_file(fields=fields))
    np.testing.assert_allclose(table.samples["whole_blood_radioactivity"], np.array([0, 40, 20, 6, 2]) * factor)
    np.testing.assert_allclose(table.samples["plasma_radioactivity"], [0, 50, 25, 8, 3])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (UNITS, r"sub-01_recording-manual_blood.json: whole_blood_radioactivity.Units is missing"),
        ({**UNITS, "whole_blood_radioactivity": {"Units": "counts"}}, "whole_blood_radioactivity: unit 'counts'"),
        ({**UNITS, "whole_blood_radioactivity": {"Units": "Bq/mL"}, "time": {"Units": "h"}}, "Units of time is 'h'"),
    ],
)
def test_a_missing_or_unknown_unit_is_named(blood_file: Write, fields: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_blood_table(blood_file(fields=fields))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seconds\tplasma_radioactivity\n0\t1\n", "no column 'time'"),
        ("time\theart_rate\n0\t60\n", "none of the columns whole_blood_radioactivity"),
        ("time\tplasma_radioactivity\nn/a\t1\n", "time is missing in row 1"),
        ("time\tplasma_radioactivity\n0\tlow\n", "column 'plasma_radioactivity', row 1 holds 'low'"),
        ("time\tplasma_radioactivity\n0\tinf\n", "row 1 holds 'inf'"),
        ("time\tmetabolite_parent_fraction\n0\t100\n", "metabolite_parent_fraction is 100 in row 1"),
        ("time\tmetabolite_parent_fraction\n0\t-0.1\n", "metabolite_parent_fraction is -0.1 in row 1"),
        ("time,plasma_radioactivity\n0,1\n", "no column 'time' .* commas where tabs are due"),
        ("time\ttime\n0\t1\n", "column 'time' appears 2 times"),
        ("", "is empty"),
        ("time\tAIF\n0\t1\t2\t3\n0\t1\n", "not a tab-separated table"),
    ],
)
def test_a_useless_table_is_refused(blood_file: Write, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_blood_table(blood_file(text, None))


def test_percent_is_converted_only_where_the_unit_says_so(blood_file: Write) -> None:
    fields = {"metabolite_parent_fraction": {"Units": "%"}}
    table = read_blood_table(blood_file("time\tmetabolite_parent_fraction\n0\t100\n60\t40\n", fields))
    np.testing.assert_allclose(table.samples["metabolite_parent_fraction"], [1.0, 0.4])


def test_a_plain_table_is_seconds_and_kbq_with_a_remark(blood_file: Write) -> None:
    table = read_blood_table(blood_file(fields=None))
    np.testing.assert_allclose(table.samples["time"], [0, 0.5, 1, 10, 45])
    assert [remark.code for remark in table.remarks] == ["blood-units-assumed"]


def test_units_in_column_names_and_options(blood_file: Write) -> None:
    named = read_blood_table(blood_file("time (min)\tAIF [Bq/mL]\n0\t0\n5\t4000\n", None))
    given = read_blood_table(blood_file("time\tAIF\n0\t0\n5\t4000\n", None), given={"time": "min", "AIF": "Bq/mL"})
    for table in (named, given):
        np.testing.assert_allclose(table.samples, [[0, 0], [5, 4]])
        assert table.remarks == ()


def test_flags_drop_columns_that_are_not_available(blood_file: Write) -> None:
    fields = {**UNITS, "whole_blood_radioactivity": {"Units": "kBq/mL"}, "MetaboliteAvail": False}
    table = read_blood_table(blood_file(fields=fields))
    assert "metabolite_parent_fraction" not in table.samples
    assert [remark.text for remark in table.remarks] == [
        "MetaboliteAvail is false; the values of metabolite_parent_fraction are not used."
    ]
    absent = read_blood_table(blood_file("time\tplasma_radioactivity\n0\t1\n", {**UNITS, "MetaboliteAvail": True}))
    assert "there are no values of metabolite_parent_fraction" in absent.remarks[0].text


def test_rows_are_sorted_and_equal_times_joined(blood_file: Write) -> None:
    text = "time\tplasma_radioactivity\tmetabolite_parent_fraction\n60\t10\tn/a\n0\t0\t1\n60\t20\tn/a\n60\tn/a\t0.8\n"
    table = read_blood_table(blood_file(text, UNITS))
    np.testing.assert_allclose(table.samples, [[0, 0, 1], [1, 15, 0.8]])
    assert [remark.code for remark in table.remarks] == ["blood-order", "blood-repeated"]


def test_manual_and_autosampler_become_one_record(blood_file: Write) -> None:
    manual = read_blood_table(blood_file())
    rows = "\n".join(f"{t}\t{t - 1}" for t in range(60))
    fields = {"whole_blood_radioactivity": {"Units": "kBq/mL"}, "DispersionConstant": 2.6}
    automatic = read_blood_table(blood_file(f"time\twhole_blood_radioactivity\n{rows}\n", fields, "autosampler"))
    record = join_recordings({"manual": manual, "autosampler": automatic})
    assert (record.count, record.end, record.peak, record.units) == (65, 45.0, 58.0, ("kBq/mL",))
    assert record.dispersion_constant == pytest.approx(2.6 / 60)
    assert not record.dispersion_corrected
    assert [remark.code for remark in record.remarks] == ["blood-negative", "blood-dispersion"]


def test_the_sidecar_of_the_image_may_know_the_dispersion(blood_file: Write) -> None:
    table = read_blood_table(blood_file())
    record = join_recordings({"automatic": table}, dispersion_constant_s=6.0)
    assert record.dispersion_constant == pytest.approx(0.1)
    assert "its time constant is 6 s" in record.remarks[-1].text
    unknown = join_recordings({"automatic": table})
    assert unknown.dispersion_constant is None
    assert "its time constant is not stated" in unknown.remarks[-1].text


def test_other_labels_are_told_apart_by_their_sampling(blood_file: Write) -> None:
    rows = "\n".join(f"{t}\t{t}" for t in range(60))
    dense = read_blood_table(blood_file(f"time\twhole_blood_radioactivity\n{rows}\n", None))
    assert join_recordings({"pump": dense}).automatic is not None
    assert read_blood(blood_file()).manual is not None


def test_two_recordings_of_a_kind_are_refused(blood_file: Write) -> None:
    table = read_blood_table(blood_file())
    with pytest.raises(InputError, match="a second manual recording"):
        join_recordings({"manual": table, "discrete": table})


def test_pbr28_blood_as_it_is(pbr28: Study) -> None:
    scan = next(scan for scan in pbr28.scans if scan.prefix == "sub-rbqc_ses-1")
    blood = scan.blood
    assert blood is not None
    assert blood.manual is not None
    assert blood.automatic is not None
    assert (len(blood.manual), len(blood.automatic)) == (27, 600)
    row = blood.manual[np.isclose(blood.manual["time"], 40 / 60)]
    np.testing.assert_allclose(row["plasma_radioactivity"], 67.1106)
    assert blood.dispersion_constant == pytest.approx(2.6 / 60)
    assert blood.end == pytest.approx(5380 / 60)
    dispersed = next(remark for remark in scan.remarks if remark.code == "blood-dispersion")
    assert dispersed.where == "sub-rbqc_ses-1_recording-automatic_blood.tsv"
    assert "2.6 s" in dispersed.text
