"""Options of `petkin fit` that say how sure results are: profiles, bootstrap, certificates, choice of a model."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import nibabel
import numpy as np
import pandas as pd
import pytest

from .conftest import Ran
from .test_bad_input import refused_and_unchanged
from .tiny_study import PET, image, save

Command = Callable[..., Ran]
RESULTS = Path("derivatives/petkin") / PET
REGIONS = ["--model", "1TCM", "--level", "region", "--delay", "0"]


@pytest.fixture(autouse=True)
def _no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petkin.reporting.render_fit_report", lambda report: "\n".join(report.methods + report.limits))


@pytest.fixture
def noisy(study: Path) -> Path:
    """The study with five percent noise in every voxel and frame."""
    noise = np.random.default_rng(0).standard_normal(image().shape)
    save(study / PET / "sub-01_pet.nii.gz", (image() * (1 + 0.05 * noise)).astype(np.float32))
    return study


def table(study: Path, model: str = "1TCM") -> tuple[pd.DataFrame, dict]:
    path = study / RESULTS / f"sub-01_seg-atlas_model-{model}_kinpar.tsv"
    return pd.read_csv(path, sep="\t"), json.loads(path.with_suffix(".json").read_text())


def a_map(study: Path, what: str) -> np.ndarray:
    return np.asarray(nibabel.load(study / RESULTS / f"sub-01_{what}_mimap.nii.gz").dataobj)  # type: ignore[attr-defined]


def test_profiles_of_one_region_and_quantity(noisy: Path, petkin_command: Command) -> None:
    ran = petkin_command("fit", noisy, *REGIONS, "--profile", "cortex:VT", "--profile", "cortex:VB")
    assert ran.status == 0, ran
    found, sidecar = table(noisy)
    cortex, cerebellum = found.iloc[0], found.iloc[1]
    assert cortex["VT-low"] < cortex["VT"] < cortex["VT-high"]
    half = 0.5 * (cortex["VT-high"] - cortex["VT-low"])
    assert half == pytest.approx(2.3 * cortex["VT"] * cortex["VT-se"] / 100, rel=0.2)
    assert pd.isna(cerebellum["VT-low"])
    assert {"VB-low", "VB-high"} <= set(found.columns)
    assert "K1-low" not in found.columns
    assert "profile likelihood" in sidecar["VT-high"]["Description"]
    assert sidecar["VT-high"]["Units"] == "mL cm-3"


def test_profile_of_a_whole_region(noisy: Path, petkin_command: Command) -> None:
    assert petkin_command("fit", noisy, *REGIONS, "--profile", "cerebellum").status == 0
    found, _ = table(noisy)
    assert {f"{s}-{end}" for s in ("K1", "k2", "VB", "VT") for end in ("low", "high")} <= set(found.columns)


def test_bootstrap_is_seeded(noisy: Path, petkin_command: Command) -> None:
    tables = []
    for seed in (1, 1, 2):
        ran = petkin_command("fit", noisy, *REGIONS, "--bootstrap", 200, "--seed", seed)
        assert ran.status == 0, ran
        tables.append(table(noisy)[0])
    pd.testing.assert_frame_equal(tables[0], tables[1])
    assert (tables[0]["VT-bootlow"] != tables[2]["VT-bootlow"]).all()
    assert (tables[0]["VT-bootlow"] < tables[0]["VT"]).all()
    assert (tables[0]["VT"] < tables[0]["VT-boothigh"]).all()
    assert {"K1-bias", "VB-bias", "bootfailed"} <= set(tables[0].columns)
    settings = table(noisy)[1]["Settings"]
    assert (settings["bootstrap"], settings["seed"]) == (200, 2)


def test_voxels_are_certified_when_asked(noisy: Path, petkin_command: Command) -> None:
    options = ["--model", "1TCM", "--delay", "0"]
    assert petkin_command("fit", noisy, *options).status == 0
    assert not list((noisy / RESULTS).glob("*desc-gap*"))
    assert (table(noisy)[0]["gap"] < 1e-3).all()
    assert petkin_command("fit", noisy, *options, "--certify").status == 0
    gap = a_map(noisy, "model-1TCM_desc-gap")
    inside = a_map(noisy, "model-1TCM_desc-status") != 1
    assert (np.isfinite(gap) == inside).all()
    assert np.mean(gap[inside] <= 0.1) > 0.95
    assert json.loads((noisy / RESULTS / "sub-01_model-1TCM_desc-gap_mimap.json").read_text())["Units"] == "percent"


def test_models_are_compared_and_averaged(noisy: Path, petkin_command: Command) -> None:
    ran = petkin_command("fit", noisy, "--model", "1TCM", "--model", "2TCM", "--model", "Logan", "--delay", "0")
    assert ran.status == 0, ran
    found, sidecar = table(noisy, "AICc")
    assert sidecar["Settings"]["models"] == ["1TCM", "2TCM"]
    assert set(found["choice"]) <= {"1TCM", "2TCM"}
    np.testing.assert_allclose(found["weight-1TCM"] + found["weight-2TCM"], 1.0)
    one, two = table(noisy, "1TCM")[0], table(noisy, "2TCM")[0]
    np.testing.assert_allclose(found["delta-2TCM"] - found["delta-1TCM"], two["aicc"] - one["aicc"], rtol=1e-6)
    low, high = np.minimum(one["VT"], two["VT"]), np.maximum(one["VT"], two["VT"])
    assert ((found["VT"] >= low) & (found["VT"] <= high)).all()
    choice = a_map(noisy, "model-AICc_desc-choice")
    inside = a_map(noisy, "model-1TCM_desc-status") != 1
    assert set(np.unique(choice[inside])) <= {1, 2}
    assert (choice[~inside] == 0).all()
    assert np.mean(choice[inside] == 1) > 0.7
    levels = json.loads((noisy / RESULTS / "sub-01_model-AICc_desc-choice_mimap.json").read_text())["Levels"]
    assert levels == {"1": "1TCM", "2": "2TCM"}
    assert np.isfinite(a_map(noisy, "model-AICc_meas-VT")[inside]).mean() > 0.7
    weights = a_map(noisy, "model-AICc_meas-weight_desc-1TCM")
    assert ((weights[inside] >= 0) & (weights[inside] <= 1)).all()
    report = (noisy / RESULTS / "sub-01_desc-fit_report.html").read_text()
    assert "Least AICc: " in report


def test_one_model_has_no_choice(noisy: Path, petkin_command: Command) -> None:
    assert petkin_command("fit", noisy, *REGIONS, "--model", "Logan").status == 0
    assert not list((noisy / RESULTS).glob("*AICc*"))


@pytest.mark.parametrize(
    ("options", "phrases"),
    [
        (["--profile", "thalamus"], ("no such region", "cortex, cerebellum")),
        (["--profile", "cortex:k3"], ("there is no 'k3'", "K1, k2, vB, VT")),
        (["--profile", "cortex:"], ("REGION or REGION:SYMBOL",)),
        (["--profile", "cortex", "--level", "voxel"], ("--profile is for regions",)),
        (["--profile", "cortex", "--model", "Logan"], ("--profile is for compartment models; Logan is none",)),
        (["--bootstrap", "10"], ("--bootstrap is 10", "at least 100")),
        (["--bootstrap", "200", "--seed", "-1"], ("--seed is -1",)),
        (["--bootstrap", "200", "--level", "voxel"], ("--bootstrap is for regions",)),
        (["--certify", "--level", "region"], ("--certify is for voxels",)),
        (["--certify", "--model", "Patlak"], ("--certify is for compartment models",)),
    ],
)
def test_what_cannot_be_asked_is_refused_in_one_line(
    study: Path, petkin_command: Command, options: list[str], phrases: tuple[str, ...]
) -> None:
    model = [] if "--model" in options else ["--model", "1TCM"]
    refused_and_unchanged(petkin_command, study, ["fit", study, "--delay", "0", *model, *options], *phrases)
