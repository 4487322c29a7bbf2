"""What a sidecar shows before any statistics: each mistake by its catalogue name, and nothing where all agrees."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from petkin.imaging.decay import half_life
from petkin.io import PetSidecar, read_study
from petkin.study.diagnosis.sentences import told
from petkin.study.diagnosis.sidecar import Blunder, blunders

HALF_LIFE_S = 20.364 * 60
START, DURATION = np.arange(0.0, 3600.0, 300.0), np.full(12, 300.0)
#: 10 to 600 s, as scanners that follow a bolus have them.
LENGTHS = np.array([10.0] * 12 + [30.0] * 6 + [60.0] * 5 + [300.0] * 4 + [600.0] * 5)
STARTS = np.concatenate([[0.0], np.cumsum(LENGTHS)[:-1]])


def factors(lam: float, start: np.ndarray = START, duration: np.ndarray = DURATION) -> tuple[float, ...]:
    """What turns a frame's mean into its value at time zero, for a decay constant (1/s)."""
    return tuple(lam * duration / (1 - np.exp(-lam * duration)) * np.exp(lam * start))


def sidecar(**fields: Any) -> PetSidecar:
    usual = {
        "frame_times_start": tuple(START),
        "frame_duration": tuple(DURATION),
        "units": "Bq/mL",
        "tracer_radionuclide": "C11",
        "image_decay_corrected": True,
        "image_decay_correction_time": 0.0,
        "scan_start": 0.0,
        "injection_start": 0.0,
        "decay_correction_factor": factors(math.log(2) / HALF_LIFE_S),
    }
    return PetSidecar.model_validate({**usual, **fields})


def corrected(nuclide: str, half_life_min: float, frames: int = len(LENGTHS)) -> PetSidecar:
    """A sidecar of frames of 10 to 600 s whose factors are those of some half-life."""
    start, duration = STARTS[:frames], LENGTHS[:frames]
    return sidecar(
        tracer_radionuclide=nuclide,
        frame_times_start=tuple(start),
        frame_duration=tuple(duration),
        decay_correction_factor=factors(math.log(2) / (60 * half_life_min), start, duration),
    )


def only_said(found: tuple[Blunder, ...], effect: str) -> bool:
    """Whether one thing is told that neither counts nor stands in the sentence."""
    return [(b.effect, b.odds) for b in found] == [(effect, 0.0)] and told(found) == ""


def named(**fields: Any) -> list[str]:
    return [blunder.effect for blunder in blunders(sidecar(**fields))]


def test_a_sidecar_in_order_shows_nothing() -> None:
    assert named() == []
    assert named(decay_correction_factor=None) == []
    assert named(radionuclide_half_life=1220.04) == []
    assert blunders(None) == ()


@pytest.mark.parametrize(
    ("growth", "effect"),
    [
        (1 / math.log(2), "mean_life_swap"),
        (2.0, "decay_applied_twice"),
        (1.05, "half_life_error"),
        (0.9, "half_life_error"),
    ],
)
def test_the_growth_of_decay_factors(growth: float, effect: str) -> None:
    (found,) = blunders(sidecar(decay_correction_factor=factors(growth * math.log(2) / HALF_LIFE_S)))
    assert found.effect == effect
    assert found.sure
    assert f"{growth:.4g} times" in found.why


@pytest.mark.parametrize("nuclide", ["C11", "F18", "O15"])
def test_long_frames_do_not_slow_the_factors(nuclide: str) -> None:
    """x / sinh x of 600 s of [11C] is 0.995, so that a slope by mid-frame alone is too low."""
    found = corrected(nuclide, half_life(nuclide))
    assert blunders(found) == ()
    rounded = tuple(np.round(found.decay_correction_factor or (), 6))
    assert blunders(found.model_copy(update={"decay_correction_factor": rounded})) == ()


