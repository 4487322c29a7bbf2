"""What may be done about noise and resolution before curves are fitted: HYPR-LR for voxels, GTM for regions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from petkin.imaging import (
    FrameObservation,
    TransferMatrix,
    background_rim,
    composite_image,
    hypr_lr,
    transfer_matrix,
)
from petkin.io import RegionalCurves, Regions, Remark, Series, names
from petkin.io.remarks import warning
from petkin.study.request import FitRequest
from petkin.study.series import VoxelCurves
from petkin.study.sources import Source

#: Noise that a correction multiplies by more than this is worth a remark.
_MUCH_NOISE = 3.0
_TOO_SURE = (
    "Voxels that HYPR-LR has denoised share noise with their neighbours and, through the composite, over all frames; "
    "the scatter of a curve does not show that: their standard errors are too small, the more so the wider the kernel, "
    "and chi-square and AICc compare models of the same denoised image only."
)


def denoise(voxels: VoxelCurves, source: Source, fwhm: float) -> None:
    """Denoise the curves of a scan's voxels by HYPR-LR, in place; their memory plan counts what that holds.

    The mean curve, from which weights and delay come, stays that of the image.

    Args:
        voxels: all voxels of the mask: the kernel sees no others.
        source: the scan.
        fwhm: of the kernel, mm.
    """
    rows, inside = voxels.rows, voxels.mask.ravel(order="F")
    counted = FrameObservation(source.frames, decay=source.decay).mean_decay_times_duration
    composite = composite_image((voxels.volume(row, 0.0) for row in rows.array), counted).astype(np.float32)
    frames = (voxels.volume(row, 0.0) for row in rows.array)
    size = tuple(voxels.series.voxel_mm)
    clean = hypr_lr(frames, composite, voxels.mask, fwhm=fwhm, voxel_size=size)
    for row, frame in zip(rows.array, clean, strict=True):
        row[:] = frame.ravel(order="F")[inside]
        rows.release()


def denoising_remark(source: Source) -> Remark:
    """That the standard errors of denoised voxels do not hold."""
    return warning("hypr-errors", source.label, _TOO_SURE)


def denoising_fields(fwhm: float) -> dict[str, Any]:
    """What the sidecar of a map says about its denoising."""
    return {
        "Denoising": {
            "Method": "HYPR-LR (doi:10.2967/jnumed.109.073999)",
            "KernelFWHM": fwhm,
            "KernelFWHMUnits": "mm",
            "Composite": "all frames, weighted by int e^(-lambda t) dt over the frame",
            "Limits": _TOO_SURE,
        }
    }


def geometry_methods(correction: PartialVolume | None, request: FitRequest) -> list[str]:
    """What a report says about denoising and correction; nothing where there was none."""
    sentences = []
    if request.hypr is not None:
        sentences.append(
            f"Voxels were denoised by HYPR-LR with a Gaussian kernel of {request.hypr:g} mm FWHM inside the mask; "
            "regional curves were not (Christian BT et al. J Nucl Med 2010;51:1147-1154, "
            "doi:10.2967/jnumed.109.073999)."
        )
    if correction is not None:
        sentences.append(
            f"Regional curves were corrected for partial volume by the geometric transfer matrix of a Gaussian point "
            f"spread of {correction.fwhm:g} mm FWHM, the background as a region of its own; condition number "
            f"{correction.matrix.condition:.3g}, noise multiplied by up to {correction.matrix.noise_factor.max():.3g} "
            "(Rousset OG et al. J Nucl Med 1998;39:904-911)."
        )
    return sentences


@dataclass(frozen=True)
class PartialVolume:
    """Correction of the regional curves of one scan by the geometric transfer matrix.

    Args:
        regions: the segmentation, with its background as the last region where there is one.
        matrix: what each region receives from which.
        fwhm: of the point spread, mm.
        background: whether there is a background.
    """

    regions: Regions
    matrix: TransferMatrix
    fwhm: float
    background: bool

    def corrected(self, curves: RegionalCurves) -> RegionalCurves:
        """Curves of the segmentation's own regions, from those of all of `regions`.

        Raises:
            InputError: regions that the point spread does not let tell apart, or one without values.
        """
        own = slice(0, len(curves.names) - self.background)
        values = self.matrix.corrected(curves.values)[own]
        volumes = None if curves.volumes is None else curves.volumes[own]
        index = None if curves.index is None else curves.index[own]
        return replace(
            curves, names=curves.names[own], values=values, volumes=volumes, index=index, pvc=names.TRANSFER_MATRIX
        )

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """That noise is much amplified, if it is."""
        factor = self.matrix.noise_factor
        many = int(np.count_nonzero(factor > _MUCH_NOISE))
        if not many:
            return ()
        worst = int(np.argmax(factor))
        text = (
            f"The correction for partial volume multiplies the noise of {many} of {len(factor)} regions by more than "
            f"{_MUCH_NOISE:g} ({self.matrix.names[worst]}: {factor[worst]:.3g}); larger regions lose less."
        )
        return (warning("pvc-noise", self.regions.where, text),)

    @property
    def fields(self) -> dict[str, Any]:
        """What the sidecar of regional curves and parameters says about their correction."""
        factor = dict(zip(self.matrix.names, self.matrix.noise_factor, strict=True))
        return {
            "PartialVolumeCorrection": {
                "Method": "GTM (Rousset et al. 1998, J Nucl Med 39:904-911)",
                "PointSpreadFWHM": self.fwhm,
                "PointSpreadFWHMUnits": "mm",
                "Background": "unlabelled voxels within about one FWHM of a label, as a region of its own",
                "ConditionNumber": float(f"{self.matrix.condition:.6g}"),
                "NoiseFactor": {name: float(f"{value:.6g}") for name, value in factor.items()},
            }
        }


def partial_volume(regions: Regions, series: Series, fwhm: float) -> PartialVolume:
    """The correction of a segmentation on a series.

    Args:
        regions: the segmentation.
        series: the image that it lies on.
        fwhm: of the point spread, mm.
    """
    size = tuple(series.voxel_mm)
    rim = background_rim(regions.labels, fwhm, size)
    background = max(regions.index) + 1 if rim.any() else None
    if background is not None:
        regions = replace(
            regions,
            labels=np.where(rim, np.int32(background), regions.labels),
            index=(*regions.index, background),
            names=(*regions.names, "background"),
            volumes=np.append(regions.volumes, rim.sum() * np.prod(size)),
        )
    named = dict(zip(regions.index, regions.names, strict=True))
    matrix = transfer_matrix(regions.labels, named, background=background, fwhm=fwhm, voxel_size=size)
    return PartialVolume(regions, matrix, fwhm, background is not None)
