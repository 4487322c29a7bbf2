from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.io.bids import Study
from petkin.io.blood import read_blood
from petkin.io.blood_checks import against_image_unit, against_tissue, complete, require_cover
from petkin.io.remarks import Severity

Write = Callable[..., Path]
BLOOD_UNTIL_45_MIN = "time\tplasma_radioactivity\n0\t0\n60\t50\n2700\t3\n"


@pytest.mark.parametrize(("scan", "held_s"), [(45.0, None), (47.0, 120), (50.0, 300)])
def test_blood_may_end_a_little_early(blood_file: Write, scan: float, held_s: float | None) -> None:
    remarks = require_cover(read_blood(blood_file(BLOOD_UNTIL_45_MIN, None)), FrameSchedule.uniform(10, scan / 10))
    assert [remark.code for remark in remarks] == ([] if held_s is None else ["blood-short"])
    assert held_s is None or f"Blood ends at 2700 s, {held_s} s before the last frame does" in remarks[0].text


@pytest.mark.parametrize(
    ("scan", "message"),
    [
        (50.1, "blood ends at 2700 s but the last frame ends at 3006 s; at least 90% of the scan is needed"),
        (2700.0, r"\(times in minutes where seconds are stated\?\)"),
        (2.0, "blood ends at 2700 s but the last frame at 120 s; check the Units of time"),
    ],
)
def test_blood_that_does_not_cover_the_scan_is_refused(blood_file: Write, scan: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        require_cover(read_blood(blood_file(BLOOD_UNTIL_45_MIN, None)), FrameSchedule.uniform(10, scan / 10))


def test_blood_without_activity_is_refused(blood_file: Write) -> None:
    blood = read_blood(blood_file("time\tplasma_radioactivity\n0\tn/a\n60\tn/a\n", None))
    with pytest.raises(InputError, match="no activity was measured"):
        require_cover(blood, FrameSchedule.uniform(1, 1.0))


@pytest.mark.parametrize(("tissue", "count"), [(0.2, 0), (20.0, 0), (500.0, 0), (5000.0, 1), (0.05, 1), (0.0, 0)])
def test_blood_a_thousand_times_off_the_tissue_is_severe(blood_file: Write, tissue: float, count: int) -> None:
    remarks = against_tissue(read_blood(blood_file(BLOOD_UNTIL_45_MIN, None)), np.array([[np.nan, tissue]]))
    assert [remark.severity for remark in remarks] == [Severity.SEVERE] * count


def test_units_of_blood_and_image_are_compared(blood_file: Write) -> None:
    blood = read_blood(blood_file())
    assert against_image_unit(blood, "kBq/ml") == ()
    (remark,) = against_image_unit(blood, "Bq/mL")
    assert remark.text == "Blood is in kBq/mL, the image in Bq/mL; both are converted to kBq/mL."


@pytest.mark.parametrize(
    ("columns", "codes"),
    [
        ("AIF", []),
        ("plasma_radioactivity", ["no-parent-fraction"]),
        ("whole_blood_radioactivity", ["no-plasma", "no-parent-fraction"]),
    ],
)
def test_what_an_input_function_lacks(blood_file: Write, columns: str, codes: list[str]) -> None:
    blood = read_blood(blood_file(f"time\t{columns}\n0\t0\n60\t5\n", None))
    assert [remark.code for remark in complete(blood)] == codes


def test_pbr28_blood_ends_before_the_scan(pbr28: Study) -> None:
    texts = {s.prefix: next(r.text for r in s.remarks if r.code == "blood-short") for s in pbr28.scans}
    assert len(texts) == 12
    assert texts["sub-rbqc_ses-1"].startswith("Blood ends at 5380 s, 249 s before the last frame does")


def test_ds004869_blood_and_image_units_differ(mc1: Study) -> None:
    codes = {scan.prefix: {remark.code: remark for remark in scan.remarks} for scan in mc1.scans}
    assert sum("blood-unit" in found for found in codes.values()) == 23
    # this one says Bq/mL while its values are those of kBq/mL
    wrong = codes.pop("sub-01_ses-blocked")["blood-scale"]
    assert wrong.severity is Severity.SEVERE
    assert "Blood peaks at 0.0775 kBq/mL but tissue at 34.4 kBq/mL" in wrong.text
    assert not any("blood-scale" in found for found in codes.values())
