"""Contrasts of an image: what they must not see, and the slopes that motion goes by."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from petkin.diagnosis import Family
from petkin.imaging import FrameSchedule, Leg, Motion
from petkin.study.diagnosis.drawing import Predicted
from petkin.study.diagnosis.fields import views_of
from petkin.study.diagnosis.moving import moves
from petkin.study.diagnosis.picture import Picture, Voxels
from petkin.study.diagnosis.scene import Scene, _slope, drifts
from petkin.study.diagnosis.spatial import _contrasts
from petkin.study.diagnosis.voxel_noise import VoxelNoise

from .moving_boxes import ALIKE, APART, blurred_regions, photographed

REGIONS, FRAMES, EACH = 3, 8, 30
EDGE, FINER = 2.0, 4


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


def with_edges_within_voxels() -> tuple[Voxels, np.ndarray]:
    """Noise-free voxels that hold a share of the next region's curve, as large as it comes, and weights that see it."""
    rng = np.random.default_rng(8)
    levels = np.stack([a * np.exp(-np.arange(FRAMES) / b) for a, b in ((10.0, 4.0), (20.0, 9.0), (35.0, 20.0))])
    place = np.repeat(np.arange(REGIONS), EACH)
    share = rng.uniform(0.0, 0.4, place.size)[:, None]
    curves = (1.0 - share) * levels[place] + share * levels[(place + 1) % REGIONS]
    inside, courses = np.ones((REGIONS, EACH, 1), bool), np.linalg.svd(levels, full_matrices=False)[2]
    grain = VoxelNoise(np.ones(FRAMES), np.ones((1, 1, 1)), place.reshape(inside.shape) + 1)
    seen = (curves @ courses.T).reshape(*inside.shape, -1)
    picture = Picture(
        curves.T.astype(np.float32), place, inside, (slice(None),) * 3, (2.0,) * 3, 0.0, courses, seen, grain
    )
    fit: Any = SimpleNamespace(values=levels)
    voxels = Voxels(picture, fit, np.ones_like(levels), np.zeros((REGIONS, FRAMES, 2)))
    voxels.__dict__["_common"] = np.ones(FRAMES)
    return voxels, voxels.centred(share[:, 0] + 0.1 * rng.standard_normal(place.size))


def test_edges_that_run_within_voxels_are_nuisance() -> None:
    """What a still image gives a contrast is a mixture of the regions' curves, and no larger than is allowed for."""
    voxels, weights = with_edges_within_voxels()
    rows, there = voxels.beside(weights), voxels.there(weights)
    assert np.linalg.norm(rows) > 10.0
    family = Family.of(rows, there[:0], np.eye(REGIONS), 1e-9).holding(there, times=1.0)
    columns = family.nuisance.reshape(-1, *rows.shape)
    for r in range(REGIONS):
        mine = columns[np.abs(columns[:, r]).max(axis=1) > 0, r].T
        covariance = mine @ mine.T + 1e-6 * np.eye(FRAMES)
        assert rows[r] @ np.linalg.solve(covariance, rows[r]) < 3.0 * REGIONS


def in_a_row(seed: int) -> Voxels:
    """Three regions side by side, of noise that is a fifth of their values; the picture is the mean of the frames, what
    is drawn has no noise."""
    rng, count = np.random.default_rng(seed), REGIONS * EACH
    levels = np.outer([10.0, 20.0, 35.0], np.ones(FRAMES)) / np.sqrt(FRAMES)
    place, inside = np.repeat(np.arange(REGIONS), EACH), np.ones((1, count, 1), bool)
    curves = levels[place] * (1.0 + 0.2 * rng.standard_normal((count, FRAMES)))
    courses = np.ones((1, FRAMES)) / np.sqrt(FRAMES)
    grain = VoxelNoise(np.ones(FRAMES), np.ones((1, 1, 1)), place.reshape(inside.shape) + 1)
    seen = (curves @ courses.T).reshape(*inside.shape, 1)
    picture = Picture(
        curves.T.astype(np.float32), place, inside, (slice(None),) * 3, (2.0,) * 3, 0.0, courses, seen, grain
    )
    fit: Any = SimpleNamespace(values=levels)
    voxels = Voxels(picture, fit, 0.2 * levels, np.zeros((REGIONS, FRAMES, 2)), drawn=levels[place] @ courses.T)
    voxels.__dict__["_common"] = np.ones(FRAMES)
    return voxels


def test_what_weighs_the_voxels_shares_no_noise_with_the_frames() -> None:
    """By a picture that is a mean of these frames, gains of regions off the middle would see its noise in each of them,
    all of one sign."""
    gains, fields = [], []
    for seed in range(150):
        voxels = in_a_row(seed)
        tilt = next(c for c in _contrasts(Scene(voxels)) if c.family == "gain 1")
        gains.append(voxels.beside(tilt.weights).mean(axis=1))
        (along, *_) = views_of(voxels, {}, least=1e-6)
        fields.append(along.rows.mean(axis=1))
    for means in (np.array(gains), np.array(fields)):
        spread = np.maximum(means.std(axis=0), 1e-9)
        assert (np.abs(means.mean(axis=0)) < 4.0 * spread / np.sqrt(len(means))).all()


