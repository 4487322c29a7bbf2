"""Point spread: mass, width, axes."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from petkin.errors import InputError
from petkin.imaging import blur, gaussian_kernel


@given(fwhm=st.floats(0.5, 20.0), voxel=st.floats(0.8, 8.0))
@settings(max_examples=30, deadline=None)
def test_kernel_has_mass_one_and_the_gaussian_variance(fwhm: float, voxel: float) -> None:
    kernel = gaussian_kernel(fwhm, voxel)
    position = voxel * (np.arange(kernel.size) - kernel.size // 2)
    assert kernel.sum() == pytest.approx(1.0, rel=1e-12)
    assert (kernel * position**2).sum() == pytest.approx(fwhm**2 / (8 * math.log(2)), rel=1e-3)


def test_a_point_spreads_to_the_stated_fwhm() -> None:
    point = np.zeros((81, 81))
    point[40, 40] = 1.0
    profile = blur(point, 12.0, (1.0, 1.0))[40]
    half = 0.5 * profile.max()
    right = np.interp(-half, -profile[40:], np.arange(41.0))
    assert 2 * right == pytest.approx(12.0, rel=1e-2)


def test_mass_inside_is_kept_in_every_frame() -> None:
    rng = np.random.default_rng(1)
    series = np.zeros((30, 24, 28, 3))
    series[10:20, 10:14, 11:16] = rng.random((10, 4, 5, 3))
    blurred = blur(series, 8.0, (2.0, 2.5, 2.0))
    np.testing.assert_allclose(blurred.sum((0, 1, 2)), series.sum((0, 1, 2)), rtol=1e-4)


def test_frames_do_not_mix() -> None:
    series = np.zeros((16, 16, 4))
    series[8, 8, 2] = 1.0
    blurred = blur(series, 6.0, (2.0, 2.0))
    assert blurred[..., [0, 1, 3]].max() == 0.0
    assert blurred[8, 8, 2] < 1.0


def test_a_single_slice_is_not_blurred_through() -> None:
    plane = np.zeros((17, 17, 1))
    plane[8, 8, 0] = 1.0
    assert blur(plane, 6.0, (2.0, 2.0, 2.0)).sum() == pytest.approx(1.0, rel=1e-6)


def test_no_blur_is_the_same_array() -> None:
    volume = np.ones((3, 3, 3))
    assert blur(volume, 0.0, (2, 2, 2)) is volume


@pytest.mark.parametrize(("fwhm", "voxel"), [(-1.0, 2.0), (math.nan, 2.0), (4.0, 0.0)])
def test_impossible_widths_are_refused(fwhm: float, voxel: float) -> None:
    with pytest.raises(InputError):
        blur(np.ones((3, 3, 3)), fwhm, (voxel,) * 3)
