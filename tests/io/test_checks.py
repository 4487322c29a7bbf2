"""Every trap of images, sidecars and frame times, on real data by exact quantity and on made-up files by kind."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.io.bids import Study
from petkin.io.checks import OddVoxels, check_sidecar, implied_constant, implied_references
from petkin.io.remarks import Severity
from petkin.io.sidecar import read_sidecar

Write = Callable[..., Path]
HALF_LIFE_S = 20.364 * 60
#: frames of the study in conftest.py
STARTS = [0, 30, 60, 120, 300, 600, 900, 1200, 1500, 1800, 2100, 2400]
DURATIONS = [30, 30, 60, 180, 300, 300, 300, 300, 300, 300, 300, 300]


def factors(reference_s: float = 0.0) -> list[float]:
    lam, d, start = np.log(2) / HALF_LIFE_S, np.array(DURATIONS), np.array(STARTS)
    return list(lam * d / (1 - np.exp(-lam * d)) * np.exp(lam * (start - reference_s)))


def codes(path: Path) -> dict[str, Severity]:
    return {remark.code: remark.severity for remark in check_sidecar(read_sidecar(path))}


def text_of(path: Path, code: str) -> str:
    return next(str(remark) for remark in check_sidecar(read_sidecar(path)) if remark.code == code)


def test_a_sound_sidecar_raises_no_remark(sidecar_file: Write) -> None:
    assert codes(sidecar_file(DecayFactor=factors())) == {}


@pytest.mark.parametrize(
    ("changes", "code", "severity"),
    [
        ({"InjectedRadioactivityUnits": "kBq"}, "dose-implausible", Severity.SEVERE),
        ({"InjectedRadioactivityUnits": "becquerels"}, "dose-unit", Severity.WARNING),
        ({"RadionuclideTotalDose": 4.4e8}, "dose-mismatch", Severity.WARNING),
        ({"RadionuclideTotalDose": 4e5}, "dose-mismatch", Severity.SEVERE),
        ({"TracerRadionuclide": "11C"}, "nuclide-spelling", Severity.WARNING),
        ({"RadionuclideHalfLife": 6586}, "half-life", Severity.WARNING),
        ({"ImageDecayCorrected": False}, "decay-multiplied", Severity.WARNING),
        ({"ImageDecayCorrectionTime": 60}, "decay-time", Severity.WARNING),
        ({"ImageDecayCorrectionTime": None}, "decay-time-missing", Severity.WARNING),
        ({"DecayCorrection": "NONE"}, "decay-contradiction", Severity.SEVERE),
        ({"DecayCorrectionFactor": 1.2}, "decay-factor-count", Severity.NOTE),
        ({"DecayFactor": factors(-5.0)}, "decay-reference", Severity.WARNING),
        ({"DecayCorrectionFactor": [1.0] * 12}, "decay-reference", Severity.SEVERE),
        ({"InjectionStart": 30}, "injection-start", Severity.WARNING),
        ({"InjectionStart": 36000}, "injection-start", Severity.SEVERE),
        ({"ScanStart": 45}, "scan-start", Severity.NOTE),
        (
            {"FrameTimesStart": [-5, *STARTS[1:]], "FrameDuration": [35, *DURATIONS[1:]], "ScanStart": -5},
            "early-frame",
            Severity.NOTE,
        ),
        ({"FrameDuration": [20, *DURATIONS[1:]]}, "frame-gap", Severity.WARNING),
    ],
)
def test_each_trap_is_named(sidecar_file: Write, changes: dict[str, Any], code: str, severity: Severity) -> None:
    assert codes(sidecar_file(**changes)) == {code: severity}


def test_factors_beside_an_uncorrected_image_contradict_it(sidecar_file: Write) -> None:
    found = codes(sidecar_file(ImageDecayCorrected=False, DecayFactor=factors()))
    assert found["decay-contradiction"] is Severity.SEVERE


def test_the_implied_reference_is_solved_for(sidecar_file: Write) -> None:
    found = implied_references(np.array(factors(-4.5)), np.array(STARTS), np.array(DURATIONS), HALF_LIFE_S)
    np.testing.assert_allclose(found, -4.5, atol=1e-8)
    text = text_of(sidecar_file(DecayFactor=factors(-4.5)), "decay-reference")
    assert "4.5 to 4.5 s before ImageDecayCorrectionTime (0 s)" in text
    assert "off by 0.26 percent" in text  # e^{ln 2 4.5 s / 1221.84 s} - 1 = 0.2556 percent


@pytest.mark.parametrize("lives", [20.364, 20.364 * np.log(2), 10.182, 109.77, 2.037, 78.41 * 60, -20.0])
@pytest.mark.parametrize("durations", [DURATIONS, [10] * 6 + [60] * 4 + [600] * 8, [10, 10, 1000]])
def test_the_constant_that_made_factors_is_solved_for(lives: float, durations: list[int]) -> None:
    """Whatever the reference and the frames, and with one frame wrong where there are many."""
    d = np.array(durations, float)
    start, lam = np.cumsum(d) - d, np.log(2) / (60 * lives)
    made = lam * d / (1 - np.exp(-lam * d)) * np.exp(lam * (start + 17.0))
    assert implied_constant(made, start, d) == pytest.approx(lam, rel=1e-6)
    if len(d) > 3:
        made[-1] *= 1.1
        assert implied_constant(made, start, d) == pytest.approx(lam, rel=1e-6)


def test_factors_that_do_not_grow_were_made_with_no_decay() -> None:
    found = implied_constant(np.full(12, 2.0), np.array(STARTS, float), np.array(DURATIONS, float))
    assert found == 0.0


def test_a_reference_within_a_second_is_rounding(sidecar_file: Write) -> None:
    assert codes(sidecar_file(DecayFactor=factors(0.9))) == {}


def test_a_gap_tells_its_place_and_length(sidecar_file: Write) -> None:
    starts = [*STARTS[:8], *(start + 1200 for start in STARTS[8:])]
    assert "1 gap(s), 1200 s in all, the longest of 1200 s after frame 8" in text_of(
        sidecar_file(FrameTimesStart=starts), "frame-gap"
    )


@pytest.mark.parametrize(
    ("starts", "durations"),
    [
        ([s / 60 for s in STARTS], [d / 60 for d in DURATIONS]),
        (list(range(0, 60, 5)), [5] * 12),
    ],
)
def test_frame_times_in_minutes_are_refused(sidecar_file: Write, starts: list[float], durations: list[float]) -> None:
    path = sidecar_file(FrameTimesStart=starts, FrameDuration=durations)
    with pytest.raises(InputError, match="looks like minutes; FrameTimesStart and FrameDuration are in seconds"):
        check_sidecar(read_sidecar(path))


def test_a_water_scan_of_four_minutes_is_not_taken_for_minutes(sidecar_file: Write) -> None:
    path = sidecar_file(TracerRadionuclide="O15", FrameTimesStart=list(range(0, 240, 10)), FrameDuration=[10] * 24)
    assert codes(path) == {}


def test_odd_voxels_are_counted_by_kind() -> None:
    frame = np.array([[1.0, np.nan], [-2.0, np.inf]], np.float32)
    odd = OddVoxels.of(frame) + OddVoxels.of(np.array([-1.0, -np.inf], np.float32))
    assert odd == OddVoxels(nan=1, infinite=2, negative=3, total=6)
    assert [remark.code for remark in odd.remarks("image")] == ["voxels-not-finite", "voxels-negative"]
    assert OddVoxels.of(np.ones(3, np.float32)).remarks("image") == ()


def test_ds004869_doses_are_a_thousand_times_too_small(mc1: Study) -> None:
    remarks = {scan.prefix: {remark.code: remark for remark in scan.remarks} for scan in mc1.scans}
    mismatched = [found["dose-mismatch"] for found in remarks.values() if "dose-mismatch" in found]
    ratios = [float(re.search(r"([\d.]+) times as much", remark.text).group(1)) for remark in mismatched]  # type: ignore[union-attr]
    assert len(ratios) == 23
    assert 1000 <= min(ratios) <= max(ratios) <= 1001
    assert all(remark.severity is Severity.SEVERE for remark in mismatched)
    # the one scan without RadionuclideTotalDose shows by its size alone
    assert "0.7104 MBq" in remarks["sub-01_ses-blocked"]["dose-implausible"].text


def test_ds004869_decay_factors_imply_an_earlier_reference(mc1: Study) -> None:
    texts = {s.prefix: next(r.text for r in s.remarks if r.code == "decay-reference") for s in mc1.scans}
    assert "reference 3.0 to 5.1 s before ImageDecayCorrectionTime (0 s)" in texts["sub-04_ses-baseline"]
    assert len(texts) == 24
    bounds = [list(map(float, re.findall(r"([\d.]+) to ([\d.]+) s before", text)[0])) for text in texts.values()]
    assert min(low for low, _ in bounds) == 2.0
    assert max(high for _, high in bounds) == 9.1


def test_ds004869_radionuclide_is_respelled_and_single_factors_are_set_aside(mc1: Study) -> None:
    for scan in mc1.scans:
        found = {remark.code: remark.text for remark in scan.remarks}
        assert "'11C'; read as C11" in found["nuclide-spelling"]
        assert "DecayCorrectionFactor has 1 values for" in found["decay-factor-count"]
        assert scan.nuclide == "C11"


def test_pbr28_frames_start_after_the_scan(pbr28: Study) -> None:
    scan = next(scan for scan in pbr28.scans if scan.prefix == "sub-rbqc_ses-1")
    found = {remark.code: remark.text for remark in scan.remarks}
    assert found["scan-start"].startswith("ScanStart is 0 s but the first frame starts at 49 s")
