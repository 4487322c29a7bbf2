"""How visible a cause is in an image once the simulator is refitted: a matched filter over all voxels.

Voxels are weighed as if each had noise of its own and kinetics that vary about its region's,

    Omega_r = (diag(a^2) + kappa J_r H J_r')^{-1},    w = Omega P delta / m^2,

with P off the kinetics of the regions, delay and whatever else the simulator refits, and as far as frames jitter off
their common factors; d' is the signal of w over its true standard deviation, in which noise is shared by neighbours,
kinetics vary smoothly and frames jitter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from petkin_bench.withheld.images.head import GRID, LENGTH, NAMES, VARIED, VOXEL
from petkin_bench.withheld.images.taking import FWHM, SHARED, SHARED_MM, Grain, Scanned, spread_out

Array = NDArray[np.float64]

#: Voxels over which kinetics vary together, over those which share noise.
_KAPPA = 4.0
#: What noise that neighbours share does to sums over many voxels, and next to no prior.
_TOGETHER = (1.0 - SHARED) + SHARED * (2.0 * np.sqrt(np.pi) * SHARED_MM / FWHM / VOXEL) ** 3
_FREE = 1e-9


@dataclass(frozen=True)
class Filter:
    """Whitened coordinates of the labelled voxels, and what a refit can do there.

    Args:
        inside: voxels [x, y, z] with a region.
        place: region of each (N,).
        roots: Omega^{1/2} of every region (R, K, K).
        m: noise of each voxel, relative (N,).
        axes: columns A of what is refitted, with P = I - A A' (N K, p).
        derivatives: by kinetics (R, P, K).
        mean: curve of each region (R, K).
        noise: of the picture.
    """

    inside: NDArray[np.bool_]
    place: NDArray[np.int64]
    roots: Array
    m: Array
    axes: Array
    derivatives: Array
    mean: Array
    noise: Grain

    def left(self, change: Array) -> Array:
        """What the refit leaves of a change of the image [x, y, z, K], whitened and flat."""
        return self._left(self._white(change[self.inside]))

    def detectability(self, change: Array) -> float:
        """d' of a change of the image."""
        flat = self._white(change[self.inside])
        left = self._left(flat)
        return float(left @ flat) / max(float(np.sqrt(self._variance(left))), 1e-300)

    def _left(self, flat: Array) -> Array:
        return flat - self.axes @ (self.axes.T @ flat)

    def _white(self, voxels: Array) -> Array:
        found = voxels / self.m[:, None]
        for r, root in enumerate(self.roots):
            mine = self.place == r
            found[mine] = found[mine] @ root
        return found.ravel()

    def _variance(self, left: Array) -> float:
        """Of left' (whitened noise)."""
        count = self.roots.shape[-1]
        weights = left.reshape(-1, count).copy()
        for r, root in enumerate(self.roots):
            mine = self.place == r
            weights[mine] = weights[mine] @ root
        grid = np.zeros((GRID, GRID, GRID, count))
        grid[self.inside] = weights * self.noise.a
        total = float((grid * self.noise.mixed(grid)).sum())
        weights /= self.m[:, None]
        by_frame = np.einsum("nk,nk->k", weights, self.mean[self.place])
        total += float(((by_frame * self.noise.jitter) ** 2).sum())
        return total + self._of_kinetics(weights)

    def _of_kinetics(self, weights: Array) -> float:
        grid = np.zeros((GRID, GRID, GRID, len(VARIED)))
        grid[self.inside] = np.einsum("nk,npk->np", weights, self.derivatives[self.place])
        sigma = LENGTH / VOXEL
        smooth = (2.0 * np.pi) ** 1.5 * sigma**3 * gaussian_filter(grid, (sigma,) * 3 + (0.0,), mode="constant")
        return float(((grid * smooth).sum(axis=(0, 1, 2)) * np.array(VARIED) ** 2).sum())


def matched(scanned: Scanned, mean: Array, derivatives: Array, noise: Grain, refitted: Sequence[Array]) -> Filter:
    """The filter of a scan.

    Args:
        scanned: whom.
        mean: curves of the regions (R, K).
        derivatives: of them by their kinetics (R, P, K).
        noise: of the picture.
        refitted: what else the simulator refits, as changes of the image [x, y, z, K].
    """
    labels = scanned.head.labels
    inside = (labels > 0) & (labels <= len(NAMES))
    place = labels[inside] - 1
    m = noise.m[inside]
    varied = _KAPPA * np.array(VARIED)[:, None] ** 2
    roots = np.empty((len(NAMES), mean.shape[1], mean.shape[1]))
    for r, by in enumerate(derivatives):
        level = float(np.median(m[place == r]))
        covariance = np.diag(noise.a**2) + (by.T @ (varied * by)) / level**2
        values, vectors = np.linalg.eigh(covariance)
        roots[r] = (vectors / np.sqrt(values)) @ vectors.T
    empty = np.zeros((inside.sum() * mean.shape[1], 0))
    bare = Filter(inside, place, roots, m, empty, derivatives, mean, noise)
    columns = [bare.left(change) for change in refitted]
    for r, by in enumerate(derivatives):
        share = spread_out((labels == r + 1)[..., None].astype(float), scanned.width)
        columns += [bare.left(share * row) for row in by]
    free = len(columns)
    for k, jitter in enumerate(noise.jitter):
        change = np.zeros((*labels.shape, mean.shape[1]))
        change[inside, k] = jitter * mean[place, k]
        columns.append(bare.left(change))
    stacked = np.stack(columns, axis=1)
    scale = np.linalg.norm(stacked, axis=0)
    there = scale > 1e-6 * scale.max()
    prior = np.where(np.arange(scale.size) < free, _FREE, np.sqrt(_TOGETHER) / np.maximum(scale, 1e-12))
    return replace(bare, axes=_axes(stacked[:, there] / scale[there], prior[there]))


def _axes(columns: Array, prior: Array) -> Array:
    """A of A A' = C (C'C + diag(prior)^2)^{-1} C'."""
    values, vectors = np.linalg.eigh(columns.T @ columns + np.diag(prior**2))
    kept = values > 1e-12 * values[-1]
    return (columns @ vectors[:, kept]) / np.sqrt(values[kept])
