"""A PET-BIDS study on disk: its scans, with everything that belongs to each."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from petkin.errors import InputError
from petkin.imaging import FrameSchedule
from petkin.io import blood_checks
from petkin.io.blood import BloodRecord, join_recordings
from petkin.io.blood_table import read_blood_table
from petkin.io.checks import check_sidecar
from petkin.io.derivatives import find_derivatives
from petkin.io.inheritance import inherited
from petkin.io.jsonfile import read_json
from petkin.io.labels import Dseg
from petkin.io.names import SCAN_ENTITIES, FileName, prefix, scan_folder
from petkin.io.nifti import Series, open_series
from petkin.io.regions import RegionalCurves
from petkin.io.remarks import Remark, note, severe
from petkin.io.sidecar import PetSidecar, read_sidecar
from petkin.io.tables import read_table

_IMAGES = (".nii.gz", ".nii")


@dataclass(frozen=True)
class Scan:
    """One scan of a study.

    Args:
        entities: labels by entity (sub, ses, task, trc, rec, run), those that there are.
        sidecar: its `_pet.json`, inheritance applied.
        image: raw dynamic image; None where the study has only curves.
        blood: None where there is none.
        curves: regional curves found under derivatives, kBq/mL at time zero.
        dseg: segmentations found under derivatives.
        input_table: a ready `_inputfunction.tsv`, only for those who ask for it; raw blood comes first.
        body_weight: kg; None where it is not stated.
        remarks: everything odd about it.
    """

    entities: dict[str, str]
    sidecar: PetSidecar
    image: Path | None
    blood: BloodRecord | None
    curves: tuple[RegionalCurves, ...]
    dseg: tuple[Dseg, ...]
    input_table: Path | None
    body_weight: float | None
    remarks: tuple[Remark, ...] = ()

    @property
    def subject(self) -> str:
        """Label of the subject, e.g. "01"."""
        return self.entities["sub"]

    @property
    def session(self) -> str:
        """Label of the session, "" for none."""
        return self.entities.get("ses", "")

    @property
    def prefix(self) -> str:
        """Start of its file names, e.g. "sub-01_ses-baseline"."""
        return prefix(self.entities)

    @property
    def frames(self) -> FrameSchedule:
        """Frames of the image, min. A table of curves carries its own."""
        return self.sidecar.frames

    @property
    def nuclide(self) -> str:
        """Radionuclide in BIDS spelling, e.g. "C11"."""
        return self.sidecar.nuclide

    def open_image(self) -> Series:
        """The image, its frames yielded in kBq/mL decay-corrected to time zero.

        Raises:
            InputError: there is none, or it does not agree with the sidecar.
        """
        if self.image is None:
            raise InputError(f"{self.prefix}: there is no image (_pet.nii.gz); only regional curves can be fitted.")
        factors = self.sidecar.kbq_per_ml * self.sidecar.to_time_zero(self.frames)
        return open_series(self.image, frames=self.frames, factors=factors)

    def require_blood(self) -> BloodRecord:
        """The blood, long enough for the scan.

        Raises:
            InputError: there is none, or it ends too early.
        """
        if self.blood is None:
            raise InputError(
                f"{self.prefix}: there is no blood (_blood.tsv); this model needs an arterial input function."
            )
        blood_checks.require_cover(self.blood, self.frames)
        return self.blood


@dataclass(frozen=True)
class Study:
    """A study.

    Args:
        root: its folder.
        name: Name of dataset_description.json, or the folder's.
        scans: sorted by subject and session.
        remarks: what is odd about the study as a whole.
        refused: what was wrong with scans that could not be read, one line each; only filled where that was asked for.
    """

    root: Path
    name: str
    scans: tuple[Scan, ...]
    remarks: tuple[Remark, ...] = ()
    refused: tuple[str, ...] = ()


def read_study(root: Path, *, subjects: Collection[str] | None = None, refuse: bool = True) -> Study:
    """Read a study.

    Args:
        root: folder with sub-<label>/[ses-<label>/]pet/.
        subjects: labels to read, without "sub-"; None for all.
        refuse: raise on the first scan that cannot be used; False lists it under `refused` and goes on.

    Raises:
        InputError: no such folder, no scan, or one that cannot be used.
    """
    if not root.is_dir():
        raise InputError(f"{root}: no such folder; a study is a PET-BIDS folder with sub-<label>/pet/ inside.")
    found = [scan for scan in _scans(root) if subjects is None or scan["sub"] in subjects]
    if not found:
        who = "" if subjects is None else f" of {', '.join(sorted(subjects))}"
        raise InputError(f"{root}: no PET scan{who} found; expected sub-<label>/[ses-<label>/]pet/*_pet.json.")
    name, remarks = _describe(root)
    weights = _body_weights(root)
    scans, refused = [], []
    for entities in found:
        try:
            scans.append(_read_scan(root, entities, weights))
        except InputError as error:
            if refuse:
                raise
            refused.append(str(error))
    return Study(root, name, tuple(scans), remarks, tuple(refused))


def _scans(root: Path) -> list[dict[str, str]]:
    """Entities of every scan: images and sidecars name them, blood where a folder has neither."""
    scans: dict[tuple[str, ...], dict[str, str]] = {}
    folders = sorted([*root.glob("sub-*/pet"), *root.glob("sub-*/ses-*/pet")])
    for folder in folders:
        names = [FileName.parse(path) for path in sorted(folder.iterdir()) if path.is_file()]
        images = [name for name in names if name.suffix == "pet" and name.extension in (*_IMAGES, ".json")]
        for name in images or [name for name in names if name.suffix == "blood"]:
            scan = {key: name.entities[key] for key in SCAN_ENTITIES if key in name.entities}
            if "sub" in scan:
                scans[tuple(scan.get(key, "") for key in SCAN_ENTITIES)] = scan
    return [scans[key] for key in sorted(scans)]


def _describe(root: Path) -> tuple[str, tuple[Remark, ...]]:
    path = root / "dataset_description.json"
    if not path.is_file():
        text = "It is missing; BIDS asks for it, petkin takes the folder's name instead."
        return root.resolve().name, (note("no-description", path.name, text),)
    return str(read_json(path).get("Name") or root.resolve().name), ()


def _body_weights(root: Path) -> dict[str, float]:
    """Body weight (kg) by subject label, from participants.tsv."""
    path = root / "participants.tsv"
    if not path.is_file():
        return {}
    table = read_table(path)
    column = next((name for name in ("body_weight", "weight") if name in table.columns), None)
    if column is None or "participant_id" not in table.columns:
        return {}
    weights = {}
    for participant, weight in zip(table["participant_id"], table[column], strict=True):
        if isinstance(weight, int | float) and np.isfinite(weight) and weight > 0:
            weights[str(participant).removeprefix("sub-")] = float(weight)
    return weights


def _read_scan(root: Path, entities: dict[str, str], weights: Mapping[str, float]) -> Scan:
    folder, start = root / scan_folder(entities), prefix(entities)
    sidecar = _sidecar(root, folder / f"{start}_pet.json")
    image = next((path for extension in _IMAGES if (path := folder / f"{start}_pet{extension}").is_file()), None)
    blood = _blood(root, folder, entities, sidecar)
    derived = find_derivatives(root, entities, sidecar)
    remarks = [*check_sidecar(sidecar), *derived.remarks]
    remarks += [remark for curves in derived.curves for remark in curves.remarks]
    remarks += _blood_remarks(blood, sidecar, derived.curves, start)
    if image is None and not derived.curves:
        remarks.append(severe("nothing-to-fit", start, "There is neither an image nor a table of regional curves."))
    weight = sidecar.body_weight or weights.get(entities["sub"])
    return Scan(
        entities, sidecar, image, blood, derived.curves, derived.dseg, derived.input_table, weight, tuple(remarks)
    )


def _sidecar(root: Path, path: Path) -> PetSidecar:
    files = inherited(root, path, ".json")
    if not files:
        raise InputError(f"{path}: no such file, and none above it to inherit; frame times and units come from it.")
    return read_sidecar(files)


def _blood(root: Path, folder: Path, scan: Mapping[str, str], sidecar: PetSidecar) -> BloodRecord | None:
    tables = {}
    for path in sorted(folder.glob("*_blood.tsv")):
        name = FileName.parse(path)
        if name.suffix == "blood" and name.matches(scan):
            files = inherited(root, path, ".json")
            if not files:
                raise InputError(f"{path.with_suffix('.json').name}: is missing; it states the Units of {path.name}.")
            tables[name.entities.get("recording", "")] = read_blood_table(path, sidecars=files)
    return join_recordings(tables, dispersion_constant_s=sidecar.dispersion_constant_s) if tables else None


def _blood_remarks(
    blood: BloodRecord | None, sidecar: PetSidecar, curves: tuple[RegionalCurves, ...], start: str
) -> list[Remark]:
    if blood is None:
        return [note("no-blood", start, "There is no blood; only models with a reference region can be fitted.")]
    remarks = [*blood.remarks, *blood_checks.against_image_unit(blood, sidecar.units), *blood_checks.complete(blood)]
    try:
        remarks += blood_checks.require_cover(blood, sidecar.frames)
    except InputError as error:
        text = str(error).removeprefix(f"{blood.where}: ")
        remarks.append(severe("blood-cover", blood.where, text[0].upper() + text[1:]))
    if curves:
        remarks += blood_checks.against_tissue(blood, curves[0].values)
    return remarks
