"""One scan fitted: input, weights, delay, then every model by region and by voxel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Delay, FitResult, Given, undetermined
from petkin.imaging import FrameObservation
from petkin.inputs import InputFunction
from petkin.io import RegionalCurves, Remark, against_tissue, read_regions
from petkin.io.remarks import severe, warning
from petkin.methods import Method
from petkin.study.blocks import fit_voxels
from petkin.study.certainty import check_regions, chosen_model, more_certain
from petkin.study.dispersion import freed_input
from petkin.study.forecast import with_forecast
from petkin.study.geometry import PartialVolume, denoise, denoising_remark, partial_volume
from petkin.study.mid_frame import mid_frame_shift
from petkin.study.reference import reference_curve
from petkin.study.request import FitRequest
from petkin.study.resources import Resources
from petkin.study.series import VoxelCurves, choose_mask, extract
from petkin.study.sources import Source
from petkin.study.t_star import with_t_star
from petkin.study.whole_brain import coarse_frames, frame_weights, shared_delay, whole_brain

#: Share of negative voxel values in the mask from which on it is worth a remark.
_MANY_NEGATIVE = 0.01
#: Told what is being done and how far it is, 0 to 1.
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class ScanFit:
    """Everything that came of one scan.

    Args:
        source: the scan.
        arterial: input function as sampled, or None where no model needs one.
        delay: what was estimated, or None.
        applied: delay that the fits used, min, and its standard error.
        weights: frame weights (K,).
        how_weighted: one sentence.
        curves: regional curves, or None.
        voxels: voxel curves, or None.
        regional: result a model by region, in the order of the request.
        by_voxel: result a model by voxel.
        regional_choice, voxel_choice: models compared by AICc and averaged; empty for fewer than two.
        mid_frame: a sentence a model on what frame averages change, "" where that was not asked.
        remarks: warnings.
        partial_volume: the correction that the regional curves have had, or None.
    """

    source: Source
    arterial: InputFunction | None
    delay: Delay | None
    applied: tuple[float, float]
    weights: NDArray[np.float64]
    how_weighted: str
    curves: RegionalCurves | None
    voxels: VoxelCurves | None
    regional: tuple[FitResult, ...]
    by_voxel: tuple[FitResult, ...]
    regional_choice: tuple[FitResult, ...]
    voxel_choice: tuple[FitResult, ...]
    mid_frame: tuple[str, ...]
    remarks: tuple[Remark, ...]
    partial_volume: PartialVolume | None = None


def fit_scan(
    source: Source, arterial: InputFunction | None, request: FitRequest, resources: Resources, progress: Progress
) -> ScanFit:
    """Fit one scan as asked.

    Args:
        source: the scan.
        arterial: its input function as sampled, or None where no model needs one.
        request: what was asked.
        resources: what it may use.
        progress: told what is being done.

    Raises:
        InputError: something about the scan makes a right answer impossible.
    """
    methods = request.methods
    observation = FrameObservation(
        source.frames,
        decay=source.decay if request.observation == "frame" else 0.0,
        mid_frame=request.observation == "mid",
    )
    progress("reading the image" if source.image is not None else "curves", 0.05)
    voxels, measured, correction = _curves(source, request, resources)
    curves = measured if correction is None or measured is None else correction.corrected(measured)
    check_regions(request, curves)
    whole = whole_brain(voxels, curves)
    weights, how = frame_weights(whole, source, request)
    progress("delay", 0.3)
    smeared = None
    if request.estimate_dispersion and arterial is not None:
        arterial, smeared = freed_input(source, whole, observation, weights, request, curves)
    delay, applied, doubt = shared_delay(whole, arterial, observation, weights, request, curves)
    coarse = coarse_frames(source.frames, delay)
    arrived = None if arterial is None else arterial.delayed(applied[0])
    given = Given(observation, weights, arrived, reference_curve(source, request, curves), source.suv)
    # maps are not corrected, so their reference is not either
    for_voxels = given if correction is None else replace(given, reference=reference_curve(source, request, measured))
    regional: list[FitResult] = []
    by_voxel: list[FitResult] = []
    shifts: list[str] = []
    for i, method in enumerate(methods):
        progress(f"{method.label} by region" if curves is not None else method.label, 0.4 + 0.5 * i / len(methods))
        if curves is not None:
            result = method.fit(curves.values, given, request.choices, False)

            def closer(done: float, i: int = i, step: str = f"{method.label} by region: how sure") -> None:
                progress(step, 0.4 + 0.5 * (i + 0.3 * done) / len(methods))

            result = more_certain(result, method, curves, given, request, closer)
            if request.until is not None:
                result = with_forecast(result, method, curves, given, request.choices, request.until)
            regional.append(_completed(result, applied))
            compared = request.observation == "frame" and method.comparable
            shifts.append(mid_frame_shift(result, method, curves, given, request.choices) if compared else "")
        if voxels is not None:

            def here(done: float, i: int = i, step: str = f"{method.label} by voxel") -> None:
                progress(step, 0.4 + 0.5 * (i + 0.3 + 0.7 * done) / len(methods))

            here(0.0)
            told = regional[-1] if regional else None
            choices = with_t_star(request.choices, method, for_voxels, whole, told)
            by_voxel.append(_completed(fit_voxels(method, voxels, for_voxels, choices, here), applied))
            voxels.plan.release()
    remarks = (
        *dict.fromkeys((*source.remarks, *(measured.remarks if measured is not None else ()))),
        *([smeared] if smeared else []),
        *([warning("delay-unknown", source.label, doubt)] if doubt else []),
        *([warning("delay-coarse", source.label, coarse)] if coarse else []),
        *(correction.remarks if correction is not None else ()),
        *([denoising_remark(source)] if request.hypr is not None else []),
        *_remarks(source, whole, voxels, *zip(methods, regional), *zip(methods, by_voxel)),
    )
    return ScanFit(
        source,
        arterial,
        delay,
        applied,
        weights,
        how,
        curves,
        voxels,
        tuple(regional),
        tuple(by_voxel),
        chosen_model(methods, tuple(regional)),
        chosen_model(methods, tuple(by_voxel)),
        tuple(shifts),
        remarks,
        correction,
    )


def _completed(result: FitResult, applied: tuple[float, float]) -> FitResult:
    """With the delay that its input was given, and what the curves do not tell."""
    remarks = (*result.remarks, *undetermined(result))
    return replace(result, delay=applied[0], delay_se=applied[1], remarks=remarks)


def _curves(
    source: Source, request: FitRequest, resources: Resources
) -> tuple[VoxelCurves | None, RegionalCurves | None, PartialVolume | None]:
    if source.image is None:
        return None, source.curves, None
    regions = read_regions(source.dseg, source.image) if source.dseg is not None else None
    correction = None
    if request.psf is not None and regions is not None:
        correction = partial_volume(regions, source.image, request.psf)
    wanted = regions if correction is None else correction.regions
    if request.level == "region":
        return None, source.curves or extract(source.image, source.frames, wanted), correction
    mask, how = choose_mask(source.image, source.frames, source.mask, regions)
    count = int(np.count_nonzero(mask))
    plan = resources.plan(source.image, count, len(request.models), denoised=request.hypr is not None)
    rows = plan.rows("curves", source.image.count, count)
    wanted = wanted if source.curves is None and request.level != "voxel" else None
    curves = extract(source.image, source.frames, wanted, mask=mask, into=rows)
    if request.level != "voxel":
        curves = source.curves or curves
    voxels = VoxelCurves.summed_up(rows, mask, source.image, how, plan)
    if request.hypr is not None:
        denoise(voxels, source, request.hypr)
    return voxels, curves, correction


def _remarks(
    source: Source, whole: NDArray[np.float64], voxels: VoxelCurves | None, *results: tuple[Method, FitResult]
) -> tuple[Remark, ...]:
    """What only the values tell: a unit that is off, voxels that cannot be used, models without one value."""
    remarks: list[Remark] = []
    if source.image is not None and source.blood is not None:
        remarks += against_tissue(source.blood, whole)
    if voxels is not None:
        remarks += _voxel_remarks(voxels)
    for method, result in results:
        if len(result.status) and not np.isfinite(result[method.outcome]).any():
            text = f"{method.label}: not one curve could be fitted; see the status codes."
            remarks.append(severe("nothing-fitted", source.label, text))
    return tuple(dict.fromkeys(remarks))


def _voxel_remarks(voxels: VoxelCurves) -> list[Remark]:
    remarks, where = [], voxels.series.path.name
    if voxels.not_finite:
        text = f"{voxels.not_finite} voxels in the mask hold NaN or infinite values and were not fitted."
        remarks.append(warning("voxels-not-finite", where, text))
    if voxels.negative > _MANY_NEGATIVE:
        text = f"{voxels.negative:.1%} of all voxel values in the mask are negative; they are fitted as they are."
        remarks.append(warning("voxels-negative", where, text))
    return remarks
