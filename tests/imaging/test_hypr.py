"""HYPR-LR: what it leaves alone, what it takes away, and what it does at edges and where there is nothing."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.imaging import blur, composite_image, hypr_lr

SIZE = (2.0, 2.5, 3.0)
SHAPE = (20, 18, 10)
#: Frame weights, min.
WEIGHTS = np.array([1.0, 2.0, 4.0, 8.0, 15.0, 30.0])
EVERYWHERE = np.ones(SHAPE, bool)


def denoised(
    series: Sequence[NDArray] | NDArray, fwhm: float = 6.0, inside: NDArray[np.bool_] = EVERYWHERE
) -> NDArray[np.floating]:
    """(frames, x, y, z)."""
    composite = composite_image(series, WEIGHTS)
    return np.stack(list(hypr_lr(series, composite, inside, fwhm=fwhm, voxel_size=SIZE)))


def head() -> tuple[NDArray, NDArray]:
    """Labels of two tissues in air, and their curves: the inner one takes up more and keeps it longer."""
    labels = np.zeros(SHAPE, int)
    labels[3:17, 3:15, 2:8] = 1
    labels[6:11, 5:12, 3:7] = 2
    t = np.cumsum(WEIGHTS)
    return labels, np.stack([0 * t, *(a * np.exp(-t / out) * (1 - np.exp(-t / 2)) for a, out in ((6, 45), (9, 80)))])


def test_the_composite_is_the_weighted_mean() -> None:
    series = np.random.default_rng(0).random((6, *SHAPE)).astype(np.float32)
    expected = np.tensordot(WEIGHTS, series.astype(float), 1) / WEIGHTS.sum()
    np.testing.assert_allclose(composite_image(iter(series), WEIGHTS), expected, rtol=1e-12)


@given(seed=st.integers(0, 99), fwhm=st.floats(0.5, 30.0))
@settings(max_examples=10, deadline=None)
def test_a_separable_series_comes_back_as_it_was(seed: int, fwhm: float) -> None:
    """One curve everywhere up to a factor, up to the edge of the grid and of a ragged mask."""
    rng = np.random.default_rng(seed)
    space, time = rng.uniform(0.2, 5.0, SHAPE), rng.uniform(0.0, 9.0, 6)
    series = time[:, None, None, None] * space
    np.testing.assert_allclose(denoised(series, fwhm, rng.random(SHAPE) > 0.3), series, rtol=1e-12, atol=1e-13)


def test_the_composite_of_the_result_is_the_composite() -> None:
    """Also where it is negative, and where air is left as it is."""
    rng = np.random.default_rng(1)
    labels, curves = head()
    series = curves.T[:, labels] + rng.normal(0, 1.0, (6, *SHAPE))
    before, after = composite_image(series, WEIGHTS), composite_image(denoised(series), WEIGHTS)
    assert (before < 0).sum() > 100
    np.testing.assert_allclose(after, before, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("factor", [1e-6, 1e3, 1e9])
def test_units_do_not_matter(factor: float) -> None:
    labels, curves = head()
    series = curves.T[:, labels] + np.random.default_rng(2).normal(0, 0.5, (6, *SHAPE))
    np.testing.assert_allclose(denoised(factor * series), factor * denoised(series), rtol=1e-9)


def test_each_frame_has_its_own_scale() -> None:
    """So it does not matter whether frames are corrected for decay, as long as the composite is the same."""
    rng = np.random.default_rng(3)
    labels, curves = head()
    series = curves.T[:, labels] + rng.normal(0, 0.5, (6, *SHAPE))
    factors = rng.uniform(0.2, 4.0, 6)[:, None, None, None]
    composite = composite_image(series, WEIGHTS)
    scaled = np.stack(list(hypr_lr(factors * series, composite, EVERYWHERE, fwhm=6.0, voxel_size=SIZE)))
    np.testing.assert_allclose(scaled, factors * denoised(series), rtol=1e-9, atol=1e-12)


def test_noise_falls_and_regional_means_stay() -> None:
    """Scatter of voxels in their region, short frames most: to 0.4-0.7 of what it was; means move by under 5 %.

    They move most where a small region meets another curve, and in the direction of that one.
    """
    rng = np.random.default_rng(4)
    labels, curves = head()
    true = curves.T[:, labels]
    noisy = true + rng.normal(0, 2.0, true.shape) / np.sqrt(WEIGHTS)[:, None, None, None]
    clean = denoised(noisy, 4.0, labels > 0)
    for label, moved in ((1, 0.02), (2, 0.05)):
        before, after = noisy[:, labels == label], clean[:, labels == label]
        left = after.std(axis=1) / before.std(axis=1)
        assert left.max() < 0.7, (label, left)
        assert left[:2].max() < 0.5, (label, left)
        bias = (after.mean(axis=1) - before.mean(axis=1)) / curves[label]
        assert np.abs(bias).max() < moved, (label, bias)


def test_edges_are_sharper_than_those_of_a_blur() -> None:
    labels, curves = head()
    true = curves.T[:, labels]
    far = [np.abs(s - true)[:, labels == 2].mean() for s in (denoised(true, 8.0), blur(true.T, 8.0, SIZE[::-1]).T)]
    assert far[0] < 0.4 * far[1]


def test_nothing_leaks_in_from_outside_the_mask() -> None:
    labels, curves = head()
    series, inside = curves.T[:, labels], labels > 0
    hot = np.where(inside, series, 1000 * np.arange(6)[:, None, None, None])
    np.testing.assert_allclose(denoised(hot, 8.0, inside)[:, inside], denoised(series, 8.0, inside)[:, inside])
    np.testing.assert_array_equal(denoised(hot, 8.0, inside)[:, ~inside], hot[:, ~inside])


def test_voxels_that_are_not_finite_stay_alone() -> None:
    labels, curves = head()
    series = curves.T[:, labels].copy()
    series[2, 8, 8, 5], series[3, 9, 8, 5], series[4, 9, 8, 5] = np.nan, np.inf, -np.inf
    found = denoised(series)
    assert np.isfinite(found).sum() == found.size - 3
    broken = ~np.isfinite(series).all(axis=0)
    np.testing.assert_array_equal(found[:, broken], series[:, broken])


@pytest.mark.parametrize("level", [0.0, -1.0])
def test_nothing_above_zero_is_left_as_it_is(level: float) -> None:
    series = np.full((6, *SHAPE), level)
    np.testing.assert_array_equal(denoised(series), series)


def test_float32_stays_and_agrees_with_float64() -> None:
    rng = np.random.default_rng(8)
    labels, curves = head()
    series = curves.T[:, labels] + rng.normal(0, 0.5, (6, *SHAPE))
    single = denoised(series.astype(np.float32))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single[:, labels > 0], denoised(series)[:, labels > 0], rtol=1e-4, atol=1e-4)


def test_frames_are_read_one_at_a_time() -> None:
    read = []

    def frames():
        for k in range(6):
            read.append(k)
            yield np.full(SHAPE, 1.0 + k)

    results = hypr_lr(frames(), np.ones(SHAPE), EVERYWHERE, fwhm=4.0, voxel_size=SIZE)
    next(results)
    assert read == [0]


def test_no_frames_are_refused() -> None:
    with pytest.raises(InputError, match="no frames"):
        composite_image([], np.empty(0))