def test_a_drift_may_begin_and_end_during_the_scan() -> None:
    frames = FrameSchedule.uniform(30, 2.0)
    courses = drifts(frames)
    begun = [float(frames.mid[np.flatnonzero(course > 0)[0]]) for course in courses]
    ended = [float(frames.mid[np.argmax(course)]) for course in courses]
    assert all((np.diff(course) >= 0).all() and course[0] < 0.1 and course[-1] > 0.9 for course in courses)
    assert {round(b / 20.0) for b in begun} == {0, 1, 2}
    assert {round(e / 20.0) for e in ended} == {1, 2, 3}


def test_a_turn_changes_the_image_as_its_contrast_says() -> None:
    """Per mm at the edge of the labels, as far as a small turn is linear."""
    count, edge = 24, 3.0
    x, y = (edge * (np.indices((count, count, 3))[a] - (count - 1) / 2) for a in range(2))

    def image(angle: float) -> np.ndarray:
        """Two blobs off the middle, turned from the first axis to the second."""
        u, v = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
        return np.exp(-((u - 12.0) ** 2 + v**2) / 200.0) + 0.5 * np.exp(-((u + 5.0) ** 2 + (v - 15.0) ** 2) / 300.0)

    inside = np.zeros(x.shape, bool)
    inside[3:-3, 3:-3] = True
    labels = inside.astype(np.intp)
    place, levels = np.zeros(inside.sum(), np.intp), np.ones((1, FRAMES))
    picture = Picture(
        np.ones((FRAMES, place.size), np.float32),
        place,
        inside,
        (slice(None),) * 3,
        (edge,) * 3,
        0.0,
        np.ones((1, FRAMES)) / np.sqrt(FRAMES),
        image(0.0)[..., None],
        VoxelNoise(np.ones(FRAMES), np.ones((1, 1, 1)), labels),
    )
    fit: Any = SimpleNamespace(values=levels)
    contrasts = _contrasts(Scene(Voxels(picture, fit, levels, np.zeros((1, FRAMES, 2)))))
    contrast = next(c for c in contrasts if c.family == "motion 3")
    furthest = np.hypot(x[inside], y[inside]).max()
    expected = (image(0.5 / furthest) - image(-0.5 / furthest))[inside]
    np.testing.assert_allclose(contrast.maps[:, 0], expected, atol=0.01 * np.abs(expected).max())
    assert contrast.axis == 3


@pytest.mark.parametrize("way", range(6))
@pytest.mark.parametrize(("far", "within"), [(4.0, 0.1), (-1.5, 0.15), (0.0, 0.0), (2.5, 0.05), (-7.0, 0.05)])
def test_what_motion_adds_to_regions_is_what_a_moved_picture_shows(way: int, far: float, within: float) -> None:
    """Nearly, also between the ways that are tried; in half of a frame half of it."""
    voxels, image = blurred_regions(APART, photographed())
    inside, means = voxels.inside, voxels.fit.values
    expected = np.stack(
        [(photographed(Leg(way, far)) - image)[inside][voxels.place == r].mean(axis=0) for r in range(3)]
    )
    motion = Motion(way, np.full(FRAMES, far), np.linspace(0.0, 1.0, FRAMES))
    found = np.einsum("krs,sk->rk", moves(voxels).by(motion), means)
    largest = np.abs(expected).max()
    assert (largest > 0.01) == (far != 0.0)
    np.testing.assert_allclose(found, motion.share * expected, atol=within * largest + 1e-9)


def test_a_slice_moves_within_its_plane_alone() -> None:
    flat = voxels_of(np.ones(FRAMES))
    seen = np.random.default_rng(3).random(flat.picture.seen.shape)
    voxels = replace(flat, picture=replace(flat.picture, seen=seen))
    assert voxels.inside.shape[2] == 1
    assert set(Scene(voxels).motions) == {0, 1, 3}
    assert moves(voxels).ways == (0, 1, 3)


def still() -> Voxels:
    """Those regions with what is drawn from their labels."""
    voxels, _ = blurred_regions(ALIKE)
    voxels.__dict__["_common"] = np.ones(FRAMES)
    return replace(voxels, drawn=Predicted.of(voxels).seen(8.0)[voxels.inside])


def test_a_still_picture_behind_a_point_spread_is_the_one_drawn_from_its_labels() -> None:
    """In every contrast, to a fiftieth of the largest: without it, still edges look like gaps."""
    voxels = still()
    contrasts = _contrasts(Scene(voxels))
    largest = max(np.linalg.norm(voxels.sums(c.weights)) for c in contrasts)
    for contrast in contrasts:
        assert np.linalg.norm(voxels.beside(contrast.weights)) < 0.02 * largest
