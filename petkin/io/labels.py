"""Segmentations: label images (`_dseg.nii.gz`) with the names of their regions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.io.names import FileName
from petkin.io.nifti import Series, read_label_volume, require_same_grid
from petkin.io.tables import numbers, read_table, require_columns

#: Columns of a table of curves that hold its frame times.
FRAME_COLUMNS = ("frame_start", "frame_end")


@dataclass(frozen=True)
class Dseg:
    """A segmentation on disk.

    Args:
        path: label image; 0 is background.
        seg: label of the segmentation, "" where the file names none.
        desc: its desc label, "" for none.
        tables: TSV files (index, name) that apply to it, top first; the last one that names a label wins.
    """

    path: Path
    seg: str = ""
    desc: str = ""
    tables: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Regions:
    """A segmentation on the grid of a series.

    Args:
        labels: [x, y, z], 0 is background.
        index: labels that occur, ascending, (R,).
        names: their names, (R,).
        volumes: mm3, (R,).
        seg: label of the segmentation.
        desc: its desc label.
        where: file name.
    """

    labels: NDArray[np.int32]
    index: tuple[int, ...]
    names: tuple[str, ...]
    volumes: NDArray[np.float64]
    seg: str
    desc: str
    where: str


def find_dseg(path: Path, *, tables: Sequence[Path] | None = None) -> Dseg:
    """A segmentation by its image; its table is the TSV of the same name unless others are given.

    Raises:
        InputError: there is no such file.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file.")
    beside = path.with_name(path.name.partition(".")[0] + ".tsv")
    found = tuple(tables) if tables is not None else (beside,) if beside.is_file() else ()
    entities = FileName.parse(path).entities
    return Dseg(path, entities.get("seg", ""), entities.get("desc", ""), found)


def read_regions(dseg: Dseg, series: Series) -> Regions:
    """A segmentation with its names, on the grid of a series.

    Raises:
        InputError: another grid than the series', no label above 0, or a table without index and name.
    """
    labels, affine = read_label_volume(dseg.path)
    where = dseg.path.name
    require_same_grid(labels.shape, affine, series, what=where)
    if labels.min() < 0:
        raise InputError(f"{where}: label {labels.min()} is negative; labels count from 0, the background.")
    index, counts = np.unique(labels[labels > 0], return_counts=True)
    if not index.size:
        raise InputError(f"{where}: holds no label above 0, so there is no region.")
    named = _names(dseg.tables)
    names = [named.get(label, f"label-{label}") for label in map(int, index)]
    volumes = np.asarray(counts * abs(float(np.linalg.det(affine[:3, :3]))), np.float64)
    return Regions(labels, tuple(map(int, index)), _distinct(names, index), volumes, dseg.seg, dseg.desc, where)


def _names(tables: Sequence[Path]) -> dict[int, str]:
    named: dict[int, str] = {}
    for path in tables:
        table = read_table(path)
        require_columns(table, ["index", "name"], where=path.name)
        for index, name in zip(numbers(table, "index", where=path.name), table["name"], strict=True):
            if np.isfinite(index) and isinstance(name, str) and name.strip():
                named[int(index)] = name.strip()
    return named


def _distinct(names: Sequence[str], index: NDArray[np.int32]) -> tuple[str, ...]:
    """Names become columns beside the frame times, so one that is taken or that two labels share carries the label."""
    taken = [*names, *FRAME_COLUMNS]
    return tuple(name if taken.count(name) == 1 else f"{name}-{i}" for name, i in zip(names, index, strict=True))
