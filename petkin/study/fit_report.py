"""The report of one fitted scan."""

from __future__ import annotations

from itertools import zip_longest
from typing import Any

import nibabel as nib
import numpy as np
from numpy.typing import NDArray

from petkin import __version__
from petkin.fitting import FitResult, agreement
from petkin.inputs import InputFunction
from petkin.methods import find_method
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
from petkin.study.geometry import geometry_methods
from petkin.study.request import FitRequest
from petkin.study.series import StoredValues

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
        _section(label, regional, voxel, shift, fit, truth)
        for label, regional, voxel, shift in zip_longest(request.models, fit.regional, fit.by_voxel, fit.mid_frame)
    )
    until = float(fit.source.frames.end[-1])
    return FitReport(
        title=f"{fit.source.label}: {' and '.join(s.model for s in sections)}",
        models=sections,
        regions=regions,
        input=None if fit.arterial is None else _input(fit.arterial, until),
        scan=fit.source.facts,
        command_line=request.command_line,
        version=f"petkin {__version__}",
        warnings=tuple(map(str, fit.remarks)),
        limits=tuple(dict.fromkeys(r for result in (*fit.regional, *fit.by_voxel) for r in result.remarks)),
        methods=(
            _OBSERVED[request.observation],
            f"Weights: {fit.how_weighted}.",
            *_chosen(fit, request),
            *_compared_models(fit, request),
        ),
        citations=("Innis RB et al. J Cereb Blood Flow Metab 2007;27:1533-1539, doi:10.1038/sj.jcbfm.9600493",),
    )


def _compared_models(fit: ScanFit, request: FitRequest) -> list[str]:
    """Which model the regions ask for, and on what all agree."""
    same = [result for method, result in zip(request.methods, fit.regional) if method.comparable]
    return [agreement(same)] if fit.regional_choice else []


def _chosen(fit: ScanFit, request: FitRequest) -> list[str]:
    """Where the delay and the voxels come from."""
    if fit.arterial is None:
        return [fit.voxels.how] if fit.voxels is not None else []
    if not isinstance(request.delay, str):
        delay = f"Delay of the input: {60 * request.delay:g} s, as asked."
    elif fit.delay is None or fit.delay.at_end:
        delay = "Delay of the input: none, because it could not be estimated."
    else:
        seen = "all regions at once" if request.share_delay else "the whole-brain curve"
        delay = f"Delay of the input: where a compartment model with free blood volume fits {seen} best."
    return [
        delay,
        *([fit.voxels.how] if fit.voxels is not None else []),
        *geometry_methods(fit.partial_volume, request),
    ]


def _input(arterial: InputFunction, until: float) -> InputCurves:
    times = curve_times(until)
    return InputCurves.from_input(
        arterial,
        until,
        total_plasma=None if arterial.total_plasma is None else np.asarray(arterial.total_plasma(times)),
        parent_fraction=None if arterial.parent_fraction is None else np.asarray(arterial.parent_fraction(times)),
    )


def _section(
    label: str,
    regional: FitResult | None,
    voxel: FitResult | None,
    shift: str | None,
    fit: ScanFit,
    truth: tuple[TruthRow, ...],
) -> ModelSection:
    method = find_method(label)
    return ModelSection(
        model=method.label,
        regional=regional,
        maps=None if voxel is None else _maps(voxel, fit),
        truth=_compared(truth, regional, fit),
        equations=(method.equation,),
        methods=(method.how, *_shared(regional, "regions"), *_shared(voxel, "voxels"), *([shift] if shift else [])),
        citations=(method.reference,),
        comparable=method.comparable,
    )


def _shared(result: FitResult | None, of: str) -> list[str]:
    """What all curves have in common, a sentence each."""
    if result is None:
        return []
    named = [f"Reference region of all {of}: {result.settings['reference']}."] if "reference" in result.settings else []
    return named + [f"{s} of all {of}: {value:.4g} (SE {error:.2g} %)." for s, (value, error) in result.shared.items()]


def _maps(result: FitResult, fit: ScanFit) -> MapSet:
    voxels = fit.voxels
    assert voxels is not None
    mm: Any = tuple(float(v) for v in voxels.series.voxel_mm)

    def held(values: NDArray[np.floating]) -> Any:
        return StoredValues(voxels, values) if voxels.plan.on_disk else values

    return MapSet(
        maps=(
            *(ParameterMap(e.symbol, e.unit, held(e.value), held(e.percent_se)) for e in result.estimates),
            ParameterMap("chi2", "", held(result.chi2)),
        ),
        status=result.status,
        mask=voxels.mask,
        voxel_mm=mm,
        axes=directions(voxels.series.affine),
        settings=result.settings,
        remarks=result.remarks,
    )


def directions(affine: NDArray[np.float64]) -> str:
    """Direction of rising index along each array axis; "" where one of them has none."""
    codes = nib.aff2axcodes(affine)
    return "" if None in codes else "".join(map(str, codes))


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
