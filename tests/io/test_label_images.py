from __future__ import annotations

from pathlib import Path

import nibabel
import numpy as np
import pytest

from petkin.errors import InputError
from petkin.io.labels import Dseg, find_dseg, read_regions
from petkin.io.nifti import Series, open_series

PET = "sub-01/pet/sub-01_pet.nii.gz"
DSEG = "derivatives/segmented/sub-01/pet/sub-01_seg-atlas_dseg.nii.gz"


@pytest.fixture
def series(study: Path) -> Series:
    return open_series(study / PET)


def other(study: Path, labels: np.ndarray, affine: np.ndarray) -> Dseg:
    path = study / "other_dseg.nii.gz"
    nibabel.save(nibabel.Nifti1Image(labels, affine), path)
    return find_dseg(path)


def test_names_come_from_the_table_and_volumes_from_the_grid(study: Path, series: Series) -> None:
    regions = read_regions(find_dseg(study / DSEG), series)
    assert (regions.seg, regions.index, regions.names) == ("atlas", (1, 7), ("cortex", "label-7"))
    np.testing.assert_allclose(regions.volumes, [8 * 12, 2 * 12])  # voxels of 2 x 2 x 3 mm
    assert regions.labels[0].tolist() == np.ones((4, 2)).tolist()


def test_names_that_two_labels_share_stay_apart(study: Path, series: Series) -> None:
    (study / DSEG.replace("nii.gz", "tsv")).write_text("index\tname\n1\tcortex\n7\tcortex\n")
    assert read_regions(find_dseg(study / DSEG), series).names == ("cortex-1", "cortex-7")


def test_another_shape_is_refused(study: Path, series: Series) -> None:
    with pytest.raises(InputError, match=r"other_dseg.nii.gz: is 3 x 4 x 3 voxels but sub-01_pet.nii.gz is 3 x 4 x 2"):
        read_regions(other(study, np.ones((3, 4, 3), np.int16), series.affine), series)


def test_another_place_is_refused(study: Path, series: Series) -> None:
    shifted = series.affine.copy()
    shifted[2, 3] += 1.5
    labels = np.ones((3, 4, 2), np.int16)
    with pytest.raises(InputError, match=r"lies up to 1.5 mm off the grid of sub-01_pet.nii.gz"):
        read_regions(other(study, labels, shifted), series)
    shifted[2, 3] = series.affine[2, 3] + 1e-3
    assert read_regions(other(study, labels, shifted), series).names == ("label-1",)


@pytest.mark.parametrize(
    ("value", "message"),
    [(0.0, "holds no label above 0"), (-1.0, "label -1 is negative"), (1.5, "not integers"), (np.nan, "not integers")],
)
def test_images_that_are_no_segmentation_are_refused(study: Path, series: Series, value: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_regions(other(study, np.full((3, 4, 2), value, np.float32), series.affine), series)


def test_labels_stored_as_floats_are_labels(study: Path, series: Series) -> None:
    dseg = other(study, np.full((3, 4, 2), 2035.0, np.float32), series.affine)
    assert read_regions(dseg, series).index == (2035,)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere.nii.gz: no such file"):
        find_dseg(tmp_path / "nowhere.nii.gz")
