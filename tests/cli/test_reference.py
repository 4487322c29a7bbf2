"""Reference regions, doses and scans without blood, as typed."""

from __future__ import annotations

import json
from pathlib import Path

import nibabel
import numpy as np
import pandas as pd
import pytest

from petkin.study.resources import Plan

from .tiny_study import AFFINE, BLOOD, PET, SIDECAR, SIDECAR_FILE, change, dump, image, labels, save

OUT = Path("derivatives/petkin") / PET


@pytest.fixture
def bloodless(study):
    """The study without its blood, with a dose and a body weight."""
    for file in (BLOOD, BLOOD.with_suffix(".json")):
        (study / file).unlink()
    dump(study / "participants.tsv", "participant_id\tbody_weight\nsub-01\t70\n")
    change(study / SIDECAR_FILE, InjectedRadioactivity=350.0, InjectedRadioactivityUnits="MBq")
    return study


def window_mean(region: int) -> float:
    """Mean activity of a region from 20 to 45 min."""
    starts, last = (np.array(SIDECAR[field]) / 60 for field in ("FrameTimesStart", "FrameDuration"))
    inside = starts + last / 2 >= 20
    curve = image()[labels() == region].astype(np.float64).mean(axis=0)
    return float((curve * last)[inside].sum() / last[inside].sum())


def test_a_scan_without_blood_is_fitted_by_what_needs_none(bloodless, petkin_command):
    ran = petkin_command("fit", bloodless, "-m", "SUVR", "-m", "SUV", "--reference", "Cerebellum", "--t-star", 20)
    assert ran.status == 0, ran.err
    table = pd.read_csv(bloodless / OUT / "sub-01_seg-atlas_model-SUVR_kinpar.tsv", sep="\t")
    suv = pd.read_csv(bloodless / OUT / "sub-01_seg-atlas_model-SUV_kinpar.tsv", sep="\t")
    assert list(table["name"]) == ["cortex", "cerebellum"]
    np.testing.assert_allclose(table["SUVR"], [window_mean(1) / window_mean(4), 1.0], rtol=1e-5)
    np.testing.assert_allclose(suv["SUV"], np.array([window_mean(1), window_mean(4)]) * 70e3 / 350e3, rtol=1e-5)
    written = json.loads((bloodless / OUT / "sub-01_seg-atlas_model-SUVR_kinpar.json").read_text())
    assert written["ReferenceRegion"] == "cerebellum"
    assert "InputDelay" not in written
    assert (bloodless / OUT / "sub-01_model-SUVR_meas-SUVR_mimap.nii.gz").is_file()
    assert not (bloodless / OUT / "sub-01_inputfunction.tsv").exists()


def test_a_reference_mask_is_the_mean_over_its_voxels_at_voxel_level_too(bloodless, petkin_command, tmp_path):
    mask = save(tmp_path / "cerebellum.nii.gz", (labels() == 4).astype(np.uint8), AFFINE)
    for given in (("--reference-mask", mask), ("--reference", "cerebellum")):
        ran = petkin_command(
            "fit",
            bloodless,
            "-m",
            "SUVR",
            *given,
            "--level",
            "voxel",
            "--window",
            "20:45",
            "--out",
            tmp_path / given[0],
        )
        assert ran.status == 0, ran.err
    maps = [
        nibabel.load(tmp_path / option / PET / "sub-01_model-SUVR_meas-SUVR_mimap.nii.gz").get_fdata()
        for option in ("--reference-mask", "--reference")
    ]
    np.testing.assert_array_equal(*maps)
    assert np.nanmean(maps[0][labels() == 4]) == pytest.approx(1.0, rel=1e-3)


def test_kinetic_methods_of_a_study_without_blood_write_maps_tables_and_a_report(bloodless, petkin_command):
    models = ("SRTM", "SRTM2", "MRTM2", "LoganRef")
    asked = [word for model in models for word in ("-m", model)]
    ran = petkin_command("fit", bloodless, *asked, "--reference", "cerebellum", "--t-star", 10)
    assert ran.status == 0, ran.err
    for model in models:
        table = pd.read_csv(bloodless / OUT / f"sub-01_seg-atlas_model-{model}_kinpar.tsv", sep="\t")
        written = json.loads((bloodless / OUT / f"sub-01_model-{model}_meas-BPND_mimap.json").read_text())
        assert np.isfinite(table["BPND"]).any()
        assert written["ReferenceRegion"] == "cerebellum"
        assert ("SharedParameters" in written) == (model != "SRTM")
        if model != "SRTM":
            assert written["SharedParameters"]["k2prime"]["Units"] == "min-1"
            assert written["InputValuesLabels"] == []
    page = (bloodless / OUT / "sub-01_desc-fit_report.html").read_text()
    assert "k2prime of all voxels:" in page
    assert "Reference region of all regions: cerebellum." in page


