"""`--hypr` and `--pvc gtm --psf`, from a simulated scanner of known resolution to the files, and what they refuse."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import nibabel
import numpy as np
import pandas as pd
import pytest

from .conftest import Ran, run_command
from .tiny_study import DSEG, DURATIONS, PET, STARTS, dump, labels, save

Command = Callable[..., Ran]
RESULTS = Path("derivatives/petkin") / PET
TRUTH = Path("derivatives/phantom") / PET


@pytest.fixture(autouse=True)
def _no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the study that all tests share needs its report."""
    monkeypatch.setattr("petkin.reporting.render_fit_report", lambda report: "")


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Ran]]:
    """A noisy study at 8 mm FWHM, fitted as it is and with everything on, into the same folder."""
    study = tmp_path_factory.mktemp("geometry") / "X"
    simulated = ["--roi", 5, "--frames", 40, "--model", "1TCM", "--noise", 10, "--voxel-size", 5, "--psf", 8]
    assert run_command("simulate", *simulated, "--out", study).status == 0
    on = ["--hypr", 8, "--pvc", "gtm", "--psf", 8]
    return study, {
        name: run_command("fit", study, "--model", "1TCM", *options) for name, options in (("plain", []), ("both", on))
    }


def kinpar(study: Path, pvc: str) -> tuple[pd.DataFrame, dict]:
    path = study / RESULTS / f"sub-01_seg-phantom{pvc}_model-1TCM_kinpar.tsv"
    return pd.read_csv(path, sep="\t"), json.loads(path.with_suffix(".json").read_text())


def a_map(path: Path) -> np.ndarray:
    return nibabel.load(path).get_fdata()  # type: ignore[attr-defined]


def test_files_are_named_by_what_was_done(fitted: tuple[Path, dict[str, Ran]]) -> None:
    study, ran = fitted
    assert [(r.status, r.err) for r in ran.values()] == [(0, "")] * 2
    found = {path.name.removeprefix("sub-01_") for path in (study / RESULTS).glob("*.nii.gz")}
    plain = {f"model-1TCM_meas-{m}{se}_mimap.nii.gz" for m in ("K1", "k2", "VB", "VT") for se in ("", "_desc-se")}
    plain |= {f"model-1TCM_desc-{what}_mimap.nii.gz" for what in ("status", "bound", "chi2", "aicc")}
    both = {f"model-1TCM_meas-{m}_desc-hypr{se}_mimap.nii.gz" for m in ("K1", "k2", "VB", "VT") for se in ("", "se")}
    both |= {f"model-1TCM_desc-hypr{what}_mimap.nii.gz" for what in ("status", "bound", "chi2", "aicc")}
    assert found == plain | both
    tables = {path.name.removeprefix("sub-01_seg-phantom_") for path in (study / RESULTS).glob("*seg-*.tsv")}
    assert tables == {
        "tacs.tsv",
        "pvc-GTM_tacs.tsv",
        "model-1TCM_kinpar.tsv",
        "pvc-GTM_model-1TCM_kinpar.tsv",
    }


def test_sidecars_state_what_was_done(fitted: tuple[Path, dict[str, Ran]]) -> None:
    study, ran = fitted
    table, sidecar = kinpar(study, "_pvc-GTM")
    correction = sidecar["PartialVolumeCorrection"]
    assert (correction["PointSpreadFWHM"], correction["PointSpreadFWHMUnits"]) == (8.0, "mm")
    assert 1 < correction["ConditionNumber"] < 20
    assert list(correction["NoiseFactor"]) == [*table["name"], "background"]
    assert min(correction["NoiseFactor"].values()) > 1
    curves = json.loads((study / RESULTS / "sub-01_seg-phantom_pvc-GTM_tacs.json").read_text())
    assert curves["PartialVolumeCorrection"] == correction
    denoising = json.loads((study / RESULTS / "sub-01_model-1TCM_meas-VT_desc-hyprse_mimap.json").read_text())
    assert (denoising["Denoising"]["KernelFWHM"], denoising["Denoising"]["KernelFWHMUnits"]) == (8.0, "mm")
    assert "standard errors are too small" in denoising["Denoising"]["Limits"]
    assert "PartialVolumeCorrection" not in denoising
    assert "Denoising" not in sidecar
    assert "PartialVolumeCorrection" not in kinpar(study, "")[1]
    assert "standard errors are too small" in ran["both"].out
    assert "standard errors are too small" not in ran["plain"].out
    page = (study / RESULTS / "sub-01_desc-fit_report.html").read_text()
    assert "denoised by HYPR-LR with a Gaussian kernel of 8 mm FWHM" in page
    assert "geometric transfer matrix of a Gaussian point spread of 8 mm FWHM" in page


