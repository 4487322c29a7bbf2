"""The geometric transfer matrix: known mixtures are undone, and what it costs in noise."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from petkin.errors import InputError
from petkin.imaging import FWHM_PER_SIGMA, TransferMatrix, background_rim, blur, transfer_matrix

SIZE = (2.0, 2.5, 3.5)
NAMES = {2: "putamen", 7: "caudate", 2035: "insula"}
REST = 2036


def phantom(shape: tuple[int, int, int] = (40, 34, 24)) -> NDArray[np.int32]:
    """Two small regions that touch, a shell around them, and air."""
    x, y, z = (SIZE[a] * (np.arange(n) - (n - 1) / 2) for a, n in enumerate(shape))
    x, y, z = x[:, None, None], y[:, None], z
    labels = np.zeros(shape, np.int32)
    labels[(x / 26) ** 2 + (y / 26) ** 2 + (z / 24) ** 2 < 1] = 2035
    labels[(abs(x + 5) < 5) & (abs(y) < 9) & (abs(z) < 9)] = 2
    labels[(abs(x - 5) < 5) & (abs(y) < 9) & (abs(z) < 9)] = 7
    return labels


def matrix(
    labels: NDArray[np.int32], fwhm: float, size: Sequence[float] = SIZE
) -> tuple[TransferMatrix, NDArray[np.int32]]:
    """The matrix with its background, and the labels with it."""
    rim = background_rim(labels, fwhm, size)
    with_rim = np.where(rim, REST, labels)
    names = NAMES | ({REST: "background"} if rim.any() else {})
    background = REST if rim.any() else None
    return transfer_matrix(with_rim, names, background=background, fwhm=fwhm, voxel_size=size), with_rim


def means(values: NDArray, labels: NDArray[np.int32]) -> NDArray:
    return np.array([values[labels == label].mean(axis=0) for label in np.unique(labels[labels > 0])])


def painted(labels: NDArray[np.int32], curves: NDArray, rest: NDArray | float = 0.0) -> NDArray:
    """A series (x, y, z, frames) with the curves of NAMES' regions."""
    values = np.full((*labels.shape, curves.shape[1]), rest)
    for label, curve in zip(NAMES, curves, strict=True):
        values[labels == label] = curve
    return values


CURVES = np.array([[1.0, 20.0, 8.0, -0.5], [2.0, 10.0, 12.0, 3.0], [4.0, 5.0, 5.0, 1.0]])


@pytest.mark.parametrize("fwhm", [2.0, 6.0, 10.0])
def test_a_blurred_phantom_gives_back_its_truth(fwhm: float) -> None:
    """Four frames, voxels of unequal sides, an active background that goes on outside the grid."""
    wide = np.pad(phantom(), 12)
    blurred = blur(painted(wide, CURVES, rest=1.5), fwhm, SIZE)[12:-12, 12:-12, 12:-12]
    found, labels = matrix(phantom(), fwhm)
    observed = means(blurred, labels)
    assert np.abs(observed[:3] / CURVES - 1).max() > (0.05 if fwhm > 3 else 0.005)
    np.testing.assert_allclose(found.corrected(observed), [*CURVES, [1.5] * 4], rtol=1e-5)


@pytest.mark.parametrize("fwhm", [6.0, 8.0])
def test_a_blur_by_another_program_is_undone(fwhm: float) -> None:
    """scipy's sampled Gaussian on a finer grid; it differs from the discrete one by about 1 % of what spills over."""
    labels, size = phantom().repeat(3, 0).repeat(3, 1).repeat(3, 2), [edge / 3 for edge in SIZE]
    sigma = [fwhm / FWHM_PER_SIGMA / edge for edge in size]
    blurred = gaussian_filter(painted(labels, CURVES, 1.5), [*sigma, 0.0], mode="nearest", truncate=6.0)
    found, with_rim = matrix(labels, fwhm, size)
    error = found.corrected(means(blurred, with_rim))[:3] - CURVES
    assert np.abs(error / CURVES.max(axis=0)).max() < 2.5e-3
    assert np.abs((means(blurred, labels) - CURVES) / CURVES.max(axis=0)).max() > 0.25


@pytest.mark.parametrize("width", [3.0, 6.0, 15.0])
def test_a_slab_recovers_by_its_closed_form(width: float) -> None:
    """w_11 = erf(L/(sigma sqrt 2)) - sigma/L sqrt(2/pi) (1 - exp(-L^2/(2 sigma^2))), and what is missing comes in."""
    step, fwhm = 0.1, 6.0
    sigma = fwhm / FWHM_PER_SIGMA
    labels = np.zeros((800, 1, 1), np.int32)
    labels[: round(width / step)] = 1
    labels = np.roll(labels, 400, axis=0)
    found = transfer_matrix(
        np.where(labels == 0, 2, 1), {1: "slab", 2: "rest"}, background=2, fwhm=fwhm, voxel_size=(step, 1.0, 1.0)
    )
    ratio = width / sigma
    share = erf(ratio / math.sqrt(2)) - math.sqrt(2 / math.pi) / ratio * -math.expm1(-(ratio**2) / 2)
    assert found.weights[0, 0] == pytest.approx(share, abs=2e-4)
    assert found.weights[0, 1] == pytest.approx(1 - share, abs=2e-4)
    observed = np.array([[share * 9.0 + (1 - share) * 4.0], [4.0 + found.weights[1, 0] * 5.0]])
    np.testing.assert_allclose(found.corrected(observed), [[9.0], [4.0]], rtol=1e-3)


