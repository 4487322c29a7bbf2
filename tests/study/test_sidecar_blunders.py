"""What a sidecar shows before any statistics: each mistake by its catalogue name, and nothing where all agrees."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from petkin.io import PetSidecar, read_study
from petkin.study.diagnosis.sidecar import blunders

HALF_LIFE_S = 20.364 * 60
START, DURATION = np.arange(0.0, 3600.0, 300.0), np.full(12, 300.0)


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
