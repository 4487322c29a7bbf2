from __future__ import annotations

import json
from pathlib import Path

import nibabel
import numpy as np
import pytest

from petkin.errors import InputError
from petkin.io.remarks import Remark, Severity
from petkin.study.inspect import group, inspect_study

SIDECAR = {
    "TracerName": "FDG",
    "TracerRadionuclide": "18F",
    "Units": "Bq/mL",
    "FrameTimesStart": [0, 600],
    "FrameDuration": [600, 600],
    "ImageDecayCorrected": True,
    "ImageDecayCorrectionTime": 0,
}


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """Two subjects: the first with an image of 3 x 3 x 3 voxels, the second without Units."""
    for subject in ("01", "02"):
        folder = tmp_path / f"sub-{subject}" / "pet"
        folder.mkdir(parents=True)
        fields = {key: value for key, value in SIDECAR.items() if subject == "01" or key != "Units"}
        (folder / f"sub-{subject}_pet.json").write_text(json.dumps(fields))
    values = np.ones((3, 3, 3, 2), np.float32)
    values[0, 0, 0], values[1, 1, 1, 0] = -1, np.nan
    nibabel.save(nibabel.Nifti1Image(values, np.eye(4)), tmp_path / "sub-01/pet/sub-01_pet.nii.gz")
    (tmp_path / "dataset_description.json").write_text('{"Name": "small"}')
    return tmp_path


def test_what_is_there_and_what_is_refused(small: Path) -> None:
    overview = inspect_study(small)
    (scan,) = overview.scans
    assert (overview.name, scan.scan, scan.tracer, scan.nuclide) == ("small", "sub-01", "FDG", "F18")
    assert (scan.frames, scan.minutes, scan.image) == (2, 20.0, (3, 3, 3, 2))
    assert (scan.manual_samples, scan.automatic_samples, scan.regions) == (0, 0, {})
    assert overview.refused == ("sub-02_pet.json: Units is missing; add it to the sidecar (PET-BIDS requires it).",)
    assert [(finding.severity.value, finding.code) for finding in overview.findings] == [
        ("warning", "nuclide-spelling"),
        ("note", "no-blood"),
    ]


def test_voxels_are_counted_on_request(small: Path) -> None:
    findings = {finding.code: finding.sentence for finding in inspect_study(small, voxels=True).findings}
    assert "1 NaN and 0 infinite values of 54" in findings["voxels-not-finite"]
    assert "2 of 54 values (3.7 percent) are negative" in findings["voxels-negative"]


def test_an_image_that_cannot_be_used_is_a_finding(small: Path) -> None:
    path = small / "sub-01/pet/sub-01_pet.nii.gz"
    path.write_bytes(path.read_bytes()[:20])
    worst = inspect_study(small).findings[0]
    assert (worst.severity, worst.code) == (Severity.SEVERE, "image-unusable")
    assert "sub-01_pet.nii.gz: cannot be read, truncated or damaged" in worst.sentence


def test_a_segmentation_on_another_grid_is_a_finding(small: Path) -> None:
    folder = small / "derivatives/seg/sub-01/pet"
    folder.mkdir(parents=True)
    nibabel.save(nibabel.Nifti1Image(np.ones((2, 2, 2), np.int16), np.eye(4)), folder / "sub-01_seg-x_dseg.nii.gz")
    worst = inspect_study(small).findings[0]
    assert (worst.severity, worst.code) == (Severity.SEVERE, "image-unusable")
    assert "sub-01_seg-x_dseg.nii.gz: is 2 x 2 x 2 voxels but sub-01_pet.nii.gz is 3 x 3 x 3" in worst.sentence


def test_findings_are_grouped_worst_first() -> None:
    remarks = [
        Remark(Severity.NOTE, "a", "f1", "one"),
        Remark(Severity.SEVERE, "b", "f2", "two"),
        Remark(Severity.NOTE, "a", "f3", "three"),
        Remark(Severity.WARNING, "c", "f4", "four"),
    ]
    found = group(remarks)
    assert [(finding.code, finding.count, finding.sentence) for finding in found] == [
        ("b", 1, "f2: two"),
        ("c", 1, "f4: four"),
        ("a", 2, "f1: one"),
    ]
    assert found[-1].all == ("f1: one", "f3: three")


def test_no_study_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no PET scan found"):
        inspect_study(tmp_path)


def test_ds004869_shows_its_traps_in_one_look(shared_data: Path) -> None:
    overview = inspect_study(shared_data / "ds004869")
    assert len(overview.scans) == 24
    assert overview.refused == ()
    counts = {finding.code: finding.count for finding in overview.findings}
    assert counts["dose-mismatch"] == 23
    assert counts["dose-implausible"] == 1
    assert counts["decay-reference"] == counts["nuclide-spelling"] == 24
    assert counts["blood-unit"] == 23
    assert counts["blood-scale"] == 1
    assert {finding.severity for finding in overview.findings[:3]} == {Severity.SEVERE}


def test_pbr28_shows_its_traps_in_one_look(shared_data: Path) -> None:
    overview = inspect_study(shared_data / "pbr28")
    row = next(scan for scan in overview.scans if scan.scan == "sub-rbqc_ses-1")
    assert (row.frames, row.manual_samples, row.automatic_samples, row.regions) == (37, 27, 600, {"rois": 6})
    assert row.minutes == pytest.approx(5629 / 60)
    counts = {finding.code: finding.count for finding in overview.findings}
    assert counts["blood-dispersion"] == counts["blood-short"] == counts["scan-start"] == 12
