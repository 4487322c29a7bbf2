"""Phantoms on grids: every region at every voxel size, volumes that do not depend on it, clear errors."""

import math
import shutil
from pathlib import Path

import nibabel as nib
import numpy as np
import pytest

from petkin.errors import InputError
from petkin.phantoms import Phantom, catalogue_folder, paint, phantom_names, phantom_with, read_phantom, reading

PAPER_REGIONS = ["grey", "white", "caudate-putamen", "cerebellum", "lesion"]

BALL = """
name = "ball"
title = "One ball"
coordinates = "mm"
field_of_view = [60.0, 60.0, 60.0]
voxel_size = 2.0
[[region]]
index = 3
name = "ball"
tissue = "any"
shapes = [{ centre = [0.0, 5.0, 0.0], radii = [20.0, 15.0, 10.0], angles = [0.0, 0.0, 90.0] }]
"""


def described(text: str, folder: Path) -> Phantom:
    path = folder / "own.toml"
    path.write_text(text)
    return read_phantom(str(path))


def volumes(name: str, voxel: float, subsamples: int = 1) -> dict[str, float]:
    painted = paint(read_phantom(name), voxel_size=voxel, subsamples=subsamples)
    cell = math.prod(painted.voxel_size[: read_phantom(name).dimensions])
    return {r.name: cell * float(painted.fractions[..., i].sum()) for i, r in enumerate(painted.regions)}


def test_the_paper_phantom_has_five_regions_on_64_by_64() -> None:
    painted = paint(phantom_with(5))
    assert [r.name for r in painted.regions] == PAPER_REGIONS
    assert painted.labels.shape == (64, 64, 1)
    assert 0.25 < painted.mask.mean() < 0.4


def test_the_whole_brain_has_the_regions_it_promises() -> None:
    names = {r.name for r in read_phantom("brain3d").regions}
    paired = {
        f"{side}-{part}" for side in ("left", "right") for part in ("thalamus", "caudate", "putamen", "hippocampus")
    }
    lobes = {f"{lobe}-cortex" for lobe in ("frontal", "parietal", "temporal", "occipital")}
    assert names >= paired | lobes | {"cerebellum", "brain-stem", "white-matter", "csf"}
    assert len(names) >= 12


@pytest.mark.parametrize(
    ("name", "voxel"),
    [*(("brain2d", v) for v in (0.9, 1.7, 3.0, 4.3, 6.0, 8.0)), *(("brain3d", v) for v in (3.0, 4.3, 6.0, 8.0))],
)
def test_every_region_has_voxels_at_any_voxel_size(name: str, voxel: float) -> None:
    painted = paint(read_phantom(name), voxel_size=voxel)
    assert set(np.unique(painted.labels)) == {0, *(r.index for r in painted.regions)}


@pytest.mark.parametrize(("name", "coarse", "fine"), [("brain2d", 4.0, 1.0), ("brain3d", 6.0, 3.0)])
def test_volumes_do_not_depend_on_the_voxel_size(name: str, coarse: float, fine: float) -> None:
    wide, narrow = volumes(name, coarse, subsamples=3), volumes(name, fine)
    for region in wide.keys() - {"csf"}:  # its fissure is thinner than the samples are apart
        assert wide[region] == pytest.approx(narrow[region], rel=0.12), region


def test_the_brain_has_a_brains_volume() -> None:
    """About 1.1 to 1.6 L in adults; thalamus 4 to 8 mL a side; cerebellum 100 to 160 mL."""
    found = volumes("brain3d", 3.0)
    assert 1.1e6 < sum(found.values()) < 1.6e6
    assert 4e3 < found["left-thalamus"] < 8e3
    assert 1.0e5 < found["cerebellum"] < 1.6e5


def test_left_is_left_and_the_brain_is_symmetric() -> None:
    painted = paint(read_phantom("brain3d"), voxel_size=4.0)
    index = {r.name: r.index for r in painted.regions}
    for part in ("thalamus", "caudate", "putamen", "hippocampus"):
        left = nib.affines.apply_affine(painted.affine, np.argwhere(painted.labels == index[f"left-{part}"]))
        right = nib.affines.apply_affine(painted.affine, np.argwhere(painted.labels == index[f"right-{part}"]))
        assert left[:, 0].max() < 0 < right[:, 0].min()
        np.testing.assert_allclose(left.mean(0) * [-1, 1, 1], right.mean(0), atol=1e-9)


