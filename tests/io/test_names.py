from __future__ import annotations

from pathlib import Path, PurePosixPath

import pytest

from petkin.errors import InputError
from petkin.io import descriptions, names

SCAN = {"sub": "01", "ses": "a", "run": "2", "trc": "DASB"}
PET = "sub-01/ses-a/pet/sub-01_ses-a_trc-DASB_run-2_"


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        (names.map_path(SCAN, "2TCM", "VT"), "model-2TCM_meas-VT_mimap.nii.gz"),
        (names.map_path(SCAN, "2TCM", "VT", desc="se"), "model-2TCM_meas-VT_desc-se_mimap.nii.gz"),
        (names.map_path(SCAN, "2TCM", desc="status"), "model-2TCM_desc-status_mimap.nii.gz"),
        (names.kinpar_path(SCAN, "2TCM", seg="gtm"), "seg-gtm_model-2TCM_kinpar.tsv"),
        (names.tacs_path(SCAN, seg="aparc+aseg"), "seg-aparc+aseg_tacs.tsv"),
        (names.inputfunction_path(SCAN), "inputfunction.tsv"),
        (names.report_path(SCAN, desc="gap", extension=".json"), "desc-gap_report.json"),
        (names.report_path(SCAN, desc="fit", model="1TCM"), "model-1TCM_desc-fit_report.html"),
        (names.image_path(SCAN), "pet.nii.gz"),
        (names.blood_path(SCAN, "manual"), "recording-manual_blood.tsv"),
        (names.dseg_path(SCAN, seg="brain"), "seg-brain_dseg.nii.gz"),
        (names.morph_path(SCAN, seg="brain"), "seg-brain_morph.tsv"),
    ],
)
def test_names_are_those_of_the_contract(path: PurePosixPath, expected: str) -> None:
    assert str(path) == PET + expected


def test_a_scan_without_session() -> None:
    assert str(names.tacs_path({"sub": "x"})) == "sub-x/pet/sub-x_tacs.tsv"
    assert names.sidecar_path(names.map_path({"sub": "x"}, "MA1", "VT")).name == "sub-x_model-MA1_meas-VT_mimap.json"
    assert names.derivatives_folder(Path("study")) == Path("study/derivatives/petkin")


@pytest.mark.parametrize("label", ["a/b", "..", "a_b", "a-b", "", "a b", "é"])
def test_labels_cannot_change_the_place(label: str) -> None:
    with pytest.raises(InputError, match="may hold only letters and digits"):
        names.map_path({"sub": label}, "2TCM", "VT")
    if label:
        with pytest.raises(InputError, match=f"Label {label!r} of entity 'seg'"):
            names.tacs_path({"sub": "01"}, seg=label)


def test_a_scan_needs_a_subject() -> None:
    with pytest.raises(InputError, match="needs a subject label"):
        names.prefix({"ses": "1"})


def test_file_names_are_taken_apart() -> None:
    name = names.FileName.parse("x/sub-01_ses-a_desc-preproc_seg-gtm_tacs.tsv")
    assert name.entities == {"sub": "01", "ses": "a", "desc": "preproc", "seg": "gtm"}
    assert (name.suffix, name.extension) == ("tacs", ".tsv")
    assert names.FileName.parse("sub-01_pet.nii.gz").extension == ".nii.gz"


@pytest.mark.parametrize(
    ("file", "belongs"),
    [
        ("sub-01_seg-x", True),
        ("sub-01_ses-a", True),
        ("sub-01_ses-b", False),
        ("sub-01_rec-x", False),
        ("seg-x", False),
    ],
)
def test_files_belong_to_a_scan_they_do_not_contradict(file: str, belongs: bool) -> None:
    assert names.FileName.parse(f"{file}_tacs.tsv").matches(SCAN) is belongs


def test_sidecars_state_unit_model_and_software() -> None:
    shared = descriptions.provenance(
        "2TCM", sources=["bids::a"], version="1.0", command="petkin fit", extra={"Weights": "x"}
    )
    K1, vB = descriptions.Measure("K1", "mL cm^-3 min^-1", "transfer"), descriptions.Measure("vB", "1")
    sidecar = descriptions.map_sidecar(K1, shared)
    assert list(sidecar) == [
        "Description", "Units", "ModelName", "Sources", "Weights", "SoftwareName", "SoftwareVersion", "CommandLine",
    ]  # fmt: skip
    assert sidecar["Units"] == "mL cm-3 min-1"
    assert descriptions.map_sidecar(K1, shared, percent_se=True)["Units"] == "percent"
    kinpar = descriptions.kinpar_sidecar([K1, vB], {0: "fitted"}, shared)
    assert {"K1", "K1-se", "VB", "VB-se", "chi2", "aicc", "status"} <= set(kinpar)
    assert kinpar["status"]["Levels"] == {"0": "fitted"}
    assert descriptions.status_sidecar({3: "no signal"}, shared)["Levels"] == {"3": "no signal"}
    assert descriptions.tacs_sidecar({})["Units"] == "kBq/mL"
    assert descriptions.inputfunction_sidecar({})["AIF"]["Units"] == "kBq/mL"


def test_dataset_descriptions() -> None:
    description = descriptions.dataset_description("1.0", name="tiny", sources=["../.."])
    assert description["DatasetType"] == "derivative"
    assert description["GeneratedBy"] == [{"Name": "petkin", "Version": "1.0"}]
    assert description["SourceDatasets"] == [{"URL": "../.."}]
    assert descriptions.raw_description("tiny", "1.0")["DatasetType"] == "raw"
