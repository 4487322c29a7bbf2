"""Gains of no name: smooth fields over the head, planes that alternate, and rings, each with any smooth course in time.

    x_v(k) -> x_v(k) (1 + sum_b b_v g_b(k)),   b_v = cos(pi i u_1) cos(pi j u_2) cos(pi l u_3) or (-1)^(plane of v)

u is the place in the box around the labels, from 0 to 1. A part of the head, as a block of detectors sees it, is a
window along one axis:

    b_v = (1 + cos(pi (u_i - c) / h)) / 2 within h of c, else 0

Waves and windows lie along the axes of the grid and, as detectors stand in rings about the third, along the diagonals
across that and along the distance from it.

The weights of contrasts are the waves times the picture as it is drawn, which shares no noise with the frames, centred
within every region, and turned there so that they share none; they look beside that picture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import Departure, Family
from petkin.study.diagnosis.joint import added, beside, there
from petkin.study.diagnosis.picture import Voxels

Array = NDArray[np.float64]

#: Half waves along one axis; along so many at once, up to how many along each.
_ALONG, _ACROSS = 6, ((2, 3), (3, 2))
#: Waves fade by this power of their number, as rougher fields are less likely; planes are as rough as that.
_FADING, _PLANES = 0.5, 0.5
#: Halves of windows along one axis, in widths of the box; from one to the next it is half of that.
_WINDOWS = (0.5, 0.25, 0.125)
#: Regions looked at, the largest ones: what all of them may hold besides takes time as their cube.
_REGIONS = 20
#: Directions with less of the noise than this share of the largest are left out; sizes below this share of the mean
#: one are not believed.
_LEAST, _FLOOR = 1e-2, 0.3
#: How many times the likeliest share of mixtures of the regions' curves they hold, which differs between fields: of 52
#: training images of noise 2 had a gap of no name with 1.6, and none with this.
_TIMES = 4.0
#: A window that contrasts show less of than this share of the field they show most of (squares) is not looked for.
_HARDLY = 1e-6


#: Maps that a named effect adds to the voxels by its amplitude, and by its square, each (N, M).
Maps = tuple[Sequence[Array], Sequence[Array]]


#: What contrasts of some regions (R,) may hold besides, by weights (F, N): columns (n, F R, K).
Held = Callable[[Array, NDArray[np.intp]], Array]


@dataclass(frozen=True)
class View:
    """What the contrasts of one family of fields see, whatever they may hold besides.

    Args:
        voxels: of a segmentation.
        weights: (F, N).
        regions: of these regions (R,).
        every: what unit gains add to contrasts (F, F R, K).
        parts: the same of windows (n, F R, K).
        known: what effects that have a name add, by their amplitude and by its square.
    """

    voxels: Voxels
    weights: Array
    regions: NDArray[np.intp]
    every: Array
    parts: Array
    known: Mapping[str, tuple[Array, Array]]

    @property
    def rows(self) -> Array:
        """Contrasts (F R, K)."""
        return beside(self.voxels, self.weights, self.regions)

    def departure(self, held: Sequence[Held], times: Array, least: float) -> Departure:
        """Where these contrasts may depart.

        Args:
            held: what they may hold besides: of kinetics that vary within regions, of effects that are included.
            times: of the frames (K,), min.
            least: smallest standard deviation that noise may have.
        """
        rows, nuisance = self.rows, np.concatenate([each(self.weights, self.regions) for each in held])
        bare = Family.of(rows, nuisance, np.eye(len(rows)), least)
        family = bare.holding(there(self.voxels, self.weights, self.regions), times=_TIMES)
        return Departure(family, self.every, np.maximum(times, 0.0), self.parts, self.known)


def views_of(voxels: Voxels, named: Mapping[str, Maps], *, least: float) -> list[View]:
    """Views of such gains: along every axis, and across several.

    Args:
        voxels: of a segmentation.
        named: what effects that have a name add.
        least: smallest standard deviation that noise may have.
    """
    bright, regions = voxels.total(voxels.expectation), _largest(voxels)
    found = []
    for fields, windows in _fields(voxels):
        weights = _apart(voxels, np.stack([voxels.centred(field * bright) for field in fields]), least)
        every, parts = (
            added(voxels, weights, regions, (field[:, None] * voxels.seen for field in each))
            for each in (fields, windows)
        )
        shown, most = ((rows**2).sum(axis=(1, 2)) for rows in (parts, every))
        parts = parts[shown > _HARDLY * most.max()]
        known = {
            name: (added(voxels, weights, regions, a), added(voxels, weights, regions, b))
            for name, (a, b) in named.items()
        }
        found.append(View(voxels, weights, regions, every, parts, known))
    return found


def fields_of(voxels: Voxels) -> Iterator[Array]:
    """The fields of all families (N,), some at a time."""
    for fields, _ in _fields(voxels):
        yield from fields


def _fields(voxels: Voxels) -> Iterator[tuple[Array, Iterable[Array]]]:
    """Fields by family (F, N), and windows along its axis, each (N,)."""
    at = np.stack(np.nonzero(voxels.inside))
    axes = [axis for axis in range(len(at)) if np.ptp(at[axis]) > 0]
    for axis in axes:
        u = _within(at[axis])
        yield np.stack([*_waves(u), _PLANES * (-1.0) ** at[axis]]), _windows(u)
    for u in map(_within, _in_the_ring(voxels, at)):
        yield np.stack(_waves(u)), _windows(u)
    waves = np.stack([np.cos(np.pi * i * _within(at)) for i in range(1 + max(most for _, most in _ACROSS))])
    for count, most in _ACROSS:
        for plane in combinations(axes, count):
            numbers = product(range(1, most + 1), repeat=count)
            fields = [(1.0 + sum(n)) ** -_FADING * waves[list(n), plane].prod(axis=0) for n in numbers]
            yield np.stack(fields), ()


def _within(at: NDArray[Any]) -> Array:
    """Places in voxels (..., N) as shares of the way from the first to the last."""
    return (at - at.min(axis=-1, keepdims=True) + 0.5) / (np.ptp(at, axis=-1, keepdims=True) + 1.0)


def _in_the_ring(voxels: Voxels, at: NDArray[np.intp]) -> list[Array]:
    """Where a ring of detectors about the third axis of the grid sees voxels: how far from its axis, and along the two
    ways halfway between the others, in voxels (N,)."""
    edges = np.array(voxels.picture.size[:2])
    middle = 0.5 * (np.array(voxels.inside.shape[:2]) - 1.0)
    x, y = (at[:2].T - middle).T * (edges / edges.min())[:, None]
    ways = [np.hypot(x, y), (x + y) / 2**0.5, (x - y) / 2**0.5]
    return ways if np.ptp(x) > 0 and np.ptp(y) > 0 else []


def _waves(u: Array) -> list[Array]:
    """Half waves along an axis, each (N,)."""
    return [(1.0 + i) ** -_FADING * np.cos(np.pi * i * u) for i in range(1, _ALONG + 1)]


def _windows(u: Array) -> Iterator[Array]:
    """Windows along an axis, which end softly (N,)."""
    for half in _WINDOWS:
        for middle in np.arange(0.0, 1.0 + 0.25 * half, 0.5 * half):
            yield 0.5 + 0.5 * np.cos(np.pi * np.minimum(np.abs(u - middle) / half, 1.0))


def _largest(voxels: Voxels) -> NDArray[np.intp]:
    """Places of the largest regions, in their order."""
    return np.sort(np.argsort(-np.bincount(voxels.place), kind="stable")[:_REGIONS])


def _apart(voxels: Voxels, weights: Array, least: float) -> Array:
    """Weights (F, N) turned within every region so that their sums have noise of size one, and share none."""
    found = np.zeros_like(weights)
    for r, covariance in enumerate(voxels.picture.grain.covariances(weights)):
        size, axes = np.linalg.eigh(covariance)
        size = np.maximum(size, least**2)
        kept = size > _LEAST * size[-1]
        believed = np.maximum(size[kept], _FLOOR * size[kept].mean())
        mine = voxels.place == r
        found[: int(kept.sum()), mine] = (axes[:, kept] / np.sqrt(believed)).T @ weights[:, mine]
    return found