@pytest.mark.parametrize(
    ("growth", "effect"),
    [(1 / math.log(2), "mean_life_swap"), (2.0, "decay_applied_twice"), (1.02, "half_life_error")],
)
def test_long_frames_do_not_hide_a_growth(growth: float, effect: str) -> None:
    (found,) = blunders(corrected("C11", 20.364 / growth))
    assert (found.effect, found.sure) == (effect, True)
    assert f"{growth:.4g} times" in found.why


@pytest.mark.parametrize("last", [10, 11])
def test_a_late_frame_of_another_duration_is_no_half_life(last: int) -> None:
    lam = math.log(2) / HALF_LIFE_S
    right, wrong = factors(lam), factors(lam, duration=np.full(12, 120.0))
    assert named(decay_correction_factor=(*right[:last], wrong[last], *right[last + 1 :])) == ["frame_duration"]


@pytest.mark.parametrize(
    ("nuclide", "half_life_min", "frames"),
    [
        ("C11", 20.4, 32),
        ("F18", 110.0, 32),
        ("Ga68", 68.0, 32),
        ("O15", 2.03, 23),
        ("O15", 2.05, 23),
        ("O15", 2.07, 23),
        ("Zr89", 79.0 * 60, 32),
    ],
)
def test_half_lives_that_differ_between_vendors_are_no_mistake(nuclide: str, half_life_min: float, frames: int) -> None:
    growth = half_life(nuclide) / half_life_min
    slightly = corrected(nuclide, half_life_min, frames)
    stated = corrected(nuclide, half_life(nuclide), frames)
    stated = stated.model_copy(update={"radionuclide_half_life": 60 * half_life_min})
    for found in (blunders(slightly), blunders(stated)):
        assert found == () if abs(growth - 1.0) < 0.002 else only_said(found, "half_life_error")


def test_the_same_difference_counts_where_it_changes_the_correction() -> None:
    """1.5 % of lambda: of [18F] over 89 min 0.8 % of the values, of [11C] 4.5 %."""
    assert only_said(blunders(corrected("F18", 109.77 / 1.015)), "half_life_error")
    (found,) = blunders(corrected("C11", 20.364 / 1.015))
    assert (found.effect, found.odds > 0) == ("half_life_error", True)


def test_another_constant_of_the_vendor_is_no_other_reference() -> None:
    """By the nuclide's half-life the late factors of 110 min would imply a reference 10 s off."""
    shifted = corrected("F18", 110.0)
    late = np.exp(60.0 * math.log(2) / (110 * 60)) * np.array(shifted.decay_correction_factor)
    found = {b.effect: b for b in blunders(shifted.model_copy(update={"decay_correction_factor": tuple(late)}))}
    assert set(found) == {"half_life_error", "input_scale"}
    assert "60.0 s before" in found["input_scale"].why


@pytest.mark.parametrize(("nuclide", "other"), [("C11", "F18"), ("F18", "C11"), ("C11", "N13"), ("F18", "Ga68")])
def test_the_half_life_of_another_nuclide_is_said_to_be(nuclide: str, other: str) -> None:
    (found,) = blunders(corrected(nuclide, half_life(other)))
    assert (found.effect, found.sure) == ("half_life_error", True)
    assert f"as fast as {nuclide} decays, as those of {other} would" in found.why
    stated = sidecar(
        tracer_radionuclide=nuclide, radionuclide_half_life=60 * half_life(other), decay_correction_factor=None
    )
    (found,) = blunders(stated)
    assert (found.effect, found.sure) == ("half_life_error", True)
    assert f", as that of {other} is" in found.why


@pytest.mark.parametrize("fields", [{"injection_start": 20.0}, {"scan_start": 49.0}])
def test_times_that_are_legal_count_for_nothing(fields: dict[str, Any]) -> None:
    """PET-BIDS times frames and blood from TimeZero, from which injection and scan may lie as far as they like."""
    assert only_said(blunders(sidecar(**fields)), "frame_offset")


