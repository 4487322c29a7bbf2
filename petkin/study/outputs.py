"""What a fit leaves on disk, named after BEP023."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petkin import __version__
from petkin.errors import InputError
from petkin.fitting import Column, FitResult, Status
from petkin.io import (
    AtomicFolder,
    json_text,
    names,
    read_json,
    require_writable,
    write_input_table,
    write_map,
    write_table,
    write_tacs,
    write_text,
)
from petkin.io import descriptions as describe
from petkin.study.arterial import sampled_input
from petkin.study.fit_scan import ScanFit
from petkin.study.geometry import denoising_fields
from petkin.study.request import FitRequest

_DESCRIPTION = "dataset_description.json"
_CHI2 = "Weighted residual sum of squares over its degrees of freedom"
_AICC = "Akaike criterion for small samples, of models with the same weights"
#: Measure, desc, values of the voxels, value outside of the mask, and sidecar of a map.
_Map = tuple[str, str, NDArray, float, dict[str, Any]]
#: Units of what is held or shared and not estimated by curve.
_UNITS = {"k2prime": "min^-1"}
_MEANINGS = {int(status): status.meaning for status in Status}


@contextmanager
def writing(folder: AtomicFolder, fit: ScanFit, request: FitRequest) -> Iterator[None]:
    """Write tables, maps and their sidecars of one scan into the staging folder: tables first, maps during the block.

    Compression leaves the interpreter's lock alone, so a report is drawn meanwhile.
    """
    _write_tables(folder, fit, request)
    pool = ThreadPoolExecutor(min(fit.voxels.plan.maps, os.cpu_count() or 1) if fit.voxels else 1)
    try:
        maps = [
            pool.submit(job)
            for result in (*fit.by_voxel, *fit.voxel_choice)
            for job in _map_jobs(folder, fit, result, request)
        ]
        yield
        for one in maps:
            one.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _write_tables(folder: AtomicFolder, fit: ScanFit, request: FitRequest) -> None:
    scan = fit.source.entities
    if fit.arterial is not None:
        arrived = fit.arterial.delayed(fit.applied[0])
        _table_with_json(
            folder,
            names.inputfunction_path(scan),
            lambda path: write_input_table(path, sampled_input(arrived, fit.source.frames)),
            describe.inputfunction_sidecar(_shared("", fit, request)),
        )
    if fit.curves is not None:
        path = names.tacs_path(scan, seg=fit.curves.seg, pvc=fit.curves.pvc, desc=fit.curves.desc)
        shared = _shared("", fit, request) | _corrected(fit)
        write_tacs(folder.path(path), fit.curves, describe.tacs_sidecar(shared))
        for result in (*fit.regional, *fit.regional_choice):
            _write_kinpar(folder, fit, result, request)


def require_own_folder(out: Path) -> None:
    """Whether results may be written to `out`: it can be written, and is no dataset of somebody else's.

    Raises:
        InputError: it cannot be written, or its dataset_description.json is not petkin's.
    """
    require_writable(out)
    description = out / _DESCRIPTION
    if description.is_file():
        made_by = read_json(description).get("GeneratedBy")
        named = [entry.get("Name") for entry in made_by if isinstance(entry, dict)] if isinstance(made_by, list) else []
        if names.PIPELINE not in named or read_json(description).get("DatasetType") != "derivative":
            raise InputError(f"{out}: holds another dataset, whose description would be lost; choose another folder.")


def write_study_description(folder: AtomicFolder, name: str, *, out: Path, raw: Path) -> None:
    """dataset_description.json of the results at `out`, with the way from there to what was fitted."""
    root = raw if raw.is_dir() else raw.parent
    way = PurePosixPath(Path(os.path.relpath(root.resolve(), out.resolve()))).as_posix()
    text = json_text(describe.dataset_description(__version__, name=name, sources=[way]))
    write_text(folder.path(_DESCRIPTION), text)


def kinpar_table(fit: ScanFit, result: FitResult) -> pd.DataFrame:
    """index, name, then value and percent standard error of every quantity, chi2, aicc, status, what else is known."""
    assert fit.curves is not None
    index = fit.curves.index or tuple(range(1, len(fit.curves.names) + 1))
    columns: dict[str, Any] = {"index": index, "name": fit.curves.names}
    for estimate in result.estimates:
        measure = describe.measure_name(estimate.symbol)
        columns[measure] = estimate.value
        columns[f"{measure}-se"] = estimate.percent_se
    columns |= {"chi2": result.chi2, "aicc": result.aicc, "status": result.status.astype(int)}
    return pd.DataFrame(columns | {_name(column): column.cells for column in result.columns})


def _name(column: Column) -> str:
    """A column's name in files, where symbols are spelt their way."""
    symbol, dash, what = column.name.rpartition("-")
    return f"{describe.measure_name(symbol)}{dash}{what}"


