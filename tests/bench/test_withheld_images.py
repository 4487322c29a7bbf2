"""Image cases of the blind check: the head, the picture, its noise, strengths, files, scores."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import nibabel as nib
import numpy as np
import pytest

from petkin.errors import InputError
from petkin_bench.withheld import run as runs
from petkin_bench.withheld.causes import draw
from petkin_bench.withheld.images import cases, columns, making
from petkin_bench.withheld.images.causes import KNOWN, OTHER_FORMS, PLAIN, UNKNOWN, Cause, Place
from petkin_bench.withheld.images.head import NAMES, Head, Pose, draw_head, painted
from petkin_bench.withheld.images.reader import ideal
from petkin_bench.withheld.images.score import image_metrics
from petkin_bench.withheld.images.study import write_study
from petkin_bench.withheld.images.taking import AS_ALWAYS, Scanned, grain, means, spread_out, taken
from petkin_bench.withheld.score import Judged
from petkin_bench.withheld.subject import Frames, draw_subject
from petkin_bench.withheld.visibility import Simulator


@pytest.fixture(scope="module")
def scanned() -> Scanned:
    rng = np.random.default_rng(6)
    subject = draw_subject(rng, len(NAMES) + 1)
    edges = np.concatenate([[0.0], np.cumsum(cases.FRAMES_S)]) / 60.0
    return Scanned(draw_head(rng), replace(subject, frames=Frames(edges[:-1], edges[1:], subject.frames.decay)), 0.0)


def test_every_region_has_voxels_and_no_label_is_air(scanned: Scanned) -> None:
    labels = scanned.head.labels
    assert all(np.count_nonzero(labels == r + 1) > 40 for r in range(len(NAMES)))
    assert labels[0, 0, 0] == 0


def test_a_head_that_is_moved_by_a_voxel_is_the_shifted_picture(scanned: Scanned) -> None:
    flat = np.ones((len(NAMES) + 1, 2)) * np.arange(1, len(NAMES) + 2)[:, None]
    still = np.zeros((len(NAMES) + 1, 5, 2))
    here = painted(scanned.head, Pose(), flat, still)
    moved = painted(scanned.head, Pose((5.0, 0.0, 0.0)), flat, still)
    np.testing.assert_array_equal(moved[1:], here[:-1])


def test_the_point_spread_has_its_width_and_keeps_the_sum() -> None:
    point = np.zeros((24, 24, 24, 1))
    point[12, 12, 12] = 1.0
    seen = spread_out(point, 12.0)[..., 0]
    assert seen.sum() == pytest.approx(1.0, abs=1e-6)
    assert seen[12 + 1, 12, 12] / seen[12, 12, 12] == pytest.approx(0.5 ** ((5.0 / 6.0) ** 2), rel=0.02)


@pytest.mark.parametrize("cause", [*KNOWN, *OTHER_FORMS["scored"], *UNKNOWN["scored"]], ids=lambda c: c.name or "none")
def test_every_cause_changes_the_picture_and_vanishes_with_its_size(cause: Cause, scanned: Scanned) -> None:
    drawn = draw(np.random.default_rng(2), scanned.subject)
    place = Place(replace(drawn, region=1), 1, scanned.head)
    plain = taken(scanned)
    changed = taken(scanned, cause.build(0.5 * cause.most, place))
    assert np.isfinite(changed).all()
    assert np.abs(changed - plain).max() > 1e-4 * plain.max()
    if cause.name != "dispersion":
        nothing = taken(scanned, cause.build(1e-9, place))
        np.testing.assert_allclose(nothing, plain, rtol=1e-4, atol=1e-5 * plain.max())


def test_noise_is_as_large_as_its_law_and_neighbours_share_it(scanned: Scanned) -> None:
    image = taken(scanned)
    noise = grain(image, scanned.head, scanned.subject.frames, 10.0, 0.0, 0)
    left = (noise.drawn(image, np.random.default_rng(0)) - image) / (noise.m[..., None] * noise.a)
    assert left.std() == pytest.approx(1.0, abs=0.03)
    along = (left[1:] * left[:-1]).mean()
    unit = np.zeros((24, 24, 24))
    unit[12, 12, 12] = 1.0
    assert along == pytest.approx(noise.mixed(unit)[13, 12, 12], abs=0.03)
    assert noise.mixed(unit)[12, 12, 12] == pytest.approx(1.0, abs=0.05)


def test_what_cannot_be_refitted_is_visible(scanned: Scanned) -> None:
    """d' grows with the size of a motion; the scan as it is has none."""
    rng = np.random.default_rng(1)
    scene = making.Scene(rng, replace(scanned, width=6.0), Simulator(), 10.0, 0.0, 0)
    drawn = replace(draw(rng, scanned.subject), onset=25.0)
    place = Place(drawn, 0, scanned.head)
    step = next(c for c in KNOWN if c.name == "motion_step")
    none, small, large = (making.made_of(scene, step, place, size).detectability for size in (0.0, 1.0, 4.0))
    assert none < 0.5
    assert 2.0 * small < large


