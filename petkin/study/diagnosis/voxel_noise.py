"""Noise of an image: how it changes over the frames, and how far neighbouring voxels share it.

A region has few frames but many voxels, so that what its own curve tells of noise only roughly its voxels tell well:

    r_v(k) = (x_v(k) - what mixtures of a few courses make of it) / s_r(k) = h(k) e_v(k),
    cov(e_v, e_u) = C(v - u)

h is the median size of the frame's residuals, as far as those scatter with the counts of their region, times that of
the region's beside the others', C the mean of products of all pairs of voxels at one distance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from petkin.diagnosis import second_differences

Array = NDArray[np.float64]

#: Neighbours share noise over no more than this along an axis, mm; next to none as far as that across axes.
_FURTHEST_MM = 25.0
#: No more than this share of a frame counts as taken by the courses; no frame or region is quieter than that share.
_TAKEN, _QUIET = 0.8, 0.05
#: From this share of voxels at nought on a frame is empty; the median of absolute normal values.
_EMPTY, _OF_NORMAL = 0.05, 0.6745
#: Voxels that scatter as one, and how far noise usually keeps from the law of a region's own counts.
_TOGETHER, _USUAL_LAW = 10.0, 0.5
#: How far a region's noise usually keeps from the others', in logarithms: set beforehand, not by how scans are judged.
_USUAL_REGION = 0.2
#: Variance of the logarithm of the median of n absolute normal values, times n: (2 z f(z))^-2, z their median, f
#: their density (Serfling RJ. Approximation Theorems of Mathematical Statistics. 1980, section 2.3.3).
_OF_MEDIAN = 1.36
#: Frames that tell how far voxels share noise: each has all pairs of neighbours.
_ENOUGH = 12
#: Edges of a grid whose transform is quick are multiples of this.
_EASY = 8


@dataclass(frozen=True)
class VoxelNoise:
    """Noise of the voxels of a segmentation, in units of their region's spread.

    Args:
        by_frame: h (R, K), 1 in the median frame of a region like the others, or about that where voxels do not scatter
            by their region's counts.
        shared: C, sampled at whole voxels (lags), the middle at no distance.
        labels: region of every voxel in a box around them, from 1, 0 outside.
    """

    by_frame: Array
    shared: Array
    labels: NDArray[np.intp]

    def sizes(self, weights: Array) -> Array:
        """Standard deviation of sum_v w_v e_v over each region (R,), of weights of the labelled voxels (N,)."""
        grid = np.zeros(self.labels.shape)
        grid[self.labels > 0] = weights
        boxes = find_objects(self.labels)
        found = [self._variance(np.where(self.labels[box] == r + 1, grid[box], 0.0)) for r, box in enumerate(boxes)]
        return np.sqrt(np.maximum(found, 0.0))

    def between(self, weights: Array) -> Array:
        """Covariance of sum_v w_v e_v between all regions, of weights (F, N), or (N,): (F R, F R), regions within each.

        Voxels on either side of a border share noise too.
        """
        grids: Array = np.zeros((len(np.atleast_2d(weights)), *self.labels.shape))
        grids[:, self.labels > 0] = weights
        boxes = find_objects(self.labels)
        found = np.zeros((len(grids), len(boxes), len(grids), len(boxes)))
        for r, box in enumerate(boxes):
            wide = tuple(slice(max(b.start - n // 2, 0), b.stop + n // 2) for b, n in zip(box, self.shared.shape))
            labels, own = self.labels[wide], self.labels[wide] == r + 1
            near, spread = grids[:, *wide], _spreading(own.shape, self.shared)
            for f, grid in enumerate(near):
                reached = spread(np.where(own, grid, 0.0))
                for g, other in enumerate(near):
                    found[f, r, g] = np.bincount(labels.ravel(), (other * reached).ravel(), len(boxes) + 1)[1:]
        flat = found.reshape(len(grids) * len(boxes), -1)
        return 0.5 * (flat + flat.T)

    def covariances(self, weights: Array) -> list[Array]:
        """Covariance of sum_v w_v e_v of several weights (F, N) of the labelled voxels, in every region (F, F)."""
        index = np.cumsum(self.labels.ravel() > 0).reshape(self.labels.shape) - 1
        found = []
        for r, box in enumerate(find_objects(self.labels)):
            mine = self.labels[box] == r + 1
            own = np.zeros((len(weights), *mine.shape))
            own[:, mine] = weights[:, index[box][mine]]
            flat = own.reshape(len(own), -1)
            spread = _spreading(mine.shape, self.shared)
            covariance = np.stack([flat @ spread(own[f]).ravel() for f in range(len(own))])
            found.append(0.5 * (covariance + covariance.T))
        return found

    def of_means(self) -> Array:
        """Relative standard deviation of the mean over each region (R, K), of what its voxels do not share with all."""
        place = self.labels[self.labels > 0] - 1
        return _relative(self.sizes(1.0 / np.bincount(place)[place]), np.max)[:, None] * self.by_frame

    def _variance(self, weights: Array) -> float:
        """sum_d C(d) sum_v w_v w_(v + d)."""
        return float((self.shared * _products(weights, self.shared.shape)).sum())


def voxel_noise(
    curves: NDArray[np.floating], labels: NDArray[np.intp], spread: Array, courses: Array, size: Array
) -> VoxelNoise:
    """Noise by frame and distance.

    Args:
        curves: of the labelled voxels (N, K), in C order.
        labels: region of every voxel in a box, from 1, 0 outside [x, y, z].
        spread: s of every region (R, K).
        courses: what regions' curves are mixtures of (M, K).
        size: voxel edges, mm (3,).
    """
    place = labels[labels > 0] - 1
    left = np.empty(curves.shape, np.float32)
    residual = np.empty((*spread.shape, spread.shape[1]), np.float32)
    for r, s in enumerate(spread):
        mine = place == r
        axes = np.linalg.qr((courses / s).T)[0].astype(np.float32)
        scaled = (curves[mine] / s).astype(np.float32)
        scaled -= (scaled @ axes) @ axes.T
        residual[r] = np.eye(len(axes)) - axes @ axes.T
        left[mine] = scaled - scaled.mean(axis=0)
    kept = np.sqrt(np.maximum(np.diagonal(residual, axis1=1, axis2=2), 1.0 - _TAKEN))
    even = _evened(left / kept[place], place, spread)
    left /= even.astype(np.float32)[place]
    by_frame = even * _relative(_by_frame(left / kept[place], curves), np.median)
    left /= (by_frame / even).astype(np.float32)[place]
    bends: NDArray[np.floating] = second_differences(left)  # type: ignore[arg-type]
    bends /= _bent(residual, by_frame).astype(np.float32)[place]
    noise = VoxelNoise(by_frame, _shared(bends, labels, size), labels)
    return replace(noise, by_frame=by_frame * _by_region(left / kept[place], place, noise)[:, None])


def _by_frame(left: NDArray[np.floating], curves: NDArray[np.floating]) -> Array:
    """Usual size of the voxels' residuals in every frame (K,): the median, which edges that have moved hardly change;
    the root mean square where many voxels have counted nothing, as the median then says how large nothing is."""
    found = np.median(np.abs(left), axis=0).astype(np.float64)
    empty = (curves == 0).mean(axis=0) > _EMPTY
    found[empty] = _OF_NORMAL * np.sqrt((left[:, empty].astype(np.float64) ** 2).mean(axis=0))
    return found


def _bent(residual: NDArray[np.floating], by_frame: Array) -> Array:
    """Size of second differences of unit noise that has lost what the courses took (R, K - 2).

    Most of that is smooth in time, and differences would not have had it.

    Args:
        residual: what the courses leave of values in units of the region's spread (R, K, K).
        by_frame: h (R, K).
    """
    each = by_frame[:, None, :] * residual / by_frame[:, :, None]
    covariance = each @ each.swapaxes(-1, -2)
    bend = np.diff(np.eye(by_frame.shape[1]), n=2, axis=0) / np.sqrt(6.0)
    return np.sqrt(np.maximum(np.diagonal(bend @ covariance @ bend.T, axis1=1, axis2=2), 1.0 - _TAKEN))


def _evened(left: NDArray[np.floating], place: NDArray[np.intp], spread: Array) -> Array:
    """Factor of the spread (R, K), as far as voxels scatter less, or more, by their own region's counts than counts do.

    log |r_v(k)| = a_k + b_r - g u_r(k),   u = log s less its means over regions and over frames,   -1 <= g <= 1

    With g = 1 they scatter by the counts of all regions, with g = -1 by a percentage of their own.
    """
    sizes = np.stack([np.median(np.abs(left[place == r]), axis=0) for r in range(len(spread))]).astype(np.float64)
    if not (sizes > 0).all():
        return np.ones_like(spread)
    weight = np.bincount(place)[:, None] / _TOGETHER
    own, seen = (_interaction(np.log(values), weight) for values in (spread, sizes))
    told = -float((weight * own * seen).sum()) / (float((weight * own**2).sum()) + _USUAL_LAW**-2.0)
    return np.exp(-np.clip(told, -1.0, 1.0) * own)


def _by_region(left: NDArray[np.floating], place: NDArray[np.intp], noise: VoxelNoise) -> Array:
    """Size of each region's noise beside the others' (R,): what lies deep in the head or is reconstructed otherwise.

        log b_r = (t_r - mean of t) / (1 + v_r / 0.2^2),   t_r = log median |e_v(k)| - log(1 - m_r) / 2

    m the share of variance that residuals have lost with their region's mean, v the variance of t.
    """
    number = np.bincount(place)
    alone = float(noise.shared[tuple(n // 2 for n in noise.shared.shape)])
    sizes = np.array([np.median(np.abs(left[place == r])) for r in range(len(number))], np.float64)
    if not (sizes > 0).all() or alone <= 0:
        return np.ones(len(number))
    alike = noise.shared / alone
    lost, as_one = (replace(noise, shared=c).sizes(1.0 / number[place]) ** 2 for c in (alike, alike**2))
    told = np.log(sizes) - 0.5 * np.log(np.maximum(1.0 - lost, 1.0 - _TAKEN))
    weight = left.shape[1] / np.maximum(as_one, 1.0 / number)  # squares of two voxels go together as c^2
    return np.exp((told - np.average(told, weights=weight)) / (1.0 + _OF_MEDIAN / _USUAL_REGION**2 / weight))


def _interaction(values: Array, weight: Array) -> Array:
    """Values (R, K) less their weighted means over regions and over frames."""
    apart = values - (weight * values).sum(axis=0) / weight.sum()
    return np.asarray(apart - apart.mean(axis=1, keepdims=True), np.float64)


def _relative(sizes: Array, usual: Callable[[Array], float]) -> Array:
    """Sizes over the usual one, none of them next to nothing; ones where there is no noise."""
    level = float(usual(sizes))
    return np.maximum(sizes / level, _QUIET) if level > 0 else np.ones_like(sizes)


def _shared(noise: NDArray[np.floating], labels: NDArray[np.intp], size: Array) -> Array:
    """C of noise (N, K) less the mean over each region, on whole voxels.

    Pairs within a region of n voxels have lost b / n with its mean. At the far end noise is no longer shared: what
    products are below zero there tells b.
    """
    inside = labels > 0
    lags = tuple(2 * min(int(_FURTHEST_MM / edge), n - 1) + 1 for edge, n in zip(size, labels.shape, strict=True))
    frames = np.unique(np.linspace(0, noise.shape[1] - 1, _ENOUGH).round().astype(int))
    total, grid = np.zeros(lags), np.zeros(labels.shape, np.float32)
    for k in frames:
        grid[inside] = noise[:, k]
        total += _products(grid, lags)
    pairs = len(frames) * _products(inside.astype(np.float64), lags)
    found = np.where(pairs > 0.5, total / np.maximum(pairs, 1.0), 0.0)
    lost = len(frames) * _within(labels, lags) / np.maximum(pairs, 1.0)
    weight = np.where(_distances(lags, size) > _FURTHEST_MM, pairs * lost, 0.0)
    taken = max(-float((weight * found).sum()) / max(float((weight * lost).sum()), 1e-300), 0.0)
    return np.where(pairs > 0.5, found + taken * lost, 0.0)


def _within(labels: NDArray[np.intp], lags: tuple[int, ...]) -> Array:
    """Pairs of voxels of one region at every distance, over the voxels of that region, of all regions together."""
    masks = [(labels[box] == r + 1).astype(np.float64) for r, box in enumerate(find_objects(labels))]
    return np.sum([_products(mask, lags) / max(mask.sum(), 1.0) for mask in masks], axis=0)


def _distances(lags: tuple[int, ...], size: Array) -> Array:
    """mm of every distance of so many lags, the middle at none."""
    steps = [(np.arange(lag) - lag // 2) * edge for lag, edge in zip(lags, size, strict=True)]
    return np.sqrt(sum(each**2 for each in np.meshgrid(*steps, indexing="ij")))


def _spreading(size: tuple[int, ...], shared: Array) -> Callable[[Array], Array]:
    """Of grids of such a size, sum_d C(d) g_(v + d)."""
    axes = (0, 1, 2)
    shape = [-(-(n + lag - 1) // _EASY) * _EASY for n, lag in zip(size, shared.shape, strict=True)]
    kernel = np.pad(shared, [(0, n - lag) for n, lag in zip(shape, shared.shape, strict=True)])
    spectrum = np.fft.rfftn(np.roll(kernel, [-(lag // 2) for lag in shared.shape], axes))

    def spread(grid: Array) -> Array:
        found = np.fft.irfftn(np.fft.rfftn(grid, shape, axes) * spectrum, shape, axes)
        return np.asarray(found[: size[0], : size[1], : size[2]], np.float64)

    return spread


def _products(grid: NDArray[np.floating], lags: tuple[int, ...]) -> Array:
    """sum_v g_v g_(v + d) for every distance d of so many lags, the middle at none."""
    shape = [-(-max(n + lag // 2, lag) // _EASY) * _EASY for n, lag in zip(grid.shape, lags, strict=True)]
    axes = (0, 1, 2)
    spectrum = np.abs(np.fft.rfftn(grid, shape, axes)) ** 2
    found = np.fft.fftshift(np.fft.irfftn(spectrum, shape, axes))
    return found[tuple(slice(n // 2 - lag // 2, n // 2 + lag // 2 + 1) for n, lag in zip(shape, lags, strict=True))]
