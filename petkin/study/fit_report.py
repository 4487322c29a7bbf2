"""The report of one fitted scan."""

from __future__ import annotations

from itertools import zip_longest
from typing import Any

import nibabel as nib
import numpy as np

from petkin import __version__
from petkin.fitting import FitResult, Status, find_method
from petkin.reporting import (
    FitReport,
    InputCurves,
    MapSet,
    ModelSection,
    ParameterMap,
    RegionCurves,
    TruthRow,
    curve_times,
)
from petkin.study.fit_scan import ScanFit
from petkin.study.request import FitRequest

_OBSERVED = {
    "frame": "Frame values are decay-weighted means of the model over each frame, as a scanner's decay-corrected "
    "frames are: x_k = int C e^(-lambda t) dt / int e^(-lambda t) dt.",
    "plain": "Frame values are time averages of the model over each frame.",
    "mid": "Frame values are the model at mid-frame, to compare with other programs; frame means are more accurate.",
}


def build_report(fit: ScanFit, request: FitRequest, truth: tuple[TruthRow, ...] = ()) -> FitReport:
    """The report's contents from a fitted scan.

    Args:
        fit: the scan.
        request: what was asked.
        truth: known values of a simulated study; shown beside the estimates of the model they belong to.
    """
    regions = None
    if fit.curves is not None:
        regions = RegionCurves(fit.curves.names, fit.source.frames, fit.curves.values)
    sections = tuple(
        _section(label, regional, voxel, fit, truth)
        for label, regional, voxel in zip_longest(request.models, fit.regional, fit.by_voxel)
    )
    until = float(fit.source.frames.end[-1])
    return FitReport(
        title=f"{fit.source.label}: {' and '.join(s.model for s in sections)}",
        models=sections,
        regions=regions,
        input=_input(fit, until),
        scan=fit.source.facts,
        command_line=request.command_line,
        version=f"petkin {__version__}",
        warnings=fit.remarks,
        limits=tuple(dict.fromkeys(r for result in (*fit.regional, *fit.by_voxel) for r in result.remarks)),
        methods=(_OBSERVED[request.observation], f"Weights: {fit.how_weighted}."),
        citations=("Innis RB et al. J Cereb Blood Flow Metab 2007;27:1533-1539, doi:10.1038/sj.jcbfm.9600493",),
    )


def _input(fit: ScanFit, until: float) -> InputCurves:
    import torch

    times = torch.tensor(curve_times(until))
    arterial = fit.arterial
    return InputCurves.from_input(
        arterial,
        until,
        total_plasma=None if arterial.total_plasma is None else arterial.total_plasma(times).numpy(),
        parent_fraction=None if arterial.parent_fraction is None else arterial.parent_fraction(times).numpy(),
    )


def _section(
    label: str, regional: FitResult | None, voxel: FitResult | None, fit: ScanFit, truth: tuple[TruthRow, ...]
) -> ModelSection:
    method = find_method(label)
    return ModelSection(
        model=method.label,
        regional=regional,
        maps=None if voxel is None else _maps(voxel, fit),
        truth=_compared(truth, regional, fit),
        equations=(method.equation,),
        citations=(method.reference,),
        comparable=method.comparable,
    )


def _maps(result: FitResult, fit: ScanFit) -> MapSet:
    voxels = fit.voxels
    assert voxels is not None
    affine = voxels.series.affine
    mm: Any = tuple(float(v) for v in voxels.series.voxel_mm)
    return MapSet(
        maps=tuple(
            ParameterMap(
                e.symbol,
                e.unit,
                voxels.volume(e.value.astype(np.float32), np.nan),
                voxels.volume(e.percent_se.astype(np.float32), np.nan),
            )
            for e in result.estimates
        ),
        status=voxels.volume(result.status, Status.OUTSIDE),
        voxel_mm=mm,
        axes="".join(nib.aff2axcodes(affine)),
        settings=result.settings,
        remarks=result.remarks,
    )


def _compared(truth: tuple[TruthRow, ...], regional: FitResult | None, fit: ScanFit) -> tuple[TruthRow, ...]:
    """Truth rows with this model's estimates, for the quantities and regions that it has."""
    if regional is None or fit.curves is None:
        return ()
    place = {name: i for i, name in enumerate(fit.curves.names)}
    mine = {e.symbol: e for e in regional.estimates}
    return tuple(
        TruthRow(
            row.region, row.symbol, mine[row.symbol].unit, row.truth, float(mine[row.symbol].value[place[row.region]])
        )
        for row in truth
        if row.symbol in mine and row.region in place
    )