def test_a_head_that_moves_twice_as_little_changes_half_as_much(scanned: Scanned) -> None:
    """No edge jumps between the points at which voxels are read."""
    sharp = replace(scanned, width=6.0)
    step = next(c for c in KNOWN if c.name == "motion_step")
    place = Place(replace(draw(np.random.default_rng(1), scanned.subject), onset=25.0), 0, scanned.head)
    plain = taken(sharp)
    less, more = (taken(sharp, step.build(size, place)) - plain for size in (0.05, 0.1))
    np.testing.assert_allclose(more, 2.0 * less, atol=1e-9 * plain.max())


def test_nobody_knows_how_kinetics_vary(scanned: Scanned) -> None:
    """What a refit of other rates does to the known pattern of a head's kinetics makes nothing visible."""
    rng = np.random.default_rng(1)
    place = Place(draw(rng, scanned.subject), 0, scanned.head)
    trapping = next(c for c in KNOWN if c.name == "vascular_trapping")

    def visible(head: Head) -> float:
        scene = making.Scene(rng, replace(scanned, head=head), Simulator(), 8.0, 0.0, 0)
        return making.made_of(scene, trapping, place, 0.5 * trapping.most).detectability

    even = replace(scanned.head, waves=0.0 * scanned.head.waves, phases=0.0 * scanned.head.phases + 0.5 * np.pi)
    assert visible(scanned.head) == pytest.approx(visible(even), rel=0.1)


def test_an_edge_that_no_label_tells_hides_small_motion(scanned: Scanned) -> None:
    """A drift by a fiftieth of a voxel is not seen, though it changes all edges of a picture known beforehand."""
    rng = np.random.default_rng(1)
    scene = making.Scene(rng, replace(scanned, width=4.0), Simulator(), 8.0, 0.0, 0)
    drift = next(c for c in KNOWN if c.name == "motion_drift")
    place = Place(draw(rng, scanned.subject), 1, scanned.head)
    assert making.made_of(scene, drift, place, 0.1).detectability < 2.0


def test_a_delay_that_the_simulator_lacks_is_not_refitted(scanned: Scanned) -> None:
    late = replace(scanned, subject=replace(scanned.subject, delay=0.1))
    place = Place(draw(np.random.default_rng(1), late.subject), 0, late.head)
    cause = Cause("arterial_delay", "input", lambda size, place: AS_ALWAYS, 1.5, spatial=False)

    def made(simulator: Simulator) -> making.Made:
        scene = making.Scene(np.random.default_rng(1), late, simulator, 8.0, 0.0, 0)
        return making.made_of(scene, cause, place, 1.0, AS_ALWAYS)

    lacking = made(Simulator(delay=False))
    assert lacking.detectability > 5.0 > 0.1 > made(Simulator()).detectability
    assert "frame_offset" in columns.class_of(lacking, [("gain_step", np.ones_like(lacking.left))])


def test_kinetics_are_refitted_to_a_strong_change_of_the_camera(scanned: Scanned) -> None:
    """A dead time of 0.3 moves kinetics too far for straight lines: a refit leaves next to nothing."""
    dead = next(c for c in PLAIN if c.name == "dead_time")
    scene = making.Scene(np.random.default_rng(1), scanned, Simulator(), 8.0, 0.0, 0)
    made = making.made_of(scene, dead, Place(draw(np.random.default_rng(1), scanned.subject), 0, scanned.head), 0.3)
    camera = dead.build(0.3, made.place).camera
    assert camera is not None
    plain, fitted = (taken(replace(scanned, subject=s), varied=False) for s in (scanned.subject, made.fitted))
    late, changed = scanned.subject.frames.start > 5.0, camera(plain, scanned.subject.frames)
    left, moved = (np.abs(means(changed - other, scanned.head))[:, late].max() for other in (fitted, plain))
    assert left < 0.01 * moved


