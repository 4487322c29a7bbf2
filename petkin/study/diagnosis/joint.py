"""Several contrasts of each of some regions at once: what their rows, one a contrast and region, hold.

Weights (F, N) of the voxels; rows (F R, K), the regions within each contrast.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from petkin.study.diagnosis.picture import Voxels

Array = NDArray[np.float64]


def beside(voxels: Voxels, weights: Array, regions: NDArray[np.intp]) -> Array:
    """Weighted sums beside those of the picture as it is drawn, where there is one."""
    return np.concatenate([voxels.beside(each)[regions] for each in weights])


def added(voxels: Voxels, weights: Array, regions: NDArray[np.intp], maps: Iterable[Array]) -> Array:
    """What maps (N, M) add to them (maps, F R, K)."""
    courses, spread = voxels.picture.courses, voxels.spread[regions]
    places = [np.flatnonzero(voxels.place == r) for r in regions]
    own = [weights[:, place] for place in places]
    rows = []
    for each in maps:
        held = np.stack([seen @ each[place] for seen, place in zip(own, places)], axis=1)
        rows.append((held @ courses / spread).reshape(-1, courses.shape[1]))
    return np.stack(rows) if rows else np.zeros((0, len(weights) * len(regions), courses.shape[1]))


def there(voxels: Voxels, weights: Array, regions: NDArray[np.intp]) -> Array:
    """What each may hold of an image that stays as it is, for itself (n, F R, K)."""
    fields, frames = len(weights), voxels.spread.shape[1]
    columns = np.zeros((fields, len(regions), voxels.seen.shape[1], fields, len(regions), frames))
    for f, own in enumerate(weights):
        each = voxels.there(own).reshape(*voxels.spread.shape[:1], -1, *voxels.spread.shape)
        columns[f, :, :, f] = each[regions][:, :, regions]
    return columns.reshape(-1, fields * len(regions), frames)
