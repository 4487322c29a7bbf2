"""The README's way: simulate a study, fit it, look at the maps, all through the command."""

from __future__ import annotations

import json
from pathlib import Path

import nibabel
import numpy as np
import pandas as pd
import pytest

from .conftest import Ran, run_command

PET = Path("sub-01/pet")
TRUTH = Path("derivatives/phantom") / PET
RESULTS = Path("derivatives/petkin") / PET
PARAMETERS = {"1TCM": ["K1", "k2", "VB", "VT"], "2TCM": ["K1", "k2", "k3", "k4", "VB", "VT", "VND", "BPND", "Ki"]}
UNITS = {
    "K1": "mL cm-3 min-1",
    "Ki": "mL cm-3 min-1",
    "k2": "min-1",
    "k3": "min-1",
    "k4": "min-1",
    "VB": "unitless",
    "BPND": "unitless",
    "VT": "mL cm-3",
    "VND": "mL cm-3",
}


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Ran]:
    """`petkin simulate --roi 5 --frames 80` without noise, then `petkin fit` of two models with all defaults."""
    study = tmp_path_factory.mktemp("end-to-end") / "X"
    assert (
        run_command("simulate", "--roi", 5, "--frames", 80, "--noise", 0, "--voxel-size", 7, "--out", study).status == 0
    )
    return study, run_command("fit", study, "--model", "1TCM", "--model", "2TCM")


def a_map(path: Path) -> np.ndarray:
    return nibabel.load(path).get_fdata()  # type: ignore[attr-defined]


def test_every_file_of_the_contract_is_there_and_no_other(fitted: tuple[Path, Ran]) -> None:
    study, ran = fitted
    assert (ran.status, ran.err) == (0, "")
    expected = {"seg-phantom_tacs.tsv", "inputfunction.tsv", "desc-fit_report.html", "desc-fit_record.json"}
    for model, symbols in PARAMETERS.items():
        expected.add(f"seg-phantom_model-{model}_kinpar.tsv")
        expected |= {f"model-{model}_desc-{what}_mimap.nii.gz" for what in ("status", "chi2", "aicc", "bound")}
        for symbol in symbols:
            expected |= {f"model-{model}_meas-{symbol}{se}_mimap.nii.gz" for se in ("", "_desc-se")}
    expected.add("seg-phantom_model-AICc_kinpar.tsv")
    compared = [f"desc-{what}" for what in ("status", "chi2", "aicc", "choice")]
    compared += [f"meas-{symbol}{se}" for symbol in ("K1", "VB", "VT") for se in ("", "_desc-se")]
    compared += [f"meas-weight_desc-{model}" for model in PARAMETERS]
    expected |= {f"model-AICc_{what}_mimap.nii.gz" for what in compared}
    sidecars = {name.partition(".")[0] + ".json" for name in expected if not name.endswith(".html")}
    found = {
        str(path.relative_to(study / "derivatives/petkin")) for path in (study / "derivatives/petkin").rglob("*.*")
    }
    assert found == {"dataset_description.json", *(f"{PET}/sub-01_{name}" for name in expected | sidecars)}


