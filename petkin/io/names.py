"""BIDS file names taken apart, and every name that petkin writes.

Derivatives follow BEP023, the draft of 2026-02-26: a change of it is a change here alone.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from petkin.errors import InputError

#: Entities that name a scan, in file-name order.
SCAN_ENTITIES = ("sub", "ses", "task", "trc", "rec", "run")
_LABEL = re.compile(r"[0-9A-Za-z+]+")
PIPELINE = "petkin"
#: Label (pvc-) of regional curves corrected by a geometric transfer matrix, and start of the desc- label of maps of an
#: image denoised by HYPR-LR: BEP023 has no entity for that.
TRANSFER_MATRIX, HYPR = "GTM", "hypr"


@dataclass(frozen=True)
class FileName:
    """A BIDS file name taken apart: entity labels, suffix and extension."""

    entities: dict[str, str]
    suffix: str
    extension: str

    @classmethod
    def parse(cls, path: Path | str) -> FileName:
        """`sub-01_seg-gtm_tacs.tsv` -> entities sub 01, seg gtm; suffix tacs; extension .tsv."""
        stem, dot, extension = Path(path).name.partition(".")
        *parts, suffix = stem.split("_")
        pairs = (part.partition("-") for part in parts)
        return cls({key: label for key, dash, label in pairs if dash}, suffix, dot + extension)

    def matches(self, scan: Mapping[str, str]) -> bool:
        """Whether this file belongs to a scan: it names the subject, and contradicts none of the scan's entities."""
        mine = {key: label for key, label in self.entities.items() if key in SCAN_ENTITIES}
        return "sub" in mine and all(scan.get(key) == label for key, label in mine.items())


def prefix(scan: Mapping[str, str]) -> str:
    """Start of all file names of a scan, e.g. "sub-01_ses-baseline_run-1".

    Raises:
        InputError: no subject, or a label that is not letters and digits.
    """
    if "sub" not in scan:
        raise InputError("A scan needs a subject label (sub-<label>) to name its files.")
    return "_".join(f"{key}-{label(scan[key], entity=key)}" for key in SCAN_ENTITIES if key in scan)


def label(text: str, *, entity: str) -> str:
    """An entity's label, unchanged.

    Raises:
        InputError: it holds anything but letters, digits and "+": separators would change the file's name or folder.
    """
    if not _LABEL.fullmatch(text):
        raise InputError(f"Label {text!r} of entity {entity!r} may hold only letters and digits.")
    return text


def scan_folder(scan: Mapping[str, str]) -> PurePosixPath:
    """Folder of a scan's files below a dataset or pipeline root: sub-01[/ses-01]/pet."""
    folder = PurePosixPath(f"sub-{label(scan['sub'], entity='sub')}")
    return folder / f"ses-{label(scan['ses'], entity='ses')}" / "pet" if "ses" in scan else folder / "pet"


def _path(scan: Mapping[str, str], suffix: str, **entities: str) -> PurePosixPath:
    start = prefix(scan)
    middle = "".join(f"_{key}-{label(text, entity=key)}" for key, text in entities.items() if text)
    return scan_folder(scan) / f"{start}{middle}_{suffix}"


def map_path(scan: Mapping[str, str], model: str, measure: str = "", *, desc: str = "") -> PurePosixPath:
    """Parametric map: `<scan>_model-2TCM_meas-VT[_desc-se]_mimap.nii.gz`; without measure, `desc` says what it is."""
    return _path(scan, "mimap.nii.gz", model=model, meas=measure, desc=desc)


def kinpar_path(scan: Mapping[str, str], model: str, *, seg: str = "", pvc: str = "", desc: str = "") -> PurePosixPath:
    """Regional parameters: `<scan>_seg-<label>[_pvc-GTM]_model-2TCM_kinpar.tsv`."""
    return _path(scan, "kinpar.tsv", seg=seg, pvc=pvc, model=model, desc=desc)


def tacs_path(scan: Mapping[str, str], *, seg: str = "", pvc: str = "", desc: str = "") -> PurePosixPath:
    """Regional time-activity curves: `<scan>_seg-<label>[_pvc-GTM]_tacs.tsv`."""
    return _path(scan, "tacs.tsv", seg=seg, pvc=pvc, desc=desc)


def inputfunction_path(scan: Mapping[str, str]) -> PurePosixPath:
    """Input function: `<scan>_inputfunction.tsv`."""
    return _path(scan, "inputfunction.tsv")


def report_path(scan: Mapping[str, str], *, desc: str, model: str = "", extension: str = ".html") -> PurePosixPath:
    """Report: `<scan>[_model-2TCM]_desc-<what>_report.html`."""
    return _path(scan, f"report{extension}", model=model, desc=desc)


def states_path(scan: Mapping[str, str]) -> PurePosixPath:
    """What a diagnosis finds missing in a law, by region and frame: `<scan>_desc-state_gap.tsv`."""
    return _path(scan, "gap.tsv", desc="state")


def cohort_report_path(*, desc: str, extension: str = ".html") -> PurePosixPath:
    """Report on all scans, at the root of the derivatives: `group_desc-<what>_report.html`."""
    return PurePosixPath(f"group_desc-{label(desc, entity='desc')}_report{extension}")


def record_path(scan: Mapping[str, str]) -> PurePosixPath:
    """What a finished fit was made from and of: `<scan>_desc-fit_record.json`."""
    return _path(scan, "record.json", desc="fit")


def image_path(scan: Mapping[str, str]) -> PurePosixPath:
    """Raw image of a simulated scan: `<scan>_pet.nii.gz`."""
    return _path(scan, "pet.nii.gz")


def blood_path(scan: Mapping[str, str], recording: str) -> PurePosixPath:
    """Raw blood of a simulated scan: `<scan>_recording-manual_blood.tsv`."""
    return _path(scan, "blood.tsv", recording=recording)


def dseg_path(scan: Mapping[str, str], *, seg: str) -> PurePosixPath:
    """Label image: `<scan>_seg-<label>_dseg.nii.gz`."""
    return _path(scan, "dseg.nii.gz", seg=seg)


def morph_path(scan: Mapping[str, str], *, seg: str) -> PurePosixPath:
    """Region volumes: `<scan>_seg-<label>_morph.tsv`."""
    return _path(scan, "morph.tsv", seg=seg)


def sidecar_path(path: PurePosixPath) -> PurePosixPath:
    """The JSON beside a file: its name with everything from the first dot replaced."""
    return path.with_name(path.name.partition(".")[0] + ".json")


def derivatives_folder(study: Path) -> Path:
    """Where petkin's results go when no folder is given: `<study>/derivatives/petkin`."""
    return study / "derivatives" / PIPELINE
