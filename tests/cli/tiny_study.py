"""A PET-BIDS study of a few voxels, written without petkin's own writers."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import nibabel
import numpy as np

STARTS = [0, 30, 60, 120, 300, 600, 900, 1200, 1500, 1800, 2100, 2400]
DURATIONS = [30, 30, 60, 180, 300, 300, 300, 300, 300, 300, 300, 300]
AFFINE = np.array([[-3.0, 0, 0, 9], [0, 3, 0, -12], [0, 0, 4, 5], [0, 0, 0, 1]])
SIDECAR: dict[str, Any] = {
    "TracerName": "ligand",
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
BLOOD_TIMES = [0, 15, 30, 45, 60, 90, 120, 180, 300, 600, 1200, 1800, 2700]
BLOOD_JSON: dict[str, Any] = {
    "PlasmaAvail": True,
    "WholeBloodAvail": True,
    "MetaboliteAvail": True,
    "DispersionCorrected": True,
    "time": {"Units": "s"},
    "whole_blood_radioactivity": {"Units": "kBq/mL"},
    "plasma_radioactivity": {"Units": "kBq/mL"},
    "metabolite_parent_fraction": {"Units": "unitless"},
}
PET = Path("sub-01/pet")
IMAGE, SIDECAR_FILE = PET / "sub-01_pet.nii.gz", PET / "sub-01_pet.json"
BLOOD = PET / "sub-01_recording-manual_blood.tsv"
ATLAS = Path("derivatives/atlas") / PET
DSEG = ATLAS / "sub-01_seg-atlas_dseg.nii.gz"


def write_scan(root: Path, subject: str = "01") -> None:
    """Image, sidecar, blood and segmentation of one scan."""
    rename = lambda path: root / str(path).replace("sub-01", f"sub-{subject}")  # noqa: E731
    dump(rename(SIDECAR_FILE), SIDECAR)
    save(rename(IMAGE), image())
    dump(rename(BLOOD), blood_text())
    dump(rename(BLOOD).with_suffix(".json"), BLOOD_JSON)
    save(rename(DSEG), labels())
    dump(rename(ATLAS / "sub-01_seg-atlas_dseg.tsv"), "index\tname\n1\tcortex\n4\tcerebellum\n")


def blood_text(times: list[int] = BLOOD_TIMES) -> str:
    """Total plasma that rises for 45 s and falls in two exponentials; whole blood is 0.8 of it; parent 1 to 0.4."""
    rows = ["time\tplasma_radioactivity\twhole_blood_radioactivity\tmetabolite_parent_fraction"]
    for s in times:
        plasma = plasma_at(s / 60)
        rows.append(f"{s}\t{plasma:.6g}\t{0.8 * plasma:.6g}\t{0.4 + 0.6 * np.exp(-s / 900):.6g}")
    return "\n".join(rows) + "\n"


def plasma_at(t: Any) -> Any:
    """kBq/mL at minutes."""
    return np.where(t < 0.75, 80 * np.asarray(t), 45 * np.exp(-(t - 0.75)) + 15 * np.exp(-0.03 * (t - 0.75)))


@cache
def image() -> np.ndarray:
    """One-tissue curves as decay-corrected frame means of C-11 (half-life 20.36 min), by sums over a fine grid."""
    t = (np.arange(2700 * 2) + 0.5) / 120
    parent = plasma_at(t) * (0.4 + 0.6 * np.exp(-t / 15))
    start, end = np.array(STARTS)[:, None] / 60, (np.array(STARTS) + np.array(DURATIONS))[:, None] / 60
    weight = ((t >= start) & (t < end)) * np.exp2(-t / 20.36)
    values = np.empty((6, 6, 4, len(STARTS)), np.float32)
    K1, k2 = rates()
    for row in range(6):
        kernel = np.exp(-k2[0, row, 0] * np.arange(len(t)) / 120)
        kernel[0] = 0.5  # the trapezium rule
        tissue = np.convolve(parent, kernel)[: len(t)] / 120
        values[:, row] = K1[:, row, :, None] * ((weight * tissue).sum(axis=1) / weight.sum(axis=1))
    return values


def rates() -> tuple[np.ndarray, np.ndarray]:
    """K1 and k2 of every voxel; each axis has a slope of its own."""
    i, j, k = np.meshgrid(np.arange(6), np.arange(6), np.arange(4), indexing="ij")
    return 0.1 + 0.02 * i + 0.01 * j + 0.03 * k, 0.05 + 0.005 * j


def labels() -> np.ndarray:
    """Two regions of labels 1 and 4, with a rim of background."""
    values = np.zeros((6, 6, 4), np.int16)
    values[1:3, 1:5], values[3:5, 1:5, 1:] = 1, 4
    return values


def save(path: Path, values: np.ndarray, affine: np.ndarray = AFFINE) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    nibabel.save(nibabel.Nifti1Image(values, affine), path)
    return path


def dump(path: Path, content: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def change(path: Path, **fields: Any) -> None:
    """Change fields of a JSON file; None takes one out."""
    merged = {**json.loads(path.read_text()), **fields}
    dump(path, {key: value for key, value in merged.items() if value is not None})


def tree(root: Path) -> dict[str, bytes]:
    """Every file below a folder with its bytes, and every empty folder."""
    return {str(path.relative_to(root)): path.read_bytes() if path.is_file() else b"folder" for path in root.rglob("*")}


def differences(these: dict[str, bytes], those: dict[str, bytes]) -> dict[str, tuple[bytes, bytes]]:
    """What two trees do not share, by file: from a little before the first byte that differs."""
    found = {}
    for path in sorted(these.keys() | those.keys()):
        one, other = these.get(path, b"absent"), those.get(path, b"absent")
        if one != other:
            at = max(next((i for i, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), 0) - 40, 0)
            found[path] = one[at : at + 120], other[at : at + 120]
    return found