def test_every_sidecar_states_what_its_numbers_are(fitted: tuple[Path, Ran]) -> None:
    study, _ = fitted
    for model, symbols in PARAMETERS.items():
        for symbol in symbols:
            for se, unit in (("", UNITS[symbol]), ("_desc-se", "percent")):
                fields = json.loads(
                    (study / RESULTS / f"sub-01_model-{model}_meas-{symbol}{se}_mimap.json").read_text()
                )
                assert (fields["Units"], fields["ModelName"]) == (unit, model)
                assert (fields["SoftwareName"], fields["CommandLine"][:11]) == ("petkin", "petkin fit ")
                assert {"Sources", "Weights", "InputDelay", "Settings", "SoftwareVersion"} <= set(fields)
        levels = json.loads((study / RESULTS / f"sub-01_model-{model}_desc-status_mimap.json").read_text())["Levels"]
        assert levels["0"].startswith("fitted")
        levels = json.loads((study / RESULTS / f"sub-01_model-{model}_desc-bound_mimap.json").read_text())["Levels"]
        assert (levels["1"], levels["2"]) == ("K1 at 0", "K1 at 10")
    description = json.loads((study / "derivatives/petkin/dataset_description.json").read_text())
    assert (description["DatasetType"], description["GeneratedBy"][0]["Name"]) == ("derivative", "petkin")
    assert description["DatasetLinks"] == {"raw": "../.."}
    curves = json.loads((study / RESULTS / "sub-01_seg-phantom_tacs.json").read_text())
    arterial = json.loads((study / RESULTS / "sub-01_inputfunction.json").read_text())
    assert (curves["Units"], arterial["AIF"]["Units"], arterial["time"]["Units"]) == ("kBq/mL", "kBq/mL", "s")


def test_regions_are_within_one_percent_of_the_truth(fitted: tuple[Path, Ran]) -> None:
    study, _ = fitted
    truth = pd.read_csv(study / TRUTH / "sub-01_seg-phantom_model-2TCM_desc-truth_kinpar.tsv", sep="\t")
    found = pd.read_csv(study / RESULTS / "sub-01_seg-phantom_model-2TCM_kinpar.tsv", sep="\t")
    heading = ["index", "name", *(name for symbol in PARAMETERS["2TCM"] for name in (symbol, f"{symbol}-se"))]
    assert list(found.columns) == [*heading, "chi2", "aicc", "status", "bound", "VT-second", "asymmetric", "gap"]
    assert list(found["name"]) == list(truth["name"])
    assert list(found["index"]) == list(truth["index"])
    for symbol in ("VT", "K1"):
        np.testing.assert_allclose(found[symbol], truth[symbol], rtol=0.01, err_msg=symbol)
    for symbol in ("k2", "k3", "k4", "BPND"):
        np.testing.assert_allclose(found[symbol], truth[symbol], rtol=0.05, err_msg=symbol)
    assert (found["status"] == 0).all()
    assert (found["VT-se"] < 1).all()
    one = pd.read_csv(study / RESULTS / "sub-01_seg-phantom_model-1TCM_kinpar.tsv", sep="\t")
    assert (found["aicc"] < one["aicc"]).all()


@pytest.mark.parametrize("symbol", ["VT", "K1"])
def test_maps_lie_on_the_truth_maps(fitted: tuple[Path, Ran], symbol: str) -> None:
    study, _ = fitted
    truth = a_map(study / TRUTH / f"sub-01_model-2TCM_meas-{symbol}_desc-truth_mimap.nii.gz")
    found = a_map(study / RESULTS / f"sub-01_model-2TCM_meas-{symbol}_mimap.nii.gz")
    se = a_map(study / RESULTS / f"sub-01_model-2TCM_meas-{symbol}_desc-se_mimap.nii.gz")
    inside = a_map(study / TRUTH / "sub-01_seg-phantom_dseg.nii.gz") > 0
    for axis in (0, 1):  # or else a flipped map would pass
        assert not np.array_equal(np.flip(truth, axis), truth, equal_nan=True)
    np.testing.assert_allclose(found[inside], truth[inside], rtol=0.01)
    assert np.isnan(found[~inside]).all()
    assert (np.isfinite(se) == inside).all()
    status = a_map(study / RESULTS / "sub-01_model-2TCM_desc-status_mimap.nii.gz")
    assert (status == np.where(inside, 0, 1)).all()


def test_the_command_sums_up(fitted: tuple[Path, Ran]) -> None:
    study, ran = fitted
    lines = [line.split() for line in ran.out.splitlines()]
    rows = [["sub-01", model, level] for level in ("region", "voxel") for model in PARAMETERS]
    assert [line[:3] for line in lines[1:5]] == rows
    report = Path(ran.out.splitlines()[-1].removeprefix("Report: "))
    page = report.read_text()
    assert report == study / RESULTS / "sub-01_desc-fit_report.html"
    assert page.count("data:image") > 20
    for phrase in (
        "Against the truth of the simulation",
        "whole-brain curve",
        "Voxels: all labels",
        "converted to kBq/mL",
    ):
        assert phrase in page


