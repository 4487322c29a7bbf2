"""Which voxels a plane shows, and on which side."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from petkin.reporting.planes import orthogonal_planes


def _volume(axes: str) -> np.ndarray:
    """An asymmetric volume in RAS, stored along other axes: value = 100 r + 10 a + s."""
    r, a, s = np.meshgrid(np.arange(6), np.arange(7), np.arange(8), indexing="ij")
    ras = (100 * r + 10 * a + s).astype(float)
    order = [next(i for i, pair in enumerate(("RL", "AP", "SI")) if letter in pair) for letter in axes]
    volume = ras.transpose(order)
    return np.flip(volume, [i for i, letter in enumerate(axes) if letter in "LPI"])


ORIENTATIONS = ["".join(p) for p in itertools.chain(*(itertools.permutations(t) for t in ("RAS", "LPS", "LAI", "RPI")))]


@pytest.mark.parametrize("axes", ORIENTATIONS)
def test_planes_look_the_same_however_the_volume_is_stored(axes: str) -> None:
    volume = _volume(axes)
    sizes = {"R": 1.0, "L": 1.0, "A": 2.0, "P": 2.0, "S": 3.0, "I": 3.0}
    voxel = (sizes[axes[0]], sizes[axes[1]], sizes[axes[2]])
    inside = np.ones(volume.shape, bool)
    # one end heavier, so that the centre is not halfway between two voxels
    inside &= ~np.isin(volume, [0])
    planes = {p.name: p for p in orthogonal_planes(inside, voxel, axes)}
    assert list(planes) == ["axial", "coronal", "sagittal"]
    axial, coronal, sagittal = (planes[n].cut(volume) for n in ("axial", "coronal", "sagittal"))
    assert (np.diff(axial, axis=1) == 100).all()
    assert (np.diff(axial, axis=0) == 10).all()
    assert (np.diff(coronal, axis=1) == 100).all()
    assert (np.diff(coronal, axis=0) == 1).all()
    assert (np.diff(sagittal, axis=1) == 10).all()
    assert (np.diff(sagittal, axis=0) == 1).all()
    assert planes["axial"].sides == planes["coronal"].sides == ("L", "R")
    assert planes["sagittal"].sides == ("P", "A")
    assert planes["axial"].size_mm == (6.0, 14.0)
    assert planes["sagittal"].size_mm == (14.0, 24.0)


def test_planes_pass_through_the_centre_and_keep_to_the_mask() -> None:
    inside = np.zeros((30, 30, 30), bool)
    inside[4:9, 10:21, 16:27] = True
    axial = orthogonal_planes(inside, (1.0, 1.0, 1.0), "RAS")[0]
    assert axial.index == 21
    assert axial.cut(inside).shape == (11 + 4, 5 + 4)
    assert axial.cut(inside).sum() == 55


@pytest.mark.parametrize(
    ("shape", "names"), [((9, 9, 1), ["i–j plane"]), ((1, 9, 9), ["j–k plane"]), ((9, 9, 3), ["i–j plane"])]
)
def test_thin_volumes_show_the_plane_they_have(shape: tuple[int, int, int], names: list[str]) -> None:
    planes = orthogonal_planes(np.ones(shape, bool), (2.0, 2.0, 2.0))
    assert [p.name for p in planes] == names
    assert planes[0].sides == ("", "")


def test_an_empty_mask_shows_the_middle() -> None:
    assert [p.index for p in orthogonal_planes(np.zeros((9, 11, 13), bool), (1.0, 1.0, 1.0))] == [6, 5, 4]
