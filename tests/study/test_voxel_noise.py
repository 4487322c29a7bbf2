"""What voxels tell of noise: how it changes over the frames, and how far neighbours share it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from petkin.study.diagnosis.voxel_noise import VoxelNoise, voxel_noise

EDGE, FRAMES = 18, 16
LABELS = np.zeros((EDGE, EDGE, EDGE), np.intp)
LABELS[2:16, 2:10, 2:16] = 1
LABELS[7:11, 11:15, 7:11] = 2
#: One frame in which everything scatters three times as much.
UNSTEADY = np.where(np.arange(FRAMES) == 9, 3.0, 1.0)
COURSES = np.stack([np.exp(-np.arange(FRAMES) / tau) for tau in (3.0, 20.0)])


def shared_noise(rng: np.random.Generator) -> NDArray[np.float64]:
    """Half of the variance is common to neighbours, by frame (K, x, y, z)."""
    sigma = 1.2
    smooth = np.stack([gaussian_filter(rng.standard_normal(LABELS.shape), sigma, mode="wrap") for _ in range(FRAMES)])
    smooth /= (2.0 * np.sqrt(np.pi) * sigma) ** -1.5
    white = rng.standard_normal(smooth.shape)
    return UNSTEADY[:, None, None, None] * np.sqrt(0.5) * (white + smooth)


def of_noise(seed: int) -> VoxelNoise:
    rng = np.random.default_rng(seed)
    inside = LABELS > 0
    levels = np.array([20.0, 30.0])[LABELS[inside] - 1, None] * (1.0 + 0.1 * rng.standard_normal((inside.sum(), 2)))
    curves = levels @ COURSES + shared_noise(rng)[:, inside].T
    return voxel_noise(curves, LABELS, np.ones((2, FRAMES)), COURSES, np.full(3, 5.0))


def test_a_noisy_frame_shows_in_the_voxels() -> None:
    found = of_noise(0).by_frame
    np.testing.assert_allclose(found[:, 2:], np.stack([UNSTEADY[2:]] * 2), rtol=0.15)


def test_sums_scatter_as_neighbours_share_noise() -> None:
    """Means of a large and of a small region, and a weighting that grows across them."""
    found, inside = of_noise(1), LABELS > 0
    rng = np.random.default_rng(2)
    drawn = np.concatenate([(shared_noise(rng) / UNSTEADY[:, None, None, None])[:, inside] for _ in range(40)])
    along = np.nonzero(inside)[2].astype(np.float64)
    place = LABELS[inside] - 1
    for weights in (np.ones(place.size), along - along.mean()):
        true = [(drawn[:, place == r] @ weights[place == r]).std() for r in (0, 1)]
        np.testing.assert_allclose(found.sizes(weights), true, rtol=0.25)
    large, small = found.of_means()[:, 0]
    assert small > 2.5 * large


def test_an_image_without_noise_has_even_noise() -> None:
    inside = LABELS > 0
    curves = np.ones((int(inside.sum()), FRAMES)) * np.array([20.0, 30.0])[LABELS[inside] - 1, None]
    found = voxel_noise(curves, LABELS, np.ones((2, FRAMES)), np.ones((1, FRAMES)) / np.sqrt(FRAMES), np.full(3, 5.0))
    assert np.isfinite(found.of_means()).all()
    assert (found.of_means() > 0).all()


def true_noise(furthest: int) -> VoxelNoise:
    """What `shared_noise` is: e^{-d^2 / 4 sigma^2} of half the variance, d in voxels."""
    at = np.arange(-furthest, furthest + 1)
    squares = (np.stack(np.meshgrid(at, at, at, indexing="ij")) ** 2).sum(axis=0)
    shared = 0.5 * np.exp(-squares / (4.0 * 1.2**2)) + 0.5 * (squares == 0)
    return VoxelNoise(np.ones(FRAMES), shared, LABELS)


def test_what_goes_with_the_mean_of_a_region_is_given_back() -> None:
    """Residuals lose their region's mean and what the courses take: sums of all kinds scatter as noise itself does."""
    inside = LABELS > 0
    place, true = LABELS[inside] - 1, true_noise(5)
    found = [of_noise(seed) for seed in range(20)]
    for weights in (np.ones(place.size), *(at - at.mean() for at in np.stack(np.nonzero(inside)).astype(np.float64))):
        ratio = np.mean([each.sizes(weights) ** 2 for each in found], axis=0) / true.sizes(weights) ** 2
        np.testing.assert_allclose(ratio, 1.0, atol=0.12)