def test_a_turned_ellipsoid_has_its_volume_place_and_axes(tmp_path: Path) -> None:
    painted = paint(described(BALL, tmp_path), voxel_size=1.0)
    inside = nib.affines.apply_affine(painted.affine, np.argwhere(painted.labels == 3))
    assert len(inside) == pytest.approx(4 / 3 * math.pi * 20 * 15 * 10, rel=0.01)
    np.testing.assert_allclose(inside.mean(0), [0, 5, 0], atol=1e-9)
    np.testing.assert_allclose(inside.max(0) - inside.min(0), [29, 39, 19], atol=1.1)


def test_fractions_fill_the_border_in_parts() -> None:
    painted = paint(read_phantom("brain2d"), subsamples=4)
    total = painted.fractions.sum(-1)
    assert total.max() == pytest.approx(1.0)
    assert 0 < np.count_nonzero((total > 0.01) & (total < 0.99)) < 0.2 * total.size
    hard = paint(read_phantom("brain2d"))
    np.testing.assert_array_equal(hard.fractions.sum(-1) > 0, hard.mask)


def test_values_go_to_the_voxels_of_their_region() -> None:
    painted = paint(read_phantom("brain2d"))
    spread = painted.map_of(np.array([1.0, 2.0, 3.0, 4.0, 5.0]))
    np.testing.assert_array_equal(spread, painted.labels)


def test_a_grid_can_be_given_instead() -> None:
    painted = paint(read_phantom("brain2d"), grid=(32, 56))
    assert painted.labels.shape == (32, 56, 1)
    assert painted.voxel_size[:2] == (7.0, 4.0)


def test_voxels_that_lose_a_region_are_refused() -> None:
    with pytest.raises(InputError, match=r"leave no voxel for .*lesion"):
        paint(read_phantom("brain2d"), voxel_size=40.0)


@pytest.mark.parametrize("bad", [{"voxel_size": 0.0}, {"voxel_size": math.nan}, {"grid": (4, 4, 4)}, {"grid": (0, 4)}])
def test_impossible_grids_are_refused(bad: dict) -> None:
    with pytest.raises(InputError):
        paint(read_phantom("brain2d"), **bad)


def test_a_grid_beyond_memory_is_refused_before_it_is_made() -> None:
    with pytest.raises(InputError, match="too large"):
        paint(read_phantom("brain3d"), voxel_size=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("radii = [20.0, 15.0, 10.0]", "radii = [20.0, -15.0, 10.0]"), "greater than 0"),
        (("radii = [20.0, 15.0, 10.0]", "radii = [20.0, 15.0]"), "needs 3 numbers"),
        (("angles = [0.0, 0.0, 90.0]", "angles = [90.0]"), "angle"),
        (("index = 3", "index = 0"), "no region has an index above 0"),
        (('tissue = "any"', ""), "names no tissue"),
        (("index = 3", 'index = 3\ncolour = "red"'), "Extra inputs"),
        (("[[region]]", "[[regio"), "not a TOML file"),
    ],
)
def test_a_wrong_file_says_what_is_wrong(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        described(BALL.replace(*change), tmp_path)
    assert "\n" not in str(error.value)
    assert "own.toml" in str(error.value)


def test_unknown_phantoms_name_the_known_ones() -> None:
    assert set(phantom_names()) >= {"brain2d", "brain3d"}
    with pytest.raises(InputError, match=r"choose one of .*brain3d"):
        read_phantom("brain4d")
    with pytest.raises(InputError, match=r"--roi 7.*5 \(brain2d\), 16 \(brain3d\)"):
        phantom_with(7)
    with pytest.raises(InputError, match=r"none\.toml: the phantom cannot be read"):
        read_phantom("none.toml")


def test_an_installed_package_reads_its_own_copy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    packaged = tmp_path / "catalogue"
    shutil.copytree(catalogue_folder(), packaged)
    monkeypatch.setattr(reading, "_PACKAGED", packaged)
    monkeypatch.setattr(reading, "_IN_REPOSITORY", tmp_path / "nowhere")
    assert catalogue_folder() == packaged
    assert len(read_phantom("brain3d").regions) == 16
    monkeypatch.setattr(reading, "_PACKAGED", tmp_path / "nowhere")
    with pytest.raises(InputError, match="own phantoms are missing"):
        read_phantom("brain3d")
