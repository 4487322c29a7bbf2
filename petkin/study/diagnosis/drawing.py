"""The picture as labels, the regions' curves and a point spread have it, and the contrast that tells its width."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import Pattern
from petkin.imaging import blur
from petkin.study.diagnosis.picture import Voxels
from petkin.study.diagnosis.variation import Weighed

Array = NDArray[np.float64]

#: FWHM tried, mm, and the one whose picture weighs the voxels.
_WIDTHS, _TYPICAL = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 14.0), 6.0
#: Rounds in which the sharp image is found.
_SHARPENED = 8


@dataclass(frozen=True)
class Predicted:
    """The predicted image: maps [x, y, z, M] that follow courses (M, K), each region at its predicted curve."""

    voxels: Voxels
    maps: Array

    @classmethod
    def of(cls, voxels: Voxels) -> Predicted:
        picture = voxels.picture
        levels = voxels.fit.values @ picture.courses.T
        maps = np.empty((*picture.inside.shape, levels.shape[1]))
        maps[...] = picture.outside * levels[picture.place].mean(axis=0)
        maps[picture.inside] = levels[picture.place]
        return cls(voxels, maps)

    def seen(self, width: float) -> Array:
        """The image through a point spread, as sharp before it as its regions' means demand (x, y, z, M).

        Reference: van Cittert PH. Z Phys 1931;69:298-308 (repeated re-blurring).
        """
        inside, wanted, size = self.voxels.inside, self._means(self.maps), self.voxels.picture.size
        sharp = self.maps.copy()
        for _ in range(_SHARPENED):
            short = wanted - self._means(_through(sharp, width, size))
            sharp[inside] += short[self.voxels.place]
        return _through(sharp, width, size)

    def _means(self, maps: Array) -> Array:
        """Means over the regions (R, M)."""
        return self.voxels.mean_over(maps[self.voxels.inside])

    def blurred(self) -> tuple[Weighed, list[Pattern]]:
        """One contrast for the point spread, with a pattern a width.

        It is there in every frame, as kinetics that vary are: how far they do is told by decoys of this very contrast,
        which are as fine as it is.
        """
        voxels, courses = self.voxels, self.voxels.picture.courses
        weights = voxels.centred(self.seen(_TYPICAL)[voxels.inside] @ courses.mean(axis=1))
        patterns = []
        for width in _WIDTHS:
            row = voxels.framed(weights, self.seen(width)[voxels.inside], courses)
            patterns.append(Pattern("partial_volume", "blur", row, {}, scale=width, signed=False))
        return Weighed(weights, voxels.picture.grain.between(weights)), patterns

    def width(self, contrast: Array, patterns: list[Pattern]) -> float:
        """The FWHM at which the predicted contrast is as large as the image's, mm."""
        typical = patterns[_WIDTHS.index(_TYPICAL)].rows
        sizes = np.maximum.accumulate([0.0, *(float((typical * p.rows).sum()) for p in patterns)])
        return float(np.interp(float((typical * contrast).sum()), sizes, [0.0, *_WIDTHS]))


def drawn_of(voxels: Voxels) -> Array:
    """The picture as labels, the regions' fits and the point spread that it looks most like have it [x, y, z, M]."""
    predicted, total = Predicted.of(voxels), voxels.total(voxels.seen)
    drawn = (predicted.seen(width) for width in _WIDTHS)
    return min(drawn, key=lambda maps: float(((voxels.total(maps[voxels.inside]) - total) ** 2).sum()))


def _through(maps: Array, width: float, size: tuple[float, ...]) -> Array:
    return np.asarray(blur(maps, width, size), np.float64)
