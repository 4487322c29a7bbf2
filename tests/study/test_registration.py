"""How a picture has moved, told by laying what labels and curves predict onto every frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from petkin.imaging import FrameObservation, FrameSchedule, Leg, origins
from petkin.study.diagnosis.drawing import drawn_of
from petkin.study.diagnosis.gone import DRIFT, STEP, Gone, Undone
from petkin.study.diagnosis.moving import apart
from petkin.study.diagnosis.picture import Voxels
from petkin.study.diagnosis.registration import registered

from .moving_boxes import APART, EDGE, FRAMES, blurred_regions, boxes, photographed

SIZE = (EDGE,) * 3
CLOCK = FrameObservation(FrameSchedule(10.0 * np.arange(FRAMES), 10.0 * np.arange(1, FRAMES + 1)), 0.0)
NOISE = 0.5


def seen(legs_of_frames: list[tuple[Leg, ...]], gain: np.ndarray | None = None) -> Voxels:
    """Noisy voxels of boxes that lay so in every frame, and were so bright."""
    voxels, _ = blurred_regions(APART, photographed())
    frames = np.stack([photographed(*legs)[..., k] for k, legs in enumerate(legs_of_frames)])
    curves = frames[:, voxels.inside] * (1.0 if gain is None else gain)
    noisy = curves + NOISE * np.random.default_rng(3).standard_normal(curves.shape)
    return replace(voxels, picture=replace(voxels.picture, curves=noisy.astype(np.float32)))


def at_once(frame: int, *legs: Leg) -> list[tuple[Leg, ...]]:
    return [() if k < frame else legs for k in range(FRAMES)]


def found_in(voxels: Voxels) -> Gone | None:
    still, _ = blurred_regions(APART, photographed())
    return registered(voxels, drawn_of(still), CLOCK)


@pytest.mark.parametrize(("way", "far"), [(0, 5.0), (1, -8.0), (2, 6.0), (3, 6.0), (4, -7.0)])
def test_a_step_is_found_with_its_way_time_and_size(way: int, far: float) -> None:
    found = found_in(seen(at_once(5, Leg(way, far))))
    assert found is not None
    assert (found.name, found.way, found.setting) == (STEP, way, {"axis": way, "onset": 50.0})
    assert found.mm == pytest.approx(far, abs=1.0)
    assert found.beside == ()


@pytest.mark.parametrize(("way", "far"), [(0, 6.0), (2, -9.0), (4, 8.0)])
def test_a_drift_is_told_from_a_step(way: int, far: float) -> None:
    course = CLOCK.frames.mid / CLOCK.frames.end[-1]
    found = found_in(seen([(Leg(way, round(far * part, 2)),) for part in course]))
    assert found is not None
    assert (found.name, found.way) == (DRIFT, way)
    assert found.mm == pytest.approx(far, rel=0.2)
    assert max(log for _, log in found.told[DRIFT]) > max(log for _, log in found.told[STEP]) + 3.0


def test_a_step_within_a_frame_is_half_in_it() -> None:
    before, after = (np.stack([photographed(*legs)[..., k] for k in range(FRAMES)]) for legs in ((), (Leg(1, 6.0),)))
    share = np.array([0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0])[:, None, None, None]
    voxels = seen(at_once(FRAMES))
    curves = ((1.0 - share) * before + share * after)[:, voxels.inside].astype(np.float32)
    found = found_in(replace(voxels, picture=replace(voxels.picture, curves=curves)))
    assert found is not None
    assert found.setting["onset"] == 35.0
    assert list(found.course) == list(share.ravel())


def test_a_way_along_two_axes_is_found_whole() -> None:
    found = found_in(seen(at_once(4, Leg(1, 6.0), Leg(0, 3.0))))
    assert found is not None
    assert found.way == 1
    (beside,) = found.beside
    assert beside.way == 0
    assert beside.far == pytest.approx(0.5, abs=0.15)


@pytest.mark.parametrize("kind", ["nothing", "brighter", "less than a voxel"])
def test_what_has_not_gone_far_is_left_as_it_is(kind: str) -> None:
    gain = np.where(np.arange(FRAMES) < 4, 1.0, 1.3)[:, None] if kind == "brighter" else None
    legs = (Leg(0, 1.0),) if kind == "less than a voxel" else ()
    assert found_in(seen(at_once(4, *legs), gain)) is None


def test_the_way_back_undoes_the_way() -> None:
    gone = Gone(DRIFT, 3, 7.0, np.linspace(0.0, 1.0, FRAMES), beside=(Leg(0, -0.5), Leg(4, 0.3)))
    labelled = boxes() > 0
    at = np.argwhere(labelled).T.astype(float)
    there = origins(at, gone.legs(0.6), SIZE, labelled)
    np.testing.assert_allclose(origins(there, gone.back(0.6), SIZE, labelled), at, atol=1e-9)
    assert gone.most == pytest.approx(7.0 * 1.8)


def test_a_frame_is_laid_back_where_it_was() -> None:
    """In the box, within a twenty-fifth of the brightest; one in which the head moves is where it is for longer."""
    labelled, box = boxes() > 0, (slice(3, 13),) * 3
    gone = Gone(STEP, 1, 5.0, np.array([0.0, 0.4, 0.6, 1.0]), beside=(Leg(0, 0.5),))
    rest, moved = (photographed(*legs)[..., 3].astype(np.float32) for legs in ((), gone.legs()))
    undone = Undone.of(gone, labelled, box, SIZE, (4, 4, 4))
    assert undone(moved, 0) is moved
    assert undone(moved, 1) is moved
    for k in (2, 3):
        laid = undone(moved, k)
        np.testing.assert_allclose(laid[box], rest[box], atol=0.04 * rest.max())
        assert np.array_equal(np.delete(laid, np.s_[3:13], 0), np.delete(moved, np.s_[3:13], 0))


@pytest.mark.parametrize("name", [STEP, DRIFT])
def test_voxels_less_what_a_long_way_adds_are_those_at_rest(name: str) -> None:
    """And regions are expected to hold what they do while it is there."""
    course = np.clip(np.arange(FRAMES) - 2.0, 0.0, 4.0) / 4.0 if name == DRIFT else np.arange(FRAMES) > 3
    gone = Gone(name, 2, 6.0, course.astype(float))
    every = [photographed(*gone.legs(float(part)))[..., k] for k, part in enumerate(gone.course)]
    voxels, image = blurred_regions(APART, photographed())
    curves = np.stack(every)[:, voxels.inside].astype(np.float32)
    voxels = replace(voxels, picture=replace(voxels.picture, curves=curves), gone=gone)
    moving, still = apart(voxels, gone)
    rest = image[voxels.inside]
    left = np.abs(still.picture.curves.T - rest)
    assert left.max() < 0.12 * np.abs(curves.T - rest).max()
    np.testing.assert_allclose(moving.expected, voxels.means, atol=0.05 * np.abs(voxels.means - still.means).max())