@pytest.mark.parametrize("own", [0.0, 0.6, 1.0, 2.0])
def test_voxels_say_whose_counts_they_scatter_by(own: float) -> None:
    """Two halves whose curves cross: noise goes by their own values, by what both have, or by a percentage."""
    rng, labels = np.random.default_rng(6), np.ones((EDGE, EDGE, EDGE), np.intp)
    labels[:, EDGE // 2 :] = 2
    place, frames = labels.ravel() - 1, np.arange(FRAMES)
    curves = np.stack([100.0 * np.exp(-frames / 3.0) + 3.0, 30.0 * np.exp(-frames / 20.0)])
    counted = np.sqrt(curves)
    true = counted**own * np.exp(np.log(counted).mean(axis=0)) ** (1.0 - own)
    noise = (shared_noise(rng) / UNSTEADY[:, None, None, None]).reshape(FRAMES, -1).T
    found = voxel_noise(
        curves[place] + 0.1 * true[place] * noise, labels, counted, np.linalg.qr(curves.T)[0].T, np.full(3, 5.0)
    )
    apart, untold = (np.diff(np.log(said / true), axis=0).std() for said in (found.by_frame * counted, counted))
    assert untold >= 0.25 * abs(1.0 - own)
    assert apart < 0.02 + 0.1 * untold


def test_voxels_say_which_region_is_noisier() -> None:
    """Regions of many and of few voxels, one of them half as noisy again; none is taken for it by its size alone."""
    inside, place = LABELS > 0, LABELS[LABELS > 0] - 1

    def found(noisier: float, seed: int) -> NDArray[np.float64]:
        noise = shared_noise(np.random.default_rng(seed))[:, inside].T * np.array([1.0, noisier])[place, None]
        curves = np.array([20.0, 30.0])[place, None] * COURSES.sum(axis=0) + noise
        by_frame = voxel_noise(curves, LABELS, np.ones((2, FRAMES)), COURSES, np.full(3, 5.0)).by_frame
        return np.log(np.median(by_frame[1] / by_frame[0]))

    for noisier in (1.0, 1.5):
        assert np.mean([found(noisier, seed) for seed in range(8)]) == pytest.approx(np.log(noisier), abs=0.1)


def test_regions_that_touch_share_noise_at_their_border() -> None:
    """Two halves of a block, weights of one sign and of both, against draws."""
    labels = np.zeros((EDGE, EDGE, EDGE), np.intp)
    labels[3:15, 3:9, 3:15], labels[3:15, 9:15, 3:15] = 1, 2
    inside = labels > 0
    place, known = labels[inside] - 1, true_noise(5)
    noise = VoxelNoise(known.by_frame, known.shared, labels)
    rng = np.random.default_rng(7)
    drawn = np.concatenate([(shared_noise(rng) / UNSTEADY[:, None, None, None])[:, inside] for _ in range(40)])
    along = np.nonzero(inside)[0].astype(np.float64)
    for weights in (np.ones(place.size), along - along.mean()):
        sums = np.stack([drawn[:, place == r] @ weights[place == r] for r in (0, 1)])
        found = noise.between(weights)
        np.testing.assert_allclose(found, np.cov(sums), atol=0.15 * found[0, 0])
        np.testing.assert_allclose(np.sqrt(np.diag(found)), noise.sizes(weights), rtol=1e-9)
        assert found[0, 1] > 0.1 * found[0, 0]


def test_frames_in_which_most_voxels_count_nothing_are_as_noisy_as_their_counts() -> None:
    """Half of the absolute residuals of such a frame are next to nothing, but their sum scatters by the counts."""
    rng, inside = np.random.default_rng(8), LABELS > 0
    expected = np.where(np.arange(FRAMES) < 3, 0.1, 25.0)
    counts = rng.poisson(expected, (int(inside.sum()), FRAMES)).astype(np.float64)
    spread = np.ones((2, FRAMES)) * np.sqrt(expected)
    found = voxel_noise(counts, LABELS, spread, np.stack([expected, np.ones(FRAMES)]), np.full(3, 5.0))
    assert (counts[:, 0] == 0).mean() > 0.85
    np.testing.assert_allclose(found.by_frame[:, :3], 1.0, rtol=0.25)
