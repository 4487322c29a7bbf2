"""The verb `fit` on simulated studies: what it makes of delays, interruptions, several scans, curves without image."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from petkin.errors import InputError
from petkin.fitting import Choices, Delay
from petkin.imaging import FrameSchedule
from petkin.study.fit import fit_study
from petkin.study.outcome import Fitted
from petkin.study.request import FitRequest
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings
from petkin.study.whole_brain import coarse_frames

PET = Path("sub-01/pet")


@pytest.fixture(autouse=True)
def _warnings_for_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports have tests of their own and take longer than the fits."""
    monkeypatch.setattr("petkin.reporting.render_fit_report", lambda report: "\n".join(report.warnings))


def simulated(folder: Path, **options: object) -> Path:
    """A noise-free slice of coarse voxels."""
    usual = {"out": folder / "study", "noise": 0.0, "voxel_size": 10.5, "tracer": "reversible"}
    return simulate(SimulationSettings.model_validate({**usual, **options}))


def by_region(study: Path, **options: object) -> Fitted:
    request = {"target": study, "models": ("2TCM",), "level": "region", **options}
    return fit_study(FitRequest(**request))[0]  # type: ignore[arg-type]


def percent_off(fitted: Fitted, study: Path, symbol: str) -> np.ndarray:
    path = study / "derivatives/phantom" / PET / "sub-01_seg-phantom_model-2TCM_desc-truth_kinpar.tsv"
    (result,) = fitted.fit.regional
    return 100 * np.abs(result[symbol] / pd.read_csv(path, sep="\t")[symbol].to_numpy() - 1)


@pytest.mark.parametrize("seconds", [12.0, -6.0])
def test_an_injected_delay_is_found(tmp_path: Path, seconds: float) -> None:
    """Frames of 10 s at the start resolve it; without the estimate vB and K1 would absorb it."""
    frames = "12x10,6x20,6x30,3x60,5x120,14x300"
    study = simulated(tmp_path, frames=frames, effects=(f"arterial_delay={seconds}",))
    found = by_region(study)
    assert found.fit.applied[0] * 60 == pytest.approx(seconds, abs=1.0)
    assert percent_off(found, study, "K1").max() < 2
    assert percent_off(found, study, "VT").max() < 1
    ignored = by_region(study, delay=0.0)
    assert percent_off(ignored, study, "K1").max() > 2 * percent_off(found, study, "K1").max()


def test_frames_too_long_to_tell_the_delay_are_warned_of(tmp_path: Path) -> None:
    study = simulated(tmp_path, frames="26x120")
    found = by_region(study)
    (warned,) = (remark for remark in found.remarks if remark.code == "delay-coarse")
    assert "frames of 120 s and longer in the first 3 min" in str(warned)
    assert str(warned) in found.report.read_text()
    given = by_region(study, delay=0.0)
    assert not [remark for remark in given.remarks if remark.code == "delay-coarse"]


@pytest.mark.parametrize(
    ("starts_s", "ends_s", "seen"),
    [
        ((0, 30, 60, 120), (30, 60, 120, 300), ""),
        ((0, 60, 120), (60, 120, 300), "frames of 60 s and longer"),
        ((0, 100, 120, 600), (100, 120, 600, 610), ""),
        ((1800, 2100), (2100, 2400), "no frame"),
    ],
)
def test_the_shortest_frame_while_the_tracer_arrives_counts(starts_s: tuple, ends_s: tuple, seen: str) -> None:
    frames = FrameSchedule(np.array(starts_s) / 60, np.array(ends_s) / 60)
    delay = Delay(0.2, 0.01, False, (np.zeros(1), np.zeros(1)), np.zeros(1))
    text = coarse_frames(frames, delay)
    assert bool(text) == bool(seen)
    assert seen in text
    assert coarse_frames(frames, None) == coarse_frames(frames, replace(delay, at_end=True)) == ""


def test_nothing_is_warned_of_where_nothing_is_odd(tmp_path: Path) -> None:
    study = simulated(tmp_path, units="kBq/mL")
    found = by_region(study, level="both")
    assert found.fit.remarks == ()
    assert found.report.read_text() == ""