def test_tacs_are_those_of_the_fit(fitted: tuple[Path, Ran], tmp_path: Path) -> None:
    study, _ = fitted
    ran = run_command("tacs", study, "--out", tmp_path / "tacs")
    written = tmp_path / "tacs" / PET / "sub-01_seg-phantom_tacs.tsv"
    assert (ran.status, ran.out, ran.err) == (0, f"{written}\n", "")
    assert written.read_bytes() == (study / RESULTS / "sub-01_seg-phantom_tacs.tsv").read_bytes()
    raw = nibabel.load(study / PET / "sub-01_pet.nii.gz").get_fdata()  # type: ignore[attr-defined]
    label = a_map(study / TRUTH / "sub-01_seg-phantom_dseg.nii.gz")
    table = pd.read_csv(written, sep="\t")
    assert list(table.columns[:2]) == ["frame_start", "frame_end"]
    for index, name in enumerate(table.columns[2:], start=1):
        np.testing.assert_allclose(table[name], raw[label == index].mean(axis=0) / 1000, rtol=1e-6)


def test_info_of_the_study(fitted: tuple[Path, Ran]) -> None:
    overview = json.loads(run_command("info", fitted[0], "--json").out)
    (scan,) = overview["scans"]
    assert (scan["scan"], scan["nuclide"], scan["frames"], scan["regions"]) == ("sub-01", "F18", 80, {"phantom": 5})
    assert [finding["code"] for finding in overview["findings"]] == ["blood-unit"]


def test_an_effect_beyond_what_is_plausible_is_simulated_with_a_remark(tmp_path: Path) -> None:
    options = ("--voxel-size", 10.5, "--frames", 20)
    ran = run_command("simulate", *options, "--effect", "motion_step=30", "--out", tmp_path / "far")
    assert ran.status == 0
    remark = "motion_step: moved=30 is simulated as asked, but lies beyond what is plausible, -10 to 10 mm"
    assert ran.err.startswith(remark)
    near = run_command("simulate", *options, "--effect", "motion_step=3", "--out", tmp_path / "near")
    assert (near.status, "plausible" in near.err) == (0, False)


def test_a_slice_cannot_be_moved_out_of_its_plane(tmp_path: Path) -> None:
    ran = run_command("simulate", "--voxel-size", 10.5, "--effect", "motion_step=3,axis=2", "--out", tmp_path / "flat")
    assert ran.status == 2
    assert "axis=2: the picture has one voxel along axis 2 and cannot move there." in ran.err
    assert not (tmp_path / "flat").exists()


def test_the_papers_observation_is_fitted_with_its_own_decay(tmp_path: Path) -> None:
    """Its frames are not decay-corrected and decay with tau = 110 min; with F-18's half-life VT is 15 to 30 % low."""
    study = tmp_path / "paper"
    assert run_command("simulate", "--preset", "paper", "--voxel-size", 10.5, "--out", study).status == 0
    ran = run_command("fit", study, "--level", "region")
    assert "RadionuclideHalfLife is 4574.77 s" in ran.out
    assert "the image is not corrected for decay, and the former is used" in ran.out
    assert "every frame is multiplied by lam d / (1 - exp(-lam d)) exp(lam start)" in ran.out
    truth = pd.read_csv(study / TRUTH / "sub-01_seg-phantom_model-2TCM_desc-truth_kinpar.tsv", sep="\t")
    found = pd.read_csv(study / RESULTS / "sub-01_seg-phantom_model-2TCM_kinpar.tsv", sep="\t")
    np.testing.assert_allclose(found["VT"], truth["VT"], rtol=0.02)
    np.testing.assert_allclose(found["K1"], truth["K1"], rtol=0.01)
