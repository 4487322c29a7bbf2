"""Contrasts of an image: what they must not see, and the slopes that motion goes by."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from petkin.study.diagnosis.picture import Picture, Voxels
from petkin.study.diagnosis.spatial import _slope
from petkin.study.diagnosis.voxel_noise import VoxelNoise

REGIONS, FRAMES, EACH = 3, 8, 30


def voxels_of(factor: np.ndarray) -> Voxels:
    """Three regions of noisy voxels, every frame of which was multiplied by a factor."""
    rng = np.random.default_rng(5)
    levels = np.outer([10.0, 20.0, 35.0], np.exp(-np.arange(FRAMES) / 9.0))
    place = np.repeat(np.arange(REGIONS), EACH)
    curves = (levels[place] + rng.standard_normal((place.size, FRAMES))) * factor
    inside = np.ones((REGIONS, EACH, 1), bool)
    grain = VoxelNoise(np.ones(FRAMES), np.ones((1, 1, 1)), place.reshape(inside.shape) + 1)
    seen = np.zeros((*inside.shape, 1))
    picture = Picture(
        curves.T.astype(np.float32), place, inside, (slice(None),) * 3, (2.0,) * 3, 0.0, np.ones((1, 8)), seen, grain
    )
    fit: Any = SimpleNamespace(values=levels)
    return Voxels(picture, fit, np.ones_like(levels), np.zeros((REGIONS, FRAMES, 2)))


def test_contrasts_do_not_see_a_factor_of_a_whole_frame() -> None:
    steady, jittery = (voxels_of(f) for f in (np.ones(FRAMES), np.linspace(0.8, 1.3, FRAMES)))
    weights = steady.centred(np.random.default_rng(6).standard_normal(REGIONS * EACH))
    np.testing.assert_allclose(jittery.sums(weights), steady.sums(weights), rtol=1e-4, atol=1e-4)


def test_contrasts_do_not_see_the_means_of_regions() -> None:
    voxels = voxels_of(np.ones(FRAMES))
    weights = voxels.centred(np.random.default_rng(7).standard_normal(REGIONS * EACH))
    assert np.abs(voxels.over_regions(weights[:, None])).max() < 1e-9
    np.testing.assert_allclose(voxels.over_regions(weights[:, None] ** 2), 1.0)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_slopes_are_those_of_curved_images(axis: int) -> None:
    """Exact up to the fourth power, away from the ends of the grid."""
    edge = 2.5
    x = edge * np.arange(9.0)
    image = np.moveaxis(np.broadcast_to((0.1 * x**3 - x**2 + 3.0)[:, None, None, None], (9, 3, 4, 1)), 0, axis)
    expected = 0.3 * x**2 - 2.0 * x
    found = np.moveaxis(_slope(image, edge, axis), axis, 0)
    np.testing.assert_allclose(found[2:-2, 1, 2, 0], expected[2:-2], rtol=1e-9)