@given(seed=st.integers(0, 999), fwhm=st.floats(1.0, 9.0))
@settings(max_examples=10, deadline=None)
def test_what_one_region_gives_the_other_takes(seed: int, fwhm: float) -> None:
    """n_i w_ij is symmetric, as the point spread is; rows add up to one, so an image of one value stays one."""
    labels = np.random.default_rng(seed).integers(0, 4, (9, 8, 7)).repeat(3, 0).repeat(2, 1).astype(np.int32)
    found = transfer_matrix(labels, {1: "a", 2: "b", 3: "c", 0: "rest"}, background=0, fwhm=fwhm, voxel_size=SIZE)
    assert found.names == ("rest", "a", "b", "c")
    given_out = (found.voxels[:, None] * found.weights)[1:, 1:]
    np.testing.assert_allclose(given_out, given_out.T, rtol=1e-9)
    np.testing.assert_allclose(found.weights.sum(axis=1), 1.0, rtol=1e-12)
    assert (found.weights > 0).all()


def test_without_blur_nothing_changes() -> None:
    for fwhm in (0.0, 0.05):
        found, labels = matrix(phantom(), fwhm)
        assert found.names == tuple(NAMES.values())
        np.testing.assert_allclose(found.weights, np.eye(3), atol=1e-3 * fwhm)
        np.testing.assert_allclose(found.noise_factor, 1.0, atol=1e-2 * fwhm)
        np.testing.assert_allclose(found.corrected(CURVES), CURVES, atol=1e-1 * fwhm)
        assert (labels == phantom()).all()


def test_the_error_grows_smoothly_with_a_wrong_point_spread() -> None:
    labels = np.pad(phantom(), 8)
    blurred = blur(painted(labels, CURVES), 6.0, SIZE)
    tried = np.array([4.0, 5.0, 5.5, 5.8, 6.0, 6.2, 6.5, 7.0, 8.0])
    errors = []
    for fwhm in tried:
        found, with_rim = matrix(labels, fwhm)
        errors.append((found.corrected(means(blurred, with_rim))[:3] / CURVES - 1)[:2, 1])
    small = np.abs(errors).max(axis=1)
    assert small[4] < 1e-5
    assert (np.diff(small[:5]) < 0).all()
    assert (np.diff(small[4:]) > 0).all()
    assert small[3] < 0.02
    assert small[5] < 0.02
    assert small.max() < 0.4


def test_a_background_left_out_is_wrong_and_one_far_away_does_not_matter() -> None:
    """The symptom of UCL/PETPVC#13, and why the background is the rim of the labels instead of all the air."""
    labels = np.pad(phantom(), 20)
    near = background_rim(labels, 30.0, SIZE)
    series = painted(labels, CURVES) + 2.0 * (near & ~(labels > 0))[..., None]
    series[:4, :4, :4] = 1000.0
    blurred = blur(series, 6.0, SIZE)
    found, with_rim = matrix(labels, 6.0)
    np.testing.assert_allclose(found.corrected(means(blurred, with_rim)), [*CURVES, [2.0] * 4], rtol=2e-3)
    without = transfer_matrix(labels, NAMES, background=None, fwhm=6.0, voxel_size=SIZE)
    shell = without.corrected(means(blurred, labels))[2] / CURVES[2] - 1
    assert np.abs(shell).max() > 0.05


def test_the_noise_factor_is_what_noise_does() -> None:
    labels = phantom()
    found, _ = matrix(labels, 7.0)
    rng = np.random.default_rng(3)
    drawn = rng.normal(0, 1, (4, 4000)) / np.sqrt(found.voxels)[:, None]
    factor = found.corrected(drawn).std(axis=1) / drawn.std(axis=1)
    np.testing.assert_allclose(factor, found.noise_factor, rtol=0.06)
    assert found.noise_factor[0] > 1.5
    assert found.condition > found.noise_factor.max() / 3


def test_regions_that_cannot_be_told_apart_are_named() -> None:
    labels = np.zeros((24, 24, 24), np.int32)
    labels[4:20, 4:20, 4:20] = 2035
    odd = np.indices((12, 12, 12)).sum(axis=0) % 2
    labels[6:18, 6:18, 6:18] = np.where(odd, 2, 7)
    found, with_rim = matrix(labels, 15.0)
    observed = means(np.random.default_rng(0).random((*labels.shape, 2)), with_rim)
    with pytest.raises(InputError, match=r"Regions putamen, caudate cannot be told apart.*condition number"):
        found.corrected(observed)


def test_a_region_without_values_is_named() -> None:
    found, _ = matrix(phantom(), 6.0)
    observed = np.ones((4, 3))
    observed[1, 2] = np.nan
    with pytest.raises(InputError, match="'caudate' holds no finite values"):
        found.corrected(observed)


def test_a_single_slice() -> None:
    labels = phantom()[:, :, 12:13]
    blurred = blur(painted(labels, CURVES), 6.0, SIZE)
    found, with_rim = matrix(labels, 6.0)
    np.testing.assert_allclose(found.corrected(means(blurred, with_rim))[:3], CURVES, rtol=1e-6)