def test_a_shared_rate_of_voxels_does_not_depend_on_blocks(bloodless, petkin_command, tmp_path, monkeypatch):
    written = []
    for block in (1000, 17):
        parts = lambda plan, count, block=block: [slice(i, min(i + block, count)) for i in range(0, count, block)]  # noqa: E731
        monkeypatch.setattr(Plan, "parts", parts)
        out = tmp_path / str(block)
        common = ("fit", bloodless, "-m", "SRTM2", "--reference", "cerebellum", "--level", "voxel")
        assert petkin_command(*common, "--out", out).status == 0
        written.append((out / PET / "sub-01_model-SRTM2_meas-BPND_mimap.nii.gz").read_bytes())
    assert written[0] == written[1]


def test_a_fixed_rate_is_written_with_its_unit(bloodless, petkin_command):
    ran = petkin_command(
        "fit", bloodless, "-m", "SRTM2", "--reference", "cerebellum", "--fix", "k2prime=0.06", "--level", "region"
    )
    assert ran.status == 0, ran.err
    written = json.loads((bloodless / OUT / "sub-01_seg-atlas_model-SRTM2_kinpar.json").read_text())
    assert (written["InputValuesLabels"], written["InputValues"]) == (["k2prime"], [0.06])
    assert written["InputValuesUnits"] == ["min-1"]
    assert "SharedParameters" not in written


@pytest.mark.parametrize(
    ("given", "line"),
    [
        (("-m", "SUVR"), "SUVR needs a reference region: give --reference NAME (of a region) or"),
        (
            ("-m", "SUVR", "--reference", "pons"),
            "no region is called 'pons'; --reference can be cortex, cerebellum",
        ),
        (("-m", "SUV", "--reference", "cerebellum"), "--reference is given but none of SUV uses a reference region"),
        (("-m", "SUV", "--dose", "0"), "--dose is 0; give the injected activity in MBq, above 0"),
        (("-m", "SUV", "--dose", "much"), "--dose 'much': 'much' is not a finite number"),
        (("-m", "SUV", "--dose", "total"), "RadionuclideTotalDose states no dose, and an SUV needs one"),
        (("-m", "SUV", "--body-weight", "-1"), "--body-weight is -1; give kg, above 0"),
        (
            (
                "-m",
                "1TCM",
            ),
            "there is no blood",
        ),
        (("-m", "SUVR", "--reference", "cortex", "--window", "50:60"), "no frame's middle lies from 50 to 60 min"),
    ],
)
def test_what_is_missing_or_wrong_is_one_clear_line(bloodless, petkin_command, given, line):
    ran = petkin_command("fit", bloodless, *given)
    assert ran.status == 2
    assert line in ran.err
    assert ran.err.count("\n") == 1


def test_a_missing_body_weight_is_named(bloodless, petkin_command):
    (bloodless / "participants.tsv").unlink()
    ran = petkin_command("fit", bloodless, "-m", "SUV")
    assert "give --body-weight KG" in ran.err
    assert petkin_command("fit", bloodless, "-m", "SUV", "--body-weight", 70).status == 0


def test_doses_that_contradict_are_never_chosen_from_in_silence(bloodless, petkin_command):
    change(bloodless / SIDECAR_FILE, RadionuclideTotalDose=350e6, InjectedRadioactivity=350e3)
    change(bloodless / SIDECAR_FILE, InjectedRadioactivityUnits="Bq")
    ran = petkin_command("fit", bloodless, "-m", "SUV", "--level", "region")
    assert ran.status == 2
    assert "InjectedRadioactivity is 350000 Bq but RadionuclideTotalDose is 3.5e+08 Bq, 1000 times as much" in ran.err
    read = {}
    for dose in ("stated", "total", 350):
        assert petkin_command("fit", bloodless, "-m", "SUV", "--level", "region", "--dose", dose).status == 0
        read[dose] = pd.read_csv(bloodless / OUT / "sub-01_seg-atlas_model-SUV_kinpar.tsv", sep="\t")["SUV"]
    np.testing.assert_allclose(read["stated"], 1000 * read["total"])
    np.testing.assert_allclose(read[350], read["total"])


def test_info_lists_a_study_without_blood(bloodless, petkin_command):
    ran = petkin_command("info", bloodless)
    assert ran.status == 0
    assert "none" in ran.out


def test_real_doses_a_thousand_times_too_small_are_named(shared_data, petkin_command, tmp_path):
    common = ("fit", shared_data / "ds004869", "-m", "SUV", "--subject", "01", "--session", "baseline")
    ran = petkin_command(*common, "--out", tmp_path)
    assert ran.status == 2
    assert "InjectedRadioactivity is 653790 Bq but RadionuclideTotalDose is 6.5416e+08 Bq" in ran.err
    assert petkin_command(*common, "--out", tmp_path, "--dose", "total").status == 0
    table = pd.read_csv(next(tmp_path.rglob("*model-SUV_*kinpar.tsv")), sep="\t")
    assert 0.1 < table["SUV"].median() < 10
