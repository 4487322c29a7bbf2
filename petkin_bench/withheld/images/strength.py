"""How visible a cause is in an image once the simulator is refitted: a matched filter over all voxels.

Voxels are weighed as if each had noise of its own and kinetics that vary about its region's,

    Omega_r = (diag(a^2) + kappa J_r H J_r')^{-1},    w = Omega P delta / m^2,

with P off the kinetics of the regions and of the scalp, delay and whatever else the simulator refits, and as far as
frames jitter off their common factors; d' is the signal of w over its true standard deviation, in which noise is shared
by neighbours, kinetics vary smoothly and frames jitter. Where there is a point spread, edges run within voxels, and no
label tells how: a voxel beside another label may hold any share of another curve, in Omega and in the variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, generate_binary_structure, grey_dilation, grey_erosion

from petkin_bench.withheld.images.head import GRID, LENGTH, NAMES, VARIED, VOXEL
from petkin_bench.withheld.images.taking import FWHM, SHARED, SHARED_MM, Grain, Scanned, spread_out

Array = NDArray[np.float64]

#: Variance of the share of another curve in a voxel that an edge may run through.
_CUT = 1.0 / 12.0
#: Voxels over which kinetics vary together, over those which share noise.
_KAPPA = 4.0
#: What noise that neighbours share does to sums over many voxels, and next to no prior.
_TOGETHER = (1.0 - SHARED) + SHARED * (2.0 * np.sqrt(np.pi) * SHARED_MM / FWHM / VOXEL) ** 3
_FREE = 1e-9
_CROSS = generate_binary_structure(3, 1)


@dataclass(frozen=True)
class Filter:
    """Whitened coordinates of the labelled voxels, and what a refit can do there.

    Args:
        inside: voxels [x, y, z] with a region.
        place: region of each (N,).
        roots: Omega^{1/2} of every region (R, K, K), and then of its border.
        border: whether an edge may run through a voxel (N,).
        strange: what a border voxel of each region may hold instead (R, S, K).
        m: noise of each voxel, relative (N,).
        axes: columns A of what is refitted, with P = I - A A' (N K, p).
        derivatives: by kinetics (R + 1, P, K).
        mean: curve of each region and of the scalp (R + 1, K).
        noise: of the picture.
    """

    inside: NDArray[np.bool_]
    place: NDArray[np.int64]
    roots: Array
    border: NDArray[np.bool_]
    strange: Array
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
        return self._rooted(voxels / self.m[:, None]).ravel()

    def _rooted(self, voxels: Array) -> Array:
        found, kind = np.empty_like(voxels), self.place + len(NAMES) * self.border
        for i, root in enumerate(self.roots):
            mine = kind == i
            found[mine] = voxels[mine] @ root
        return found

    def _variance(self, left: Array) -> float:
        """Of left' (whitened noise)."""
        count = self.roots.shape[-1]
        weights = self._rooted(left.reshape(-1, count))
        grid = np.zeros((GRID, GRID, GRID, count))
        grid[self.inside] = weights * self.noise.a
        total = float((grid * self.noise.mixed(grid)).sum())
        weights /= self.m[:, None]
        by_frame = np.einsum("nk,nk->k", weights, self.mean[self.place])
        total += float(((by_frame * self.noise.jitter) ** 2).sum())
        return total + self._of_kinetics(weights) + self._of_edges(weights)

    def _of_kinetics(self, weights: Array) -> float:
        grid = np.zeros((GRID, GRID, GRID, len(VARIED)))
        grid[self.inside] = np.einsum("nk,npk->np", weights, self.derivatives[self.place])
        sigma = LENGTH / VOXEL
        smooth = (2.0 * np.pi) ** 1.5 * sigma**3 * gaussian_filter(grid, (sigma,) * 3 + (0.0,), mode="constant")
        return float(((grid * smooth).sum(axis=(0, 1, 2)) * np.array(VARIED) ** 2).sum())

    def _of_edges(self, weights: Array) -> float:
        seen = np.einsum("nk,nsk->ns", weights[self.border], self.strange[self.place[self.border]])
        return float((seen**2).sum())


def matched(scanned: Scanned, mean: Array, derivatives: Array, noise: Grain, refitted: Sequence[Array]) -> Filter:
    """The filter of a scan.

    Args:
        scanned: whom.
        mean: curves of the regions and of the scalp (R + 1, K).
        derivatives: of them by their kinetics (R + 1, P, K).
        noise: of the picture.
        refitted: what else the simulator refits, as changes of the image [x, y, z, K].
    """
    labels = scanned.head.labels
    inside = (labels > 0) & (labels <= len(NAMES))
    place = labels[inside] - 1
    m = noise.m[inside]
    varied = _KAPPA * np.array(VARIED)[:, None] ** 2
    border = _beside_others(labels)[inside] & (scanned.width > 0)
    strange = _strange(mean)
    roots = np.empty((2 * len(NAMES), mean.shape[1], mean.shape[1]))
    for r in range(len(NAMES)):
        by, level = derivatives[r], float(np.median(m[place == r]))
        covariance = np.diag(noise.a**2) + (by.T @ (varied * by)) / level**2
        roots[r] = _inverse_root(covariance)
        roots[len(NAMES) + r] = _inverse_root(covariance + strange[r].T @ strange[r] / level**2)
    empty = np.zeros((inside.sum() * mean.shape[1], 0))
    bare = Filter(inside, place, roots, border, strange, m, empty, derivatives, mean, noise)
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


def _beside_others(labels: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Voxels with a neighbour of another label [x, y, z]."""
    return (grey_erosion(labels, footprint=_CROSS) != labels) | (grey_dilation(labels, footprint=_CROSS) != labels)


def _strange(mean: Array) -> Array:
    """What a border voxel of each region may gain for its own curve: another one, or air (R, R + 1, K).

    As large as its standard deviation, any as likely.
    """
    others = [np.vstack([np.delete(mean, r, axis=0), np.zeros((1, mean.shape[1]))]) for r in range(len(NAMES))]
    return np.sqrt(_CUT / len(mean)) * np.stack([other - mean[r] for r, other in enumerate(others)])


def _inverse_root(covariance: Array) -> Array:
    values, vectors = np.linalg.eigh(covariance)
    return (vectors / np.sqrt(values)) @ vectors.T


def _axes(columns: Array, prior: Array) -> Array:
    """A of A A' = C (C'C + diag(prior)^2)^{-1} C'."""
    values, vectors = np.linalg.eigh(columns.T @ columns + np.diag(prior**2))
    kept = values > 1e-12 * values[-1]
    return (columns @ vectors[:, kept]) / np.sqrt(values[kept])
