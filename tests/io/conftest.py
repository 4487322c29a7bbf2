"""A small PET-BIDS study on disk, written by hand so that no reader is tested against its own writer."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest

from petkin.io.bids import Study, read_study

STARTS = [0, 30, 60, 120, 300, 600, 900, 1200, 1500, 1800, 2100, 2400]
DURATIONS = [30, 30, 60, 180, 300, 300, 300, 300, 300, 300, 300, 300]
SIDECAR = {
    "TracerName": "DASB",
    "TracerRadionuclide": "C11",
    "Units": "kBq/mL",
    "TimeZero": "10:00:00",
    "ScanStart": 0,
    "InjectionStart": 0,
    "InjectedRadioactivity": 400,
    "InjectedRadioactivityUnits": "MBq",
    "FrameTimesStart": STARTS,
    "FrameDuration": DURATIONS,
    "ImageDecayCorrected": True,
    "ImageDecayCorrectionTime": 0,
}
BLOOD = """time\twhole_blood_radioactivity\tplasma_radioactivity\tmetabolite_parent_fraction
0\t0\t0\t1
30\t40\t50\tn/a
60\t20\t25\t0.9
600\t6\t8\tn/a
2700\t2\t3\t0.3
"""
BLOOD_JSON = {
    "PlasmaAvail": True,
    "WholeBloodAvail": True,
    "MetaboliteAvail": True,
    "DispersionCorrected": False,
    "time": {"Units": "s"},
    "whole_blood_radioactivity": {"Units": "kBq/mL"},
    "plasma_radioactivity": {"Units": "kBq/mL"},
    "metabolite_parent_fraction": {"Units": "unitless"},
}
AFFINE = np.array([[-2.0, 0, 0, 10], [0, 2, 0, -20], [0, 0, 3, 5], [0, 0, 0, 1]])


def dump(path: Path, content: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def tacs_text(starts: list[int] = STARTS, durations: list[int] = DURATIONS) -> str:
    rows = [f"{s}\t{s + d}\t{10 + k}\t{5 + k}" for k, (s, d) in enumerate(zip(starts, durations, strict=True))]
    return "\n".join(["frame_start\tframe_end\tcortex\tcerebellum", *rows]) + "\n"


@pytest.fixture
def sidecar_file(tmp_path: Path) -> Callable[..., Path]:
    """Write a `_pet.json` with some fields changed; a field set to None is left out."""

    def write(**changes: Any) -> Path:
        fields = {key: value for key, value in {**SIDECAR, **changes}.items() if value is not None}
        return dump(tmp_path / "sub-01_pet.json", fields)

    return write


@pytest.fixture
def blood_file(tmp_path: Path) -> Callable[..., Path]:
    """Write a blood table and its JSON; fields=None leaves the JSON out."""

    def write(text: str = BLOOD, fields: dict[str, Any] | None = BLOOD_JSON, recording: str = "manual") -> Path:
        path = dump(tmp_path / f"sub-01_recording-{recording}_blood.tsv", text)
        if fields is not None:
            dump(path.with_suffix(".json"), fields)
        return path

    return write


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """One subject with image, blood, segmentation and curves."""
    root = tmp_path / "study"
    dump(root / "dataset_description.json", {"Name": "tiny", "BIDSVersion": "1.10.0", "DatasetType": "raw"})
    dump(root / "participants.tsv", "participant_id\tweight\nsub-01\t71.5\n")
    pet = root / "sub-01" / "pet"
    dump(pet / "sub-01_pet.json", SIDECAR)
    dump(pet / "sub-01_recording-manual_blood.tsv", BLOOD)
    dump(pet / "sub-01_recording-manual_blood.json", BLOOD_JSON)
    values = np.arange(3 * 4 * 2 * 12, dtype=np.float32).reshape(3, 4, 2, 12)
    nibabel.save(nibabel.Nifti1Image(values, AFFINE), pet / "sub-01_pet.nii.gz")
    pipeline = root / "derivatives" / "segmented"
    dump(pipeline / "dataset_description.json", {"Name": "segmented", "DatasetType": "derivative"})
    labels = np.zeros((3, 4, 2), np.int16)
    labels[0], labels[1, 1] = 1, 7
    folder = pipeline / "sub-01" / "pet"
    folder.mkdir(parents=True)
    nibabel.save(nibabel.Nifti1Image(labels, AFFINE), folder / "sub-01_seg-atlas_dseg.nii.gz")
    dump(folder / "sub-01_seg-atlas_dseg.tsv", "index\tname\n0\tbackground\n1\tcortex\n2\tabsent\n")
    dump(folder / "sub-01_seg-rois_tacs.tsv", tacs_text())
    dump(folder / "sub-01_seg-rois_tacs.json", {"Units": "kBq/mL"})
    dump(folder / "sub-01_seg-rois_morph.tsv", "name\tvolume-mm3\ncerebellum\t1500\n")
    return root


@pytest.fixture
def write_file() -> Callable[[Path, Any], Path]:
    """Write text, or anything else as JSON, making the folder."""
    return dump


@pytest.fixture
def tacs_file(tmp_path: Path) -> Callable[..., Path]:
    """Write a tacs table of two regions and its JSON; bare leaves the JSON out."""

    def write(text: str | None = None, fields: dict[str, Any] | None = None, *, bare: bool = False) -> Path:
        path = dump(tmp_path / "sub-01_seg-rois_tacs.tsv", tacs_text() if text is None else text)
        if not bare:
            dump(path.with_suffix(".json"), {"Units": "kBq/mL"} if fields is None else fields)
        return path

    return write


@pytest.fixture(scope="session")
def mc1(shared_data: Path) -> Study:
    """Data ds004869: [11C]MC1, 12 people, 24 scans."""
    return read_study(shared_data / "ds004869")


@pytest.fixture(scope="session")
def pbr28(shared_data: Path) -> Study:
    """Data pbr28: [11C]PBR28, 6 people, 12 scans."""
    return read_study(shared_data / "pbr28")
