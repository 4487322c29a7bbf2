"""What other programs left under derivatives/*/ for a scan: curves, segmentations, ready input functions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from petkin.errors import InputError
from petkin.io.checks import refuse_minutes
from petkin.io.inheritance import inherited
from petkin.io.labels import Dseg, find_dseg
from petkin.io.names import PIPELINE, FileName, prefix, scan_folder
from petkin.io.regions import RegionalCurves, read_tacs, read_volumes
from petkin.io.remarks import Remark, note, warning
from petkin.io.sidecar import PetSidecar
from petkin.units import SECONDS_PER_MINUTE

#: Tables named tacs that hold no curves.
_NOT_CURVES = {"weights"}
_Found = TypeVar("_Found", RegionalCurves, Dseg)


@dataclass(frozen=True)
class Derived:
    """Derivatives of one scan."""

    curves: tuple[RegionalCurves, ...]
    dseg: tuple[Dseg, ...]
    input_table: Path | None
    remarks: tuple[Remark, ...]


def find_derivatives(root: Path, scan: Mapping[str, str], sidecar: PetSidecar | None) -> Derived:
    """Curves, segmentations and input functions of a scan, by its entities. petkin's own curves count only alone.

    Args:
        root: the study.
        scan: entities of the scan.
        sidecar: its `_pet.json`, for units and decay where a table's JSON is silent; None where there is none.

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


def _curves(pipeline: Path, path: Path, scan: Mapping[str, str], sidecar: PetSidecar | None) -> RegionalCurves:
    default = None if sidecar is None else sidecar.units
    curves, fields = read_tacs(path, sidecars=inherited(pipeline, path, ".json"), default_unit=default)
    if sidecar is not None:
        refuse_minutes(curves.frames, sidecar.nuclide, fields="frame_start and frame_end")
        state = _decay_state(sidecar, fields, path.name)
        curves = curves.scaled(state.to_time_zero(curves.frames))
        curves = replace(curves, remarks=(*curves.remarks, *_other_frames(curves, sidecar)))
    for morph in _morph(path, scan, curves.seg):
        curves = replace(curves, volumes=read_volumes(morph, curves.names))
    return curves


def _decay_state(sidecar: PetSidecar, fields: Mapping[str, object], where: str) -> PetSidecar:
    """A table is corrected for decay as its own JSON says, else as the image it was drawn from."""
    if "ImageDecayCorrected" not in fields:
        return sidecar
    corrected, time = fields["ImageDecayCorrected"], fields.get("ImageDecayCorrectionTime", 0)
    if not isinstance(corrected, bool) or not isinstance(time, int | float):
        raise InputError(
            f"{where}: ImageDecayCorrected or ImageDecayCorrectionTime in its JSON is no true/false or number."
        )
    return sidecar.model_copy(update={"image_decay_corrected": corrected, "image_decay_correction_time": float(time)})


def _other_frames(curves: RegionalCurves, sidecar: PetSidecar) -> tuple[Remark, ...]:
    mine, theirs = curves.frames, sidecar.frames
    if len(mine) == len(theirs):
        off_s = SECONDS_PER_MINUTE * max(np.abs(mine.start - theirs.start).max(), np.abs(mine.end - theirs.end).max())
        if off_s <= 0.5:
            return ()
        text = f"Its frame times differ by up to {off_s:.3g} s from those of {sidecar.where}; the table's are used."
    else:
        text = f"It has {len(mine)} frames but {sidecar.where} has {len(theirs)}; the table's are used."
    return (warning("frames-differ", curves.where, text),)


def _morph(path: Path, scan: Mapping[str, str], seg: str) -> list[Path]:
    found = sorted(path.parent.glob(f"{prefix({'sub': scan['sub']})}*_morph.tsv"))
    return [
        file for file in found if (name := FileName.parse(file)).matches(scan) and name.entities.get("seg", "") == seg
    ]


def _distinct(found: list[_Found], remarks: list[Remark]) -> tuple[_Found, ...]:
    """One of each (seg, desc): results are named by them. The first pipeline in alphabetical order wins."""
    kept: dict[tuple[str, str], _Found] = {}
    for item in found:
        key = (item.seg, item.desc)
        if key in kept:
            where = item.where if isinstance(item, RegionalCurves) else item.path.name
            text = f"Another table or image with seg-{item.seg or '(none)'} came first; this one is not used."
            remarks.append(warning("seg-repeated", where, text))
        else:
            kept[key] = item
    return tuple(kept.values())