def test_small_regions_come_closer_to_the_truth(fitted: tuple[Path, dict[str, Ran]]) -> None:
    study, _ = fitted
    truth = pd.read_csv(study / TRUTH / "sub-01_seg-phantom_model-1TCM_desc-truth_kinpar.tsv", sep="\t")
    error = {pvc: (kinpar(study, pvc)[0]["VT"] / truth["VT"] - 1).abs() for pvc in ("", "_pvc-GTM")}
    assert list(kinpar(study, "_pvc-GTM")[0]["index"]) == list(truth["index"])
    assert error[""].max() > 0.1
    assert error["_pvc-GTM"].max() < 0.05, error
    assert (error["_pvc-GTM"] < error[""] / 4).all(), error


def test_denoised_maps_are_less_rough(fitted: tuple[Path, dict[str, Ran]]) -> None:
    """k2, the shape of curves, bends less from voxel to voxel; its median in a region stays. Small regions have no row
    of three voxels often enough to tell. (VT keeps most of its noise, which is the composite's.)"""
    study, _ = fitted
    regions = a_map(study / TRUTH / "sub-01_seg-phantom_dseg.nii.gz")
    maps = [a_map(study / RESULTS / f"sub-01_model-1TCM_meas-k2{d}_mimap.nii.gz") for d in ("", "_desc-hypr")]
    told = 0
    for label in np.unique(regions[regions > 0]):
        row = (regions[1:-1] == label) & (regions[:-2] == label) & (regions[2:] == label)
        if row.sum() > 50:
            bend = [np.median(np.abs(np.diff(values, 2, axis=0)[row])) for values in maps]
            assert bend[1] < 0.6 * bend[0], label
            medians = [np.median(values[regions == label]) for values in maps]
            assert medians[1] == pytest.approx(medians[0], rel=0.02)
            told += 1
    assert told == 3


def test_regions_are_the_same_beside_denoised_voxels(study: Path, petkin_command: Command) -> None:
    tables = []
    for options in ([], ["--hypr", "6"]):
        assert petkin_command("fit", study, "--model", "1TCM", *options).status == 0
        tables.append((study / RESULTS / "sub-01_seg-atlas_model-1TCM_kinpar.tsv").read_bytes())
    assert tables[0] == tables[1]


def test_curves_alone_are_corrected_too(fitted: tuple[Path, dict[str, Ran]], tmp_path: Path) -> None:
    study, _ = fitted
    ran = run_command("tacs", study, "--pvc", "gtm", "--psf", 8, "--out", tmp_path)
    assert (ran.status, ran.err) == (0, "")
    written = Path(ran.out.strip())
    assert written.name == "sub-01_seg-phantom_pvc-GTM_tacs.tsv"
    assert written.read_bytes() == (study / RESULTS / written.name).read_bytes()
    sidecar = json.loads(written.with_suffix(".json").read_text())
    assert sidecar["PartialVolumeCorrection"]["PointSpreadFWHM"] == 8


