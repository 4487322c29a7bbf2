"""Kinetics that vary within regions: their size is found in the image, and contrasts scatter as is foretold."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from petkin.study.diagnosis.picture import Picture, Voxels
from petkin.study.diagnosis.variation import Variation, Weighed
from petkin.study.diagnosis.voxel_noise import VoxelNoise

SHAPE, EDGE, FRAMES, LENGTH = (24, 16, 14), 5.0, 12, 15.0
TIMES = np.arange(FRAMES) / 4.0
LEVELS = np.outer([20.0, 30.0], np.exp(-TIMES / 2.0))
#: Derivatives of the two regions' curves by two parameters (R, K, P).
SENSITIVITY = np.stack([LEVELS, LEVELS * TIMES], axis=2)


def smooth(rng: np.random.Generator) -> np.ndarray:
    """A field of unit variance with the correlation e^{-d^2 / 2 LENGTH^2}."""
    wide = gaussian_filter(rng.standard_normal([n + 40 for n in SHAPE]), LENGTH / EDGE / np.sqrt(2.0))
    return (wide / wide.std())[20:-20, 20:-20, 20:-20].ravel()


def voxels_of(rng: np.random.Generator, spread: float, more: np.ndarray | float = 0.0) -> Voxels:
    """Two halves of a block, whose two parameters vary by so much, with noise of size one and more besides (N, K)."""
    labels = np.ones(SHAPE, np.intp)
    labels[SHAPE[0] // 2 :] = 2
    place = labels.ravel() - 1
    curves = LEVELS[place] + rng.standard_normal((place.size, FRAMES)) + more
    for p in range(2):
        curves += spread * smooth(rng)[:, None] * SENSITIVITY[place, :, p]
    grain = VoxelNoise(np.ones(FRAMES), np.ones((1, 1, 1)), labels)
    courses = np.linalg.svd(LEVELS, full_matrices=False)[2][:1]
    seen = np.zeros((*SHAPE, 1))
    picture = Picture(
        curves.T.astype(np.float32),
        place,
        np.ones(SHAPE, bool),
        (slice(None),) * 3,
        (EDGE,) * 3,
        0.0,
        courses,
        seen,
        grain,
    )
    fit: Any = SimpleNamespace(values=LEVELS)
    return Voxels(picture, fit, np.ones_like(LEVELS), SENSITIVITY)


def along(voxels: Voxels) -> np.ndarray:
    """Weights that grow along the first axis."""
    return voxels.centred(np.nonzero(voxels.inside)[0].astype(float))


def variation_of(voxels: Voxels, weights: np.ndarray) -> Variation:
    contrast: Any = SimpleNamespace(weights=weights, sizes=voxels.picture.grain.sizes(weights))
    return Variation.of(voxels, [contrast])


@pytest.mark.parametrize("spread", [0.05, 0.2])
def test_the_size_of_what_varies_is_found(spread: float) -> None:
    rng = np.random.default_rng(1)
    found = []
    for _ in range(6):
        voxels = voxels_of(rng, spread)
        found.append(variation_of(voxels, along(voxels)).variance)
    assert 0.7 * spread < np.sqrt(np.median(found)) < 1.4 * spread


@pytest.mark.parametrize("parted", [False, True])
def test_contrasts_scatter_as_foretold(parted: bool) -> None:
    """Over images whose kinetics vary, t^2 of a contrast is one on average, whole or in two parts."""
    rng = np.random.default_rng(2)
    squares = []
    for _ in range(40):
        voxels = voxels_of(rng, 0.1)
        weights = along(voxels)
        variation, noise = variation_of(voxels, weights), voxels.picture.grain.between(weights)
        each = variation.parted(voxels, Weighed(weights, noise)) if parted else weights[None]
        columns = variation.joint(each, np.arange(2)).reshape(-1, len(each) * LEVELS.size)
        covariance = np.kron(voxels.picture.grain.between(each), np.eye(FRAMES)) + columns.T @ columns
        rows = np.concatenate([voxels.sums(one) for one in each]).ravel()
        squares.append(rows @ np.linalg.solve(covariance, rows) / rows.size)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.15)


def test_one_part_of_a_contrast_sees_no_smooth_field() -> None:
    """Both parts are of unit length and together hold the weights; a field as smooth as kinetics stays with one."""
    rng = np.random.default_rng(4)
    voxels = voxels_of(rng, 0.2)
    edges = np.where(np.nonzero(voxels.inside)[1] % 8 < 4, 1.0, -1.0)
    weights = voxels.centred(edges + 3.0 * along(voxels) * voxels.place.size**0.5)
    noise = voxels.picture.grain.between(weights)
    rough, even = variation_of(voxels, weights).parted(voxels, Weighed(weights, noise))
    for region in (0, 1):
        mine = voxels.place == region
        assert rough[mine] @ rough[mine] == pytest.approx(1.0)
        both = np.stack([rough[mine], even[mine]], axis=1)
        left = weights[mine] - both @ np.linalg.lstsq(both, weights[mine], rcond=None)[0]
        assert np.abs(left).max() < 1e-9
    fields = np.stack([smooth(rng) for _ in range(20)])
    seen_rough, seen_even = (np.square(fields @ each).mean() for each in (rough, even))
    assert seen_rough < 0.05 * seen_even


def test_decoys_are_blind_to_what_the_weights_see() -> None:
    """A strong signal along the weights does not count as kinetics that vary."""
    weights = along(voxels_of(np.random.default_rng(3), 0.05))
    bare, moved = (
        variation_of(voxels_of(np.random.default_rng(3), 0.05, more), weights).variance
        for more in (0.0, 60.0 * weights[:, None] * LEVELS[0])
    )
    np.testing.assert_allclose(moved, bare, rtol=0.1)
