"""An image case as files: a PET-BIDS study of one scan, written without the product."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import nibabel as nib
import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.images.cases import ImageScan

_PET = Path("sub-01") / "pet"


def write_study(scan: ImageScan, folder: Path) -> None:
    """Image, sidecar, blood and segmentation.

    Args:
        scan: what the product is given.
        folder: of the study; made here.
    """
    raw, regions = folder / _PET, folder / "derivatives" / "labels" / _PET
    raw.mkdir(parents=True)
    regions.mkdir(parents=True)
    _json(folder / "dataset_description.json", {"Name": "case", "BIDSVersion": "1.10.0", "DatasetType": "raw"})
    described = {"Name": "labels", "BIDSVersion": "1.10.0", "DatasetType": "derivative"}
    _json(regions.parents[1] / "dataset_description.json", described | {"GeneratedBy": [{"Name": "labels"}]})
    (folder / "participants.tsv").write_text("participant_id\nsub-01\n")
    _volume(raw / "sub-01_pet.nii.gz", scan.image.astype(np.float32), scan.voxel)
    _json(raw / "sub-01_pet.json", _sidecar(scan))
    _blood(scan, raw)
    _volume(regions / "sub-01_seg-parts_dseg.nii.gz", scan.labels.astype(np.int16), scan.voxel)
    rows = "".join(f"{r + 1}\t{name}\n" for r, name in enumerate(scan.regions))
    (regions / "sub-01_seg-parts_dseg.tsv").write_text("index\tname\n" + rows)


def _sidecar(scan: ImageScan) -> dict[str, Any]:
    frames = scan.frames
    start, lasts = 60.0 * frames.start, 60.0 * (frames.end - frames.start)
    carbon = frames.decay > 0.02
    return {
        "Units": "kBq/mL",
        "TracerName": "tracer",
        "TracerRadionuclide": "C11" if carbon else "F18",
        "RadionuclideHalfLife": round(60.0 * math.log(2.0) / frames.decay, 6),
        "InjectedRadioactivity": 300.0,
        "InjectedRadioactivityUnits": "MBq",
        "TimeZero": "09:00:00",
        "ScanStart": 0,
        "InjectionStart": 0,
        "FrameTimesStart": [round(float(t), 6) for t in start],
        "FrameDuration": [round(float(d), 6) for d in lasts],
        "ImageDecayCorrected": True,
        "ImageDecayCorrectionTime": 0,
        "DecayCorrectionFactor": [float(f) for f in lasts / 60.0 / frames.counted],
    }


def _blood(scan: ImageScan, folder: Path) -> None:
    blood, path = scan.blood, folder / "sub-01_recording-manual_blood.tsv"
    columns = np.stack([60.0 * blood.t, blood.total, blood.whole, blood.parent], axis=1)
    names = "time\tplasma_radioactivity\twhole_blood_radioactivity\tmetabolite_parent_fraction\n"
    path.write_text(names + "".join("\t".join(f"{v:.9g}" for v in row) + "\n" for row in columns))
    units = {"time": "s", "plasma_radioactivity": "kBq/mL", "whole_blood_radioactivity": "kBq/mL"}
    fields: dict[str, Any] = {name: {"Description": name, "Units": unit} for name, unit in units.items()}
    fields["metabolite_parent_fraction"] = {"Description": "share that is tracer", "Units": "unitless"}
    there = {"PlasmaAvail": True, "WholeBloodAvail": True, "MetaboliteAvail": True, "DispersionCorrected": True}
    _json(path.with_suffix(".json"), there | fields)


def _volume(path: Path, values: NDArray[Any], voxel: float) -> None:
    affine = np.diag([voxel, voxel, voxel, 1.0])
    affine[:3, 3] = -0.5 * voxel * (np.array(values.shape[:3]) - 1)
    nib.save(nib.Nifti1Image(values, affine), path)  # pyright: ignore[reportPrivateImportUsage]


def _json(path: Path, fields: dict[str, Any]) -> None:
    path.write_text(json.dumps(fields, indent=1))