def test_corrected_curves_do_not_stand_in_for_measured_ones(study: Path, petkin_command: Command) -> None:
    """Of two tables with and without pvc-, the one without is fitted, and a name keeps what was done."""
    rows = [f"{s}\t{s + d}\t{10 + s / 100}" for s, d in zip(STARTS, DURATIONS, strict=True)]
    text = "frame_start\tframe_end\tcortex\n" + "\n".join(rows) + "\n"
    folder = study / "derivatives/other" / PET
    for name in ("_pvc-AGTM", ""):
        dump(folder / f"sub-01_seg-atlas{name}_tacs.tsv", text)
        dump(folder / f"sub-01_seg-atlas{name}_tacs.json", {"Units": "kBq/mL"})
    (study / DSEG).unlink()
    options = ["--model", "1TCM", "--level", "region", "--delay", "0"]
    assert petkin_command("fit", study, *options).status == 0
    tables = [path.name for path in (study / RESULTS).glob("*kinpar.tsv")]
    assert tables == ["sub-01_seg-atlas_model-1TCM_kinpar.tsv"]
    given = folder / "sub-01_seg-atlas_pvc-AGTM_tacs.tsv"
    assert petkin_command("fit", study, *options, "--tacs", given).status == 0
    assert (study / RESULTS / "sub-01_seg-atlas_pvc-AGTM_model-1TCM_kinpar.tsv").is_file()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--hypr", "0"], "--hypr is 0; give a full width at half maximum in mm, above 0."),
        (["--hypr", "nan"], "--hypr is nan"),
        (["--hypr", "5", "--level", "region"], "--level region fits none"),
        (["--pvc", "gtm"], "--pvc gtm and --psf go together"),
        (["--psf", "5"], "--pvc gtm and --psf go together"),
        (["--pvc", "rbv", "--psf", "5"], "--pvc is 'rbv'; choose one of gtm."),
        (["--pvc", "gtm", "--psf", "-5"], "--psf is -5"),
        (["--pvc", "gtm", "--psf", "5", "--level", "voxel"], "--level voxel fits none"),
        (["--model", "SUVR", "--reference-mask", "m.nii", "--pvc", "gtm", "--psf", "5"], "by --reference, no mask"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(
    study: Path, petkin_command: Command, options: list[str], words: str
) -> None:
    ran = petkin_command("fit", study, "--model", "1TCM", "--delay", "0", *options)
    assert ran.status == 2
    assert words in ran.err
    assert len(ran.err.strip().splitlines()) == 1


def test_curves_without_an_image_are_refused(study: Path, petkin_command: Command) -> None:
    ran = petkin_command("fit", study, "--model", "1TCM", "--pvc", "gtm", "--psf", "5", "--dseg", study / "no.nii")
    assert ran.status == 2
    (study / DSEG).unlink()
    ran = petkin_command("fit", study, "--model", "1TCM", "--pvc", "gtm", "--psf", "5")
    assert (ran.status, "--pvc needs an image and a segmentation" in ran.err) == (2, True)


def test_a_region_without_finite_voxels_is_named(study: Path, petkin_command: Command) -> None:
    path = study / PET / "sub-01_pet.nii.gz"
    values = a_map(path).astype(np.float32)
    values[labels() == 4, 3] = np.nan
    save(path, values)
    ran = petkin_command("fit", study, "--model", "1TCM", "--delay", "0", "--pvc", "gtm", "--psf", "5")
    assert (ran.status, "Region 'cerebellum' holds no finite values" in ran.err) == (2, True)


def test_regions_that_cannot_be_told_apart_are_named(study: Path, petkin_command: Command) -> None:
    save(study / DSEG, np.where(np.indices((6, 6, 4)).sum(axis=0) % 2, 1, 4).astype(np.int16))
    ran = petkin_command("fit", study, "--model", "1TCM", "--delay", "0", "--pvc", "gtm", "--psf", "30")
    assert (ran.status, "Regions cortex, cerebellum cannot be told apart" in ran.err) == (2, True)


def test_maps_keep_the_reference_as_measured(study: Path, petkin_command: Command) -> None:
    """Regions are corrected, and so is the reference that they are compared with; maps are not."""
    options = ["--model", "SUVR", "--reference", "cerebellum", "--window", "20:45"]
    ratio = RESULTS / "sub-01_model-SUVR_meas-SUVR_mimap.nii.gz"
    assert petkin_command("fit", study, *options).status == 0
    before = (study / ratio).read_bytes()
    ran = petkin_command("fit", study, *options, "--pvc", "gtm", "--psf", "5")
    assert (ran.status, (study / ratio).read_bytes()) == (0, before)
    tables = [study / RESULTS / f"sub-01_seg-atlas{pvc}_model-SUVR_kinpar.tsv" for pvc in ("", "_pvc-GTM")]
    measured, corrected = (pd.read_csv(path, sep="\t").set_index("name")["SUVR"] for path in tables)
    assert measured["cerebellum"] == pytest.approx(1)
    assert corrected["cerebellum"] == pytest.approx(1)
    assert abs(corrected["cortex"] / measured["cortex"] - 1) > 0.01


def test_much_noise_is_told(study: Path, petkin_command: Command) -> None:
    """Two small regions that touch, at a point spread as wide as they are."""
    options = ["--model", "1TCM", "--delay", "0", "--level", "region", "--pvc", "gtm", "--psf"]
    assert "multiplies the noise" not in petkin_command("fit", study, *options, "3").out
    ran = petkin_command("fit", study, *options, "14")
    assert "multiplies the noise of 2 of 3 regions by more than 3 (cerebellum: 12.2)" in ran.out
    sidecar = json.loads((study / RESULTS / "sub-01_seg-atlas_pvc-GTM_model-1TCM_kinpar.json").read_text())
    factor = sidecar["PartialVolumeCorrection"]["NoiseFactor"]
    assert min(factor["cortex"], factor["cerebellum"]) > 3 > factor["background"]
