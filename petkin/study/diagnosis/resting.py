"""The picture behind regional curves, and as it would be had it not moved far.

What moves far is no slope of the picture any more, and a picture of all frames is one of both places. So the motion is
found first, by laying what labels and fits predict onto every frame; the file is read again with each frame laid back;
regions are fitted as they are then; and so on, each time with what the last one told.
"""

from __future__ import annotations

from dataclasses import replace

from petkin.diagnosis import Fit, base_fit
from petkin.io import read_regions
from petkin.study.diagnosis.drawing import drawn_of
from petkin.study.diagnosis.gone import Gone
from petkin.study.diagnosis.picture import Picture, Voxels, read_picture
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.registration import registered
from petkin.study.diagnosis.standing import bare
from petkin.study.sources import Source

#: How often the image is read again, where the way found is not that of the last time.
_ROUNDS = 3


def picture_of(source: Source, simulator: RegionalSimulator, fit: Fit, gone: Gone | None = None) -> Picture:
    """The image behind a scan's regional curves.

    Args:
        source: the scan, segmented.
        simulator: what predicts the means over the regions of its segmentation.
        fit: of the simulator to them.
        gone: a way that is undone first, where the picture is wanted as it would be at rest.
    """
    assert source.segmented is not None
    image, dseg = source.segmented
    return read_picture(image, read_regions(dseg, image), simulator, fit, gone)


def at_rest(source: Source, voxels: Voxels, simulator: RegionalSimulator) -> Voxels | None:
    """The picture as it would be at rest, of voxels with the curves that were recorded; None where it has not gone far.

    Args:
        source: the scan.
        voxels: of its segmentation, as they are.
        simulator: what predicts the means over its regions.
    """
    alone, gone = bare(simulator), None
    still = recorded = voxels
    for _ in range(_ROUNDS):
        found = registered(recorded, drawn_of(still), simulator.clock)
        if found is None or found.is_that(gone):
            break
        picture, gone = picture_of(source, alone, still.fit, found), found
        fit, *_ = base_fit(alone, Voxels.of(picture, alone, still.fit).means)
        still = Voxels.of(picture, alone, fit)
        recorded = Voxels.of(_recorded(picture, voxels.picture), alone, fit)
    return None if gone is None else replace(recorded, gone=gone)


def _recorded(laid: Picture, picture: Picture) -> Picture:
    """A picture at rest with the curves of its voxels as they were recorded, and their noise: what is laid between
    voxels has less."""
    return replace(laid, curves=picture.curves, grain=picture.grain)
