"""What the sidecar shows goes into the answer of `petkin diagnose`: its words, its weight, its pure scales."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from petkin.study.diagnose import Diagnosed, diagnose_study
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings

SCHEMA = json.loads((files("petkin.reporting") / "schemas" / "gap-report-1.json").read_text())
INCLUDES = ("blood_volume", "arterial_delay")


def diagnosed(folder: Path, change, **options: object) -> Diagnosed:
    """A simulated slice whose sidecar is changed afterwards."""
    usual = {"out": folder / "study", "noise": 8.0, "voxel_size": 7.0, "tracer": "reversible"}
    study = simulate(SimulationSettings.model_validate({**usual, **options}))
    path = study / "sub-01/pet/sub-01_pet.json"
    sidecar = json.loads(path.read_text())
    path.write_text(json.dumps(sidecar | change(sidecar)))
    (found,) = diagnose_study(DiagnoseRequest(study, out=folder / "out", include=INCLUDES))
    return found


def grown(sidecar: dict, growth: float, reference_s: float = 0.0, half_life: float = 109.77) -> list[float]:
    """Decay factors of a nuclide that decays so many times as fast, to another reference time."""
    lam = growth * np.log(2.0) / (half_life * 60)
    start, duration = np.array(sidecar["FrameTimesStart"]), np.array(sidecar["FrameDuration"])
    return list(lam * duration / -np.expm1(-lam * duration) * np.exp(lam * (start - reference_s)))


def test_a_blunder_that_curves_and_factors_show_is_named(tmp_path: Path) -> None:
    swapped = {"isotope": "C11", "effects": ("mean_life_swap",)}
    found = diagnosed(
        tmp_path, lambda s: {"DecayCorrectionFactor": grown(s, 1 / np.log(2), half_life=20.364)}, **swapped
    )
    verdict = found.answer["verdict"]
    jsonschema.validate(found.answer, SCHEMA)
    assert verdict["set"][0] == "mean_life_swap"
    assert "The sidecar shows: DecayCorrectionFactor grows 1.44" in verdict["sentence"]
    assert "What the sidecar shows" in found.report.read_text()


def test_a_reference_that_no_curve_shows_cannot_be_told_but_is_said(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, lambda s: {"DecayCorrectionFactor": grown(s, 1.0, -60.0)})
    jsonschema.validate(found.answer, SCHEMA)
    assert found.answer["verdict"]["kind"] == "none"
    first = found.answer["cannot_tell"][0]
    assert first["effects"] == ["input_scale"]
    assert first["worst_bias"]["VT"] == pytest.approx(np.expm1(np.log(2) / 109.77), rel=0.02)
    assert "60.0 s before" in first["why"]
    assert [entry["effects"] for entry in found.answer["cannot_tell"]].count(["input_scale"]) == 1