def test_a_reader_names_what_is_strong_and_says_nothing_where_nothing_is_withheld() -> None:
    made_cases = map(_made_case, (0, 3, 10, 18, 57))
    told = [(answer, ideal(answer, made, split="training", seed=1)) for _, answer, made in made_cases]
    found = [(a, r) for a, r in told if a.kind != "none"]
    shares = [(a.detectability, float(str(r["ideal"])), float(str(r["ideal_claimed"]))) for a, r in found]
    assert {a.kind for a, r in told if r["ideal"] == ""} <= {"none"}
    assert {a.kind for a, _ in found} > {"unknown"}
    assert len(shares) >= 4
    for strength, right, claimed in shares:
        assert 0.2 < claimed <= right <= 1.0
        assert strength < 8.0 or right > 0.95


def _made_case(index: int) -> tuple[cases.ImageScan, cases.ImageAnswer, cases.Made | None]:
    return cases.made_case("training", 68, index)


def test_a_case_follows_from_its_numbers_and_is_a_study(tmp_path: Path) -> None:
    scan, answer = cases.image_case("training", 3, 1)
    again, _ = cases.image_case("training", 3, 1)
    np.testing.assert_array_equal(scan.image, again.image)
    assert answer.kind in ("none", "known", "other form", "plain", "unknown")
    write_study(scan, tmp_path / "study")
    image = nib.load(tmp_path / "study/sub-01/pet/sub-01_pet.nii.gz")
    assert image.shape == scan.image.shape
    sidecar = json.loads((tmp_path / "study/sub-01/pet/sub-01_pet.json").read_text())
    assert len(sidecar["FrameTimesStart"]) == scan.image.shape[3]
    labelled = np.stack([scan.image[scan.labels == r + 1].mean(axis=0) for r in range(len(NAMES))])
    assert (labelled.max(axis=1) > 0).all()
    np.testing.assert_allclose(labelled, means(scan.image, cases_head(scan)), rtol=1e-12)


class cases_head:  # noqa: N801
    """Labels alone, as `means` needs them."""

    def __init__(self, scan: cases.ImageScan) -> None:
        self.labels = scan.labels


def judged(**cells: object) -> Judged:
    usual = {
        "kind": "known", "noise": "iid", "names": "motion_step", "classes": "motion_step", "stages": "imaging",
        "detectability": 8.0, "ceiling": 0.97, "perpendicular": 8.0, "frame": 12, "region": -1, "size": 3.0,
        "verdict": "named", "leader": "motion_step", "leader_probability": 0.9, "set": "motion_step",
        "set_probability": 0.95, "unknown_probability": 0.02, "stage": "imaging", "onset_frame": 13, "regions": "",
        "amplitude": 3.5, "unit": "mm", "seconds": 1.0,
    }  # fmt: skip
    return Judged({name: str(value) for name, value in (usual | cells).items()})


def test_scores_stand_beside_their_bars() -> None:
    wrong = judged(leader="partial_volume", set="partial_volume", onset_frame=-1)
    null = judged(kind="none", names="", classes="", verdict="none", leader="", set="", detectability=0.0)
    found = {m.name: m for m in image_metrics([judged(), wrong, null])}
    assert found["images: class first, d' 6-10"].value == 0.5
    assert found["images: onset of motion within a frame"].value == 1.0
    assert found["images: blur and motion within a quarter of their mm"].value == 1.0
    assert found["images: false alarms, all"].value == 0.0
    assert found["images: unknown: recall"].met is None


def test_images_are_judged_whole(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="leave --without away"):
        runs.Plan("training", 0, 1, 5, 40, "pairs", images=True)
    assert "images" in runs.Plan("training", 0, 1, 5, 40, images=True).stem


def test_an_image_case_has_an_answer_and_a_verdict_of_its_own() -> None:
    answer, verdict = runs.judged(runs.Plan("training", 3, 1, 5, 40, images=True), 0)
    assert set(answer) >= {"kind", "classes", "detectability", "size", "width"}
    assert verdict["verdict"] in ("none", "named", "ambiguous", "unknown")
    assert len(str(verdict["answer_sha256"])) == 64
    image_metrics([Judged({k: str(v) for k, v in (answer | verdict).items()})])