def test_interrupted_scan(tmp_path: Path) -> None:
    study = simulated(tmp_path, frames="12x10,6x30,5x60,4x300,gap1200,8x300", units="kBq/mL")
    found = by_region(study)
    assert [remark.code for remark in found.fit.remarks] == ["frame-gap"]
    assert percent_off(found, study, "VT").max() < 2
    assert ("Frames", "35 frames, 0 to 90 min, 1 gap of 20 min in all") in found.fit.source.facts


def test_several_scans_are_written_each_under_its_name(tmp_path: Path) -> None:
    study = simulated(tmp_path, subjects=2, sessions=2)
    fitted = fit_study(FitRequest(target=study, models=("1TCM",), level="region"))
    assert [one.label for one in fitted] == [f"sub-0{n}_ses-0{j}" for n in (1, 2) for j in (1, 2)]
    for one in fitted:
        assert one.report.parts[-4:-1] == (
            f"sub-{one.fit.source.entities['sub']}",
            f"ses-{one.fit.source.entities['ses']}",
            "pet",
        )
        (outcome,) = one.outcomes
        assert (outcome.model, outcome.level, outcome.curves, outcome.symbol) == ("1TCM", "region", 5, "VT")
    picked = fit_study(FitRequest(target=study, models=("1TCM",), level="region", sessions=("02",), subjects=("01",)))
    assert [one.label for one in picked] == ["sub-01_ses-02"]


def test_curves_alone_give_what_the_image_gave(tmp_path: Path) -> None:
    """Curves drawn from an image that is not decay-corrected are corrected as it is (here without region volumes)."""
    study = simulated(tmp_path, preset="paper", tracer="paper")
    first = by_region(study)
    corrected = study / "derivatives/petkin" / PET / "sub-01_seg-phantom_tacs.tsv"
    raw = first.fit.source.frames, first.fit.curves
    assert raw[1] is not None
    table = pd.read_csv(corrected, sep="\t")
    lam, start, duration = 1 / 110, raw[0].start, raw[0].duration
    factor = duration * lam / (np.exp(-lam * start) * -np.expm1(-lam * duration))
    table.iloc[:, 2:] = table.iloc[:, 2:].to_numpy() / factor[:, None]
    given = tmp_path / "drawn_tacs.tsv"
    table.to_csv(given, sep="\t", index=False)
    given.with_suffix(".json").write_text(json.dumps({"Units": "kBq/mL"}))
    again = by_region(study, tacs=given)
    assert again.fit.source.image is None
    np.testing.assert_allclose(again.fit.regional[0]["VT"], first.fit.regional[0]["VT"], rtol=1e-3)


def test_given_blood_replaces_the_studys_and_its_remarks(tmp_path: Path) -> None:
    study = simulated(tmp_path, sampler_dispersion=3.0)
    assert "blood-dispersion" in [remark.code for remark in by_region(study).fit.remarks]
    pet = study / PET
    blood = (pet / "sub-01_recording-manual_blood.tsv", pet / "sub-01_recording-autosampler_blood.tsv")
    both = by_region(study, blood=blood)
    manual = by_region(study, blood=blood[:1])
    assert [remark.code for remark in both.fit.remarks].count("blood-dispersion") == 1
    assert "blood-dispersion" not in [remark.code for remark in manual.fit.remarks]
    assert manual.fit.arterial.area(90.0) == pytest.approx(both.fit.arterial.area(90.0), rel=0.1)
    with pytest.raises(InputError, match="are of one recording"):
        by_region(study, blood=(blood[0], blood[0]))


def test_volumes_weigh_the_whole_brain(tmp_path: Path) -> None:
    """By region or by voxel, the delay and the weights come from the same curve."""
    study = simulated(tmp_path)
    regions, voxels = by_region(study), by_region(study, level="both")
    np.testing.assert_allclose(regions.fit.weights, voxels.fit.weights, rtol=1e-5)
    assert regions.fit.applied[0] == pytest.approx(voxels.fit.applied[0], abs=1e-3)


def test_requests_are_checked_before_anything_is_read() -> None:
    absent = Path("absent")
    with pytest.raises(InputError, match="at most 300 s apart"):
        FitRequest(absent, delay=10.0)
    with pytest.raises(InputError, match="no model 'x'"):
        FitRequest(absent, models=("x",))
    with pytest.raises(InputError, match="no parameter of 1TCM"):
        FitRequest(absent, models=("1TCM",), choices=Choices(fixed={"k3": 0.1}))
    assert FitRequest(absent, models=("2tcm", "2TCM", "logan")).models == ("2TCM", "Logan")
