"""One scan fitted: input, weights, delay, then every model by region and by voxel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting import (
    Delay,
    FitResult,
    Method,
    check_choices,
    counting_weights,
    estimate_delay,
    find_method,
    undetermined,
    with_delay,
)
from petkin.imaging import FrameObservation
from petkin.inputs import InputFunction
from petkin.io import RegionalCurves, read_regions, read_table
from petkin.kinetics import ONE_TISSUE, TWO_TISSUE
from petkin.study.arterial import arterial_input
from petkin.study.request import FitRequest
from petkin.study.series import VoxelCurves, choose_mask, extract
from petkin.study.sources import Source

#: Told what is being done and how far it is, 0 to 1.
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class ScanFit:
    """Everything that came of one scan.

    Args:
        source: the scan.
        arterial: input function as sampled.
        delay: what was estimated, or None.
        applied: delay that the fits used, min, and its standard error.
        weights: frame weights (K,).
        how_weighted: one sentence.
        curves: regional curves, or None.
        voxels: voxel curves, or None.
        regional: result a model by region, in the order of the request.
        by_voxel: result a model by voxel.
        remarks: warnings, one sentence each.
    """

    source: Source
    arterial: InputFunction
    delay: Delay | None
    applied: tuple[float, float]
    weights: NDArray[np.float64]
    how_weighted: str
    curves: RegionalCurves | None
    voxels: VoxelCurves | None
    regional: tuple[FitResult, ...]
    by_voxel: tuple[FitResult, ...]
    remarks: tuple[str, ...]


def fit_scan(source: Source, request: FitRequest, progress: Progress) -> ScanFit:
    """Fit one scan as asked.

    Raises:
        InputError: something about the scan makes a right answer impossible.
    """
    methods = tuple(find_method(label) for label in request.models)
    check_choices(methods, request.choices)
    progress("blood", 0.02)
    arterial = arterial_input(source, request)
    observation = FrameObservation(
        source.frames,
        decay=source.decay if request.observation == "frame" else 0.0,
        mid_frame=request.observation == "mid",
    )
    progress("reading the image" if source.image is not None else "curves", 0.05)
    voxels, curves = _curves(source, request)
    whole = whole_brain(voxels, curves)
    weights, how = frame_weights(whole, source, request)
    progress("delay", 0.3)
    delay, applied, noticed = _delay(whole, arterial, observation, weights, request)
    arrived = arterial.delayed(applied[0])
    regional: list[FitResult] = []
    by_voxel: list[FitResult] = []
    for i, method in enumerate(methods):
        progress(f"{method.label} by region" if curves is not None else method.label, 0.4 + 0.5 * i / len(methods))
        if curves is not None:
            result = method.fit(curves.values, arrived, observation, weights, request.choices, False)
            regional.append(replace(with_delay(result, *applied), remarks=undetermined(result)))
        if voxels is not None:
            progress(f"{method.label} by voxel", 0.4 + 0.5 * (i + 0.3) / len(methods))
            result = method.fit(voxels.values.T, arrived, observation, weights, request.choices, True)
            by_voxel.append(replace(with_delay(result, *applied), remarks=undetermined(result)))
    remarks = (
        *source.remarks,
        *_curve_remarks(voxels, curves),
        *noticed,
        *_nothing_fitted(methods, regional, by_voxel),
    )
    return ScanFit(
        source, arterial, delay, applied, weights, how, curves, voxels, tuple(regional), tuple(by_voxel), remarks
    )


def _curves(source: Source, request: FitRequest) -> tuple[VoxelCurves | None, RegionalCurves | None]:
    if source.image is None:
        return None, source.curves
    regions = read_regions(source.dseg, source.image) if source.dseg is not None else None
    by_region = regions if source.curves is None and request.level != "voxel" else None
    if request.level == "region" and source.curves is not None:
        return None, source.curves
    mask, how = (
        (None, "") if request.level == "region" else choose_mask(source.image, source.frames, source.mask, regions)
    )
    voxels, curves = extract(source.image, source.frames, mask, how, by_region)
    return voxels, source.curves if source.curves is not None and request.level != "voxel" else curves


def whole_brain(voxels: VoxelCurves | None, curves: RegionalCurves | None) -> NDArray[np.float64]:
    """Mean curve of all that is fitted (K,): voxels in the mask, else regions by volume where volumes are known."""
    if voxels is not None:
        return voxels.mean
    if curves is None:
        raise InputError("There are neither voxels nor regions to fit.")
    usable = np.isfinite(curves.values).all(axis=1) & (curves.values.sum(axis=1) > 0)
    if not usable.any():
        raise InputError(f"{curves.where}: no region holds finite values above zero.")
    volumes = np.ones(len(curves.names)) if curves.volumes is None else curves.volumes
    share = np.where(np.isfinite(volumes[usable]), volumes[usable], np.nanmean(volumes[usable]))
    return np.average(curves.values[usable], axis=0, weights=share)


def frame_weights(whole: NDArray[np.float64], source: Source, request: FitRequest) -> tuple[NDArray[np.float64], str]:
    """Frame weights (K,) as asked, and a sentence on them.

    Raises:
        InputError: a table without a column `weight`, or of another length.
    """
    if request.weights == "counting":
        how = "w_k ~ d_k exp(-lambda t_k) / C_k of the whole-brain curve, mean 1 (counting noise)"
        return counting_weights(whole, source.frames, source.decay), how
    if request.weights == "constant":
        return np.ones(len(whole)), "all frames weigh the same"
    path = Path(request.weights)
    if not path.is_file():
        raise InputError(f"--weights {request.weights!r}: choose counting or constant, or give a table that exists.")
    table = read_table(path)
    if "weight" not in table or len(table) != len(whole):
        raise InputError(
            f"{path}: needs a column 'weight' with {len(whole)} rows, one a frame; it has {len(table)} rows."
        )
    weights = table["weight"].to_numpy(np.float64)
    if not (np.isfinite(weights).all() and (weights >= 0).all() and weights.any()):
        raise InputError(f"{path}: weights must be finite and not negative, and not all zero.")
    return weights, f"from {path.name}"


def _delay(
    whole: NDArray[np.float64],
    arterial: InputFunction,
    observation: FrameObservation,
    weights: NDArray[np.float64],
    request: FitRequest,
) -> tuple[Delay | None, tuple[float, float], tuple[str, ...]]:
    """The delay to apply with its error, and what to say of it."""
    if not isinstance(request.delay, str):
        return None, (float(request.delay), float("nan")), ()
    enough = int(np.count_nonzero(weights)) > len(TWO_TISSUE.parameters) + 3
    model = TWO_TISSUE if enough else ONE_TISSUE
    found = estimate_delay(whole, arterial, observation, weights, model, rate_bounds=request.choices.rate_bounds)
    if found.at_end:
        text = (
            f"The delay between blood and brain could not be estimated (it ran to {found.minutes * 60:.0f} s, an end "
            "of the span): none was applied; check the blood's time zero, or give --delay."
        )
        return found, (0.0, float("nan")), (text,)
    return found, (found.minutes, found.se), ()


def _curve_remarks(voxels: VoxelCurves | None, curves: RegionalCurves | None) -> tuple[str, ...]:
    remarks = []
    if voxels is not None:
        remarks.append(voxels.how)
        odd = int(np.count_nonzero(~np.isfinite(voxels.values).all(axis=0)))
        if odd:
            remarks.append(f"{odd} voxels in the mask hold NaN or infinite values and were not fitted.")
        negative = float(np.mean(voxels.values < 0))
        if negative > 0.01:
            remarks.append(f"{negative:.1%} of all voxel values in the mask are negative; they are fitted as they are.")
    return tuple(remarks)


def _nothing_fitted(methods: tuple[Method, ...], *results: list[FitResult]) -> tuple[str, ...]:
    """Models that have not one value."""
    return tuple(
        f"{method.label}: not one curve could be fitted; see the status codes."
        for group in results
        for method, result in zip(methods, group)
        if len(result.status) and not np.isfinite(result[method.outcome]).any()
    )