def test_a_wrong_half_life_counts_for_nothing_where_factors_show_that_it_was_not_used() -> None:
    found = blunders(sidecar(radionuclide_half_life=109.77 * 60))
    assert only_said(found, "half_life_error")
    assert "as that of F18 is" in found[0].why
    assert "corrected as they should be" in found[0].why
    (without,) = blunders(sidecar(radionuclide_half_life=109.77 * 60, decay_correction_factor=None))
    assert without.sure


def test_factors_of_one_are_right_where_next_to_nothing_decays() -> None:
    slow = {"tracer_radionuclide": "Zr89", "decay_correction_factor": (1.0,) * 12}
    hours = half_life("Zr89") / 60.0
    assert 1.0 / hours * math.log(2) < 0.01
    assert blunders(sidecar(**slow)) == ()


def test_factors_of_one_mean_that_nothing_was_corrected() -> None:
    assert named(decay_correction_factor=(1.0,) * 12) == ["decay_not_applied"]


@pytest.mark.parametrize(
    ("fields", "effect"),
    [
        ({"decay_correction": "NONE"}, "decay_not_applied"),
        ({"image_decay_corrected": False}, "decay_applied_twice"),
        ({"image_decay_corrected": False, "decay_correction": "ADMIN", "decay_correction_factor": None},
         "decay_applied_twice"),
        ({"radionuclide_half_life": HALF_LIFE_S * math.log(2), "decay_correction_factor": None}, "mean_life_swap"),
        ({"radionuclide_half_life": 1100.0, "decay_correction_factor": None}, "half_life_error"),
        ({"injection_start": 20.0}, "frame_offset"),
        ({"scan_start": 49.0}, "frame_offset"),
    ],
)  # fmt: skip
def test_fields_that_contradict_one_another(fields: dict[str, Any], effect: str) -> None:
    assert named(**fields) == [effect]


def test_a_frame_that_was_corrected_for_another_duration() -> None:
    lam = math.log(2) / HALF_LIFE_S
    right, wrong = factors(lam), factors(lam, duration=np.full(12, 240.0))
    (found,) = blunders(sidecar(decay_correction_factor=(*right[:7], wrong[7], *right[8:])))
    assert found.effect == "frame_duration"
    assert "frame 7" in found.why


def test_a_short_frame_with_a_hole_after_it() -> None:
    durations = DURATION.copy()
    durations[5] = 60.0
    (found,) = blunders(sidecar(frame_duration=tuple(durations), decay_correction_factor=None))
    assert (found.effect, found.sure) == ("frame_duration", False)
    assert "60 s and 300 s would fill its gap" in found.why


def test_another_reference_is_a_pure_scale() -> None:
    lam = math.log(2) / HALF_LIFE_S
    (found,) = blunders(sidecar(decay_correction_factor=tuple(np.exp(5.0 * lam) * np.array(factors(lam)))))
    assert found.effect == "input_scale"
    assert found.scale == pytest.approx(math.expm1(5.0 * lam), rel=1e-3)
    assert "5.0 s before" in found.why
    assert "too large" in found.why


def test_the_published_data_set_refers_to_another_time_than_it_says(shared_data: Path) -> None:
    study = read_study(shared_data / "ds004869", subjects=["01"])
    for scan in study.scans:
        found = {blunder.effect: blunder for blunder in blunders(scan.sidecar)}
        assert set(found) == {"input_scale"}
        assert 0.001 < found["input_scale"].scale < 0.005


def test_the_other_published_data_set_only_starts_late(shared_data: Path) -> None:
    folder = shared_data / "pbr28" / "sub-cgyu" / "ses-1" / "pet"
    text = json.loads(next(folder.glob("*_pet.json")).read_text())
    found = blunders(PetSidecar.model_validate(text))
    assert [b.effect for b in found] == ["frame_offset"]
    assert not found[0].sure