def _write_kinpar(folder: AtomicFolder, fit: ScanFit, result: FitResult, request: FitRequest) -> None:
    assert fit.curves is not None
    curves = fit.curves
    path = names.kinpar_path(fit.source.entities, result.model, seg=curves.seg, pvc=curves.pvc, desc=curves.desc)
    shared = _shared(result.model, fit, request, result) | _corrected(fit)
    sidecar = describe.kinpar_sidecar(_columns(result), _MEANINGS, shared)
    sidecar |= {_name(column): describe.column_fields(column.meaning, column.unit) for column in result.columns}
    _table_with_json(folder, path, lambda p: write_table(p, kinpar_table(fit, result)), sidecar)


def _columns(result: FitResult) -> list[describe.Measure]:
    return [describe.Measure(e.symbol, e.unit, e.meaning) for e in result.estimates]


def _map_jobs(
    folder: AtomicFolder, fit: ScanFit, result: FitResult, request: FitRequest
) -> Iterator[Callable[[], None]]:
    voxels = fit.voxels
    assert voxels is not None
    shared, start = _shared(result.model, fit, request, result), ""
    if request.hypr is not None:
        shared, start = shared | denoising_fields(request.hypr), names.HYPR

    def write(path: Path, values: NDArray, outside: float, sidecar: dict[str, Any]) -> None:
        write_map(path, voxels.volume(values, outside), voxels.series.affine, sidecar)

    for measure, desc, *rest in _maps(result, shared):
        path = names.map_path(fit.source.entities, result.model, measure, desc=start + desc)
        yield partial(write, folder.path(path), *rest)


def _maps(result: FitResult, shared: dict[str, Any]) -> Iterator[_Map]:
    for column, estimate in zip(_columns(result), result.estimates):
        yield column.name, "", estimate.value, np.nan, describe.map_sidecar(column, shared, percent_se=False)
        yield column.name, "se", estimate.percent_se, np.nan, describe.map_sidecar(column, shared, percent_se=True)
    yield "", "chi2", result.chi2, np.nan, {"Description": _CHI2, "Units": "unitless", **shared}
    yield "", "aicc", result.aicc, np.nan, {"Description": _AICC, "Units": "unitless", **shared}
    yield "", "status", result.status, Status.OUTSIDE, describe.status_sidecar(_MEANINGS, shared)
    for column in (column for column in result.columns if column.mapped):
        measure, _, desc = column.name.rpartition("-")
        outside = 0 if np.issubdtype(column.values.dtype, np.integer) else np.nan
        fields = describe.column_fields(column.meaning, column.unit, column.levels)
        yield measure, desc, column.values, outside, fields | shared


def _shared(model: str, fit: ScanFit, request: FitRequest, result: FitResult | None = None) -> dict[str, Any]:
    """Fields that all sidecars of a scan have: model, settings, delay, weights, software."""
    extra: dict[str, Any] = {"Observation": request.observation}
    if fit.arterial is not None:
        delay, se = fit.applied
        extra |= {
            "InputDelay": round(delay * 60.0, 6),
            "InputDelayUnits": "s",
            "InputDelaySE": None if np.isnan(se) else round(se * 60.0, 6),
        }
    if result is not None:
        if "reference" in result.settings:
            extra["ReferenceRegion"] = result.settings["reference"]
        fixed: dict[str, float] = result.settings.get("fixed", {})
        units = _UNITS | {estimate.symbol: estimate.unit for estimate in result.estimates}
        if result.shared:
            extra["SharedParameters"] = {
                describe.measure_name(symbol): {
                    "Value": value,
                    "Units": describe.file_unit(units.get(symbol, "")),
                    "PercentSE": percent_se if np.isfinite(percent_se) else None,
                }
                for symbol, (value, percent_se) in result.shared.items()
            }
        extra |= {
            "InputValuesLabels": [describe.measure_name(s) for s in fixed],
            "InputValues": list(fixed.values()),
            "InputValuesUnits": [describe.file_unit(units.get(s, "")) for s in fixed],
            "Settings": {k: v for k, v in result.settings.items() if k != "fixed"},
            "Weights": fit.how_weighted,
        }
    return describe.provenance(
        model, sources=fit.source.files, version=__version__, command=request.command_line, extra=extra
    )


def _corrected(fit: ScanFit) -> dict[str, Any]:
    """What regional results say about their correction for partial volume, if they have had one."""
    return fit.partial_volume.fields if fit.partial_volume is not None else {}


def _table_with_json(folder: AtomicFolder, path: PurePosixPath, write: Any, sidecar: dict[str, Any]) -> None:
    write(folder.path(path))
    write_text(folder.path(names.sidecar_path(path)), json_text(sidecar))
