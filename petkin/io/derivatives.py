"""What other programs left under derivatives/*/ for a scan: curves, segmentations, ready input functions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from petkin.io.inheritance import inherited
from petkin.io.labels import Dseg, find_dseg
from petkin.io.names import PIPELINE, FileName, prefix, scan_folder
from petkin.io.regions import RegionalCurves, read_tacs, read_volumes
from petkin.io.remarks import Remark, note, warning
from petkin.io.sidecar import PetSidecar

#: Labels (desc-) of tables named tacs that hold no measured curves: frame weights, and the truth of a simulation.
_NOT_CURVES = {"weights", "noisefree"}
_Found = TypeVar("_Found", RegionalCurves, Dseg)


@dataclass(frozen=True)
class Derived:
    """Derivatives of one scan."""

    curves: tuple[RegionalCurves, ...]
    dseg: tuple[Dseg, ...]
    input_table: Path | None
    remarks: tuple[Remark, ...]


def find_derivatives(root: Path, scan: Mapping[str, str], sidecar: PetSidecar) -> Derived:
    """Curves, segmentations and input functions of a scan, by its entities. petkin's own curves count only alone.

    Args:
        root: the study.
        scan: entities of the scan.
        sidecar: its `_pet.json`, for units and decay where a table's JSON is silent.

    Raises:
        InputError: a table that cannot be used.
    """
    remarks: list[Remark] = []
    dseg = _without_other_spaces([_dseg(*found) for found in _files(root, scan, "dseg", (".nii", ".nii.gz"))], remarks)
    tables = [
        (pipeline, path)
        for pipeline, path in _files(root, scan, "tacs", (".tsv",))
        if FileName.parse(path).entities.get("desc") not in _NOT_CURVES
    ]
    foreign = [(pipeline, path) for pipeline, path in tables if pipeline.name != PIPELINE]
    chosen = foreign if foreign or dseg else tables
    curves = [_curves(pipeline, path, scan, sidecar) for pipeline, path in chosen]
    curves.sort(key=lambda table: table.pvc != "")  # what was measured comes before what was corrected
    inputs = list(_files(root, scan, "inputfunction", (".tsv",)))
    ready = [path for pipeline, path in inputs if pipeline.name != PIPELINE] or [path for _, path in inputs]
    return Derived(_distinct(curves, remarks), _distinct(dseg, remarks), ready[0] if ready else None, tuple(remarks))


def _files(
    root: Path, scan: Mapping[str, str], suffix: str, extensions: tuple[str, ...]
) -> Iterator[tuple[Path, Path]]:
    """Pipeline folder and file, for every file of a suffix that belongs to a scan; sorted."""
    folder = scan_folder(scan)
    folders = dict.fromkeys((scan_folder({"sub": scan["sub"]}), folder))
    for pipeline in sorted(path for path in (root / "derivatives").glob("*") if path.is_dir()):
        for inside in folders:
            for path in sorted((pipeline / inside).glob(f"*_{suffix}.*")):
                name = FileName.parse(path)
                if name.suffix == suffix and name.extension in extensions and name.matches(scan):
                    yield pipeline, path


def _dseg(pipeline: Path, path: Path) -> Dseg:
    return find_dseg(path, tables=inherited(pipeline, path, ".tsv"))


def _without_other_spaces(found: list[Dseg], remarks: list[Remark]) -> list[Dseg]:
    """Segmentations in another space than the raw image are left out where one without a space entity exists."""
    spaced = [dseg for dseg in found if "space" in FileName.parse(dseg.path).entities]
    if not spaced or len(spaced) == len(found):
        return found
    for dseg in spaced:
        text = "It is in another space than the raw image and is not used."
        remarks.append(note("dseg-space", dseg.path.name, text))
    return [dseg for dseg in found if dseg not in spaced]


def _curves(pipeline: Path, path: Path, scan: Mapping[str, str], sidecar: PetSidecar) -> RegionalCurves:
    curves, _ = read_tacs(path, sidecars=inherited(pipeline, path, ".json"), image=sidecar)
    for morph in _morph(path, scan, curves.seg):
        curves = replace(curves, volumes=read_volumes(morph, curves.names))
    return curves


def _morph(path: Path, scan: Mapping[str, str], seg: str) -> list[Path]:
    found = sorted(path.parent.glob(f"{prefix({'sub': scan['sub']})}*_morph.tsv"))
    return [
        file for file in found if (name := FileName.parse(file)).matches(scan) and name.entities.get("seg", "") == seg
    ]


def _distinct(found: list[_Found], remarks: list[Remark]) -> tuple[_Found, ...]:
    """One of each (seg, pvc, desc): results are named by them. The first pipeline in alphabetical order wins."""
    kept: dict[tuple[str, str, str], _Found] = {}
    for item in found:
        key = (item.seg, item.pvc if isinstance(item, RegionalCurves) else "", item.desc)
        if key in kept:
            where = item.where if isinstance(item, RegionalCurves) else item.path.name
            text = f"Another table or image with seg-{item.seg or '(none)'} came first; this one is not used."
            remarks.append(warning("seg-repeated", where, text))
        else:
            kept[key] = item
    return tuple(kept.values())
