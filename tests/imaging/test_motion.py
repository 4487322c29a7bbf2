"""Moving a picture: whole voxels, parts of them, turns, and what cannot be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from petkin.errors import InputError
from petkin.imaging import PLANES, middle_and_rim, moved

SIZE = (2.0, 2.5, 3.0)


def ball() -> tuple[np.ndarray, np.ndarray]:
    """A smooth thing off the middle of its grid, and where it is labelled."""
    x, y, z = np.indices((21, 23, 19))
    picture = np.exp(-((x - 9.0) ** 2 + (y - 12.0) ** 2 + (z - 8.0) ** 2) / 8.0)
    return picture, picture > 0.02


def centre(picture: np.ndarray) -> np.ndarray:
    """In mm."""
    return (np.indices(picture.shape) * picture).reshape(3, -1).sum(axis=1) / picture.sum() * SIZE


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_whole_voxels_are_a_roll(axis: int) -> None:
    picture, labelled = ball()
    there = moved(picture, axis, 2.0 * SIZE[axis], SIZE, labelled)
    inner = np.roll(picture, 2, axis)
    middle = (slice(3, -3),) * 3
    np.testing.assert_allclose(there[middle], inner[middle], atol=1e-12)


@given(axis=st.sampled_from([0, 1, 2]), far=st.floats(-6.0, 6.0))
def test_a_shift_moves_the_centre_by_so_much_and_keeps_the_sum(axis: int, far: float) -> None:
    picture, labelled = ball()
    there = moved(picture, axis, far, SIZE, labelled)
    expected = np.zeros(3)
    expected[axis] = far
    np.testing.assert_allclose(centre(there) - centre(picture), expected, atol=0.02)
    assert there.sum() == pytest.approx(picture.sum(), rel=1e-3)


@pytest.mark.parametrize("way", [3, 4, 5])
def test_a_quarter_turn_brings_the_first_axis_to_the_second(way: int) -> None:
    one, two = PLANES[way - 3]
    picture = np.zeros((15, 15, 15))
    place = np.full(3, 7)
    place[one] += 4
    picture[tuple(place)] = 1.0
    labelled = np.ones(picture.shape, bool)
    _, rim = middle_and_rim(labelled, (one, two), np.full(3, 2.0))
    there = moved(picture, way, rim * np.pi / 2.0, (2.0, 2.0, 2.0), labelled)
    expected = np.full(3, 7)
    expected[two] += 4
    assert np.unravel_index(there.argmax(), there.shape) == tuple(expected)
    assert there.max() == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("way", [3, 4, 5])
def test_the_rim_moves_by_what_is_asked(way: int) -> None:
    """A spot at the rim of voxels of three sizes, along the arc."""
    one, two = PLANES[way - 3]
    labelled = np.zeros((41, 41, 41), bool)
    labelled[8:33, 8:33, 8:33] = True
    middle, rim = middle_and_rim(labelled, (one, two), np.array(SIZE))
    at = (np.indices(labelled.shape) - middle[:, None, None, None]) * np.array(SIZE)[:, None, None, None]
    edge = np.zeros(3)
    edge[[one, two]] = 12.0 * np.array(SIZE)[[one, two]]
    spot = np.exp(-((at - edge[:, None, None, None]) ** 2).sum(axis=0) / 40.0)
    went = centre(moved(spot, way, 2.0, SIZE, labelled)) - centre(spot)
    assert np.linalg.norm(went) == pytest.approx(2.0, rel=0.02)
    assert went[one] < 0.0 < went[two]
    assert rim == pytest.approx(np.linalg.norm(edge))


def test_between_voxels_an_even_picture_is_averaged_as_it_lies() -> None:
    picture = np.zeros((6, 1, 1))
    picture[2:4] = 8.0
    there = moved(picture, 0, 0.5, (2.0, 2.0, 2.0), picture > 0)
    np.testing.assert_allclose(there[:, 0, 0], [0.0, 0.0, 6.0, 8.0, 2.0, 0.0])


@pytest.mark.parametrize(("way", "axis"), [(2, 2), (4, 2), (5, 2)])
def test_a_slice_cannot_leave_its_plane(way: int, axis: int) -> None:
    picture = np.ones((5, 5, 1))
    with pytest.raises(InputError, match=f"axis={way}: the picture has one voxel along axis {axis}"):
        moved(picture, way, 1.0, (2.0, 2.0, 2.0), picture > 0)
