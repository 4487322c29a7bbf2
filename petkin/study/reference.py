"""The reference region of a scan: regions by name, or the voxels of a mask."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from petkin.errors import InputError
from petkin.fitting import Need, ReferenceCurve
from petkin.io import RegionalCurves, Regions, read_label_volume, read_regions, require_same_grid
from petkin.study.request import FitRequest
from petkin.study.series import extract
from petkin.study.sources import Source


def reference_curve(source: Source, request: FitRequest, curves: RegionalCurves | None) -> ReferenceCurve | None:
    """The curve that the request names, or None where no model needs one.

    Args:
        source: the scan.
        request: what was asked.
        curves: regional curves that are fitted, or None.

    Raises:
        InputError: no such region, a mask without voxels or on another grid, or a curve without activity.
    """
    if not request.needs(Need.REFERENCE):
        return None
    if request.reference_mask is not None:
        found = _of_mask(request.reference_mask, source)
    else:
        found = _of_regions(request.reference, curves or _all_regions(source))
    if not (np.isfinite(found.values).all() and found.values.sum() > 0):
        raise InputError(
            f"{source.label}: the reference region {found.name} holds no activity, or values that are not numbers; "
            "name another."
        )
    return found


def _of_regions(names: tuple[str, ...], curves: RegionalCurves) -> ReferenceCurve:
    """Mean of the named regions, by volume where all volumes are known."""
    rows = [_row(name, curves) for name in names]
    volumes = np.ones(len(rows)) if curves.volumes is None else curves.volumes[rows]
    weights = volumes if np.isfinite(volumes).all() else np.ones(len(rows))
    label = " + ".join(curves.names[row] for row in rows)
    return ReferenceCurve(label, np.average(curves.values[rows], axis=0, weights=weights))


def _row(name: str, curves: RegionalCurves) -> int:
    """Place of a region: by its name as it stands, else in any case of letters."""
    exact = [i for i, region in enumerate(curves.names) if region == name]
    alike = exact or [i for i, region in enumerate(curves.names) if region.lower() == name.lower()]
    if len(alike) != 1:
        near = [region for region in curves.names if name.lower() in region.lower()] or list(curves.names)
        more = f" and {len(near) - 12} more" if len(near) > 12 else ""
        found = "several regions are called" if alike else "no region is called"
        raise InputError(f"{curves.where}: {found} {name!r}; --reference can be {', '.join(near[:12])}{more}.")
    return alike[0]


def _all_regions(source: Source) -> RegionalCurves:
    """Curves of a segmentation whose regions are not fitted themselves."""
    if source.image is None or source.dseg is None:
        raise InputError(
            f"{source.label}: --reference names a region, and there is neither a segmentation nor a table of curves: "
            "give --dseg or --tacs, or --reference-mask."
        )
    curves = extract(source.image, source.frames, read_regions(source.dseg, source.image))
    assert curves is not None
    return curves


def _of_mask(mask: Path, source: Source) -> ReferenceCurve:
    if source.image is None:
        raise InputError(f"{source.label}: --reference-mask lies on an image and there is none; give --reference NAME.")
    labels, affine = read_label_volume(mask)
    require_same_grid(labels.shape, affine, source.image, what=mask.name)
    inside = (labels > 0).astype(np.int32)
    if not inside.any():
        raise InputError(f"{mask.name}: the reference mask holds no voxel.")
    region = Regions(inside, (1,), (mask.name,), np.array([np.nan]), "", "", mask.name)
    curves = extract(source.image, source.frames, region)
    assert curves is not None
    return ReferenceCurve(mask.name, curves.values[0])
