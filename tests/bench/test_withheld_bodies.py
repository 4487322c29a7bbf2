"""Moving bodies of the blind check: their mechanics, strengths, noise, and scores."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ellipk

from petkin.errors import InputError
from petkin_bench.withheld import run as runs
from petkin_bench.withheld.bodies.cases import Scene, film_case, scaled, single
from petkin_bench.withheld.bodies.causes import KNOWN, Cause, other_forms, unknown
from petkin_bench.withheld.bodies.refit import Law, watched
from petkin_bench.withheld.bodies.rigs import RIGS, Rig
from petkin_bench.withheld.bodies.score import body_metrics
from petkin_bench.withheld.classes import named_by_filters
from petkin_bench.withheld.making import BINS
from petkin_bench.withheld.score import Judged, joined

EVERY = [(rig, cause) for rig in RIGS for cause in (*KNOWN[rig], *other_forms("scored", rig), *unknown("scored", rig))]


def scene(system: str, *, sd: float = 0.003, share: float = 0.0, runs: int = 2, seed: int = 5) -> Scene:
    rng, rig = np.random.default_rng(seed), RIGS[system]
    return Scene(rng, rig, *rig.drawn(rng, runs), sd, share)


def test_a_pendulum_comes_back_after_its_period() -> None:
    """T = 4 K(sin^2(phi / 2)) / sqrt(G / L), from rest."""
    rig, begin, pull = RIGS["pendulum"], 1.2, 9.0
    period = 4.0 * ellipk(np.sin(begin / 2.0) ** 2) / np.sqrt(pull / 2.0)
    (places,) = rig.places(np.array([[begin, 0.0]]), np.array([[pull]]), {}, np.array([0.0, period / 2.0, period]))
    np.testing.assert_allclose(places[:, 0], [begin, -begin, begin], atol=1e-6)


def test_a_ball_that_drops_on_a_wall_rises_as_high_as_it_keeps() -> None:
    rig, pull, kept = RIGS["bouncing_ball"], 5.0, 0.8
    height = 4.0
    falls = np.sqrt(2.0 * height / pull)
    rises = kept * np.sqrt(2.0 * pull * height) / pull
    start = np.array([[0.0, height - rig.wall, 0.0, 0.0]])
    (places,) = rig.places(start, np.array([[pull]]), {"restitution": 1.0 - kept}, np.array([0.0, falls + rises]))
    assert places[1, 1] == pytest.approx(kept**2 * height - rig.wall, abs=2e-3)


def test_a_spring_swings_with_the_period_of_its_masses() -> None:
    rig, stiff = RIGS["mass_spring"], 8.0
    period = 2.0 * np.pi / np.sqrt(2.0 * stiff)
    (places,) = rig.places(np.array([[0.3, -7.0, 0.0, 0.0]]), np.array([[stiff]]), {}, np.array([0.0, period]))
    np.testing.assert_allclose(places[1], places[0], atol=1e-5)


@pytest.mark.parametrize(("system", "cause"), EVERY, ids=lambda x: x if isinstance(x, str) else x.knob)
def test_every_cause_changes_the_picture_and_vanishes_with_its_size(system: str, cause: Cause) -> None:
    here = scene(system)
    every = np.tile(here.parameters, (2, 1))
    drawn = cause.draw(here.rng, here.rig)
    nothing, some, none = (
        here.rig.seen(here.starts, every, kit)
        for kit in ({}, cause.kit(0.5 * cause.most, drawn), cause.kit(0.0, drawn))
    )
    if cause.knob == "exposure_blur":  # an open shutter is later, too
        assert np.abs(some - nothing).max() > 1e-4
        return
    assert np.abs(none - nothing).max() < 1e-6
    assert np.abs(some - nothing).max() > 1e-4


@pytest.mark.parametrize("rig", RIGS.values(), ids=lambda rig: rig.name)
def test_without_a_cause_a_refit_leaves_nothing(rig: Rig) -> None:
    here = scene(rig.name)
    seen = watched(rig, here.starts, here.parameters, here.sd, 0.0, {})
    assert seen.detectability < 1e-4
    assert seen.axes.shape[1] == here.starts.size + len(rig.parameters)


def test_a_refit_takes_what_its_parameters_can_do() -> None:
    """Another pull of gravity, or another scale of the clock, is no gap of a pendulum; friction is."""
    here = scene("pendulum")
    clock, friction = (
        watched(here.rig, here.starts, here.parameters, here.sd, 0.0, kit)
        for kit in ({"frame_rate": 0.05}, {"damping_linear": 0.05})
    )
    assert clock.detectability < 1e-3
    assert clock.parameters[0] == pytest.approx(here.parameters[0] * 1.05**2, rel=1e-4)
    assert friction.detectability > 10.0


def test_noise_of_a_picture_that_shakes_is_white_once_whitened() -> None:
    rng, law, frames = np.random.default_rng(3), Law(0.01, 0.6), 4000
    alone, common = rng.standard_normal((1, frames, 4, 2)), rng.standard_normal((1, frames, 1, 2))
    white = law.whiten(0.01 * (np.sqrt(0.4) * alone + np.sqrt(0.6) * common)).reshape(frames, 8)
    np.testing.assert_allclose(np.cov(white.T), np.eye(8), atol=0.09)


def test_a_strength_is_what_was_asked() -> None:
    here = scene("double_pendulum", sd=0.01)
    cause = next(c for c in KNOWN["double_pendulum"] if c.name == "mass_ratio")
    made = scaled(here, cause, {}, 9.0)
    assert made is not None
    again = watched(here.rig, here.starts, here.parameters, here.sd, 0.0, made.kit)
    assert again.detectability == pytest.approx(9.0, rel=0.08)
    quiet = watched(here.rig, here.starts, here.parameters, 0.5 * here.sd, 0.0, made.kit)
    assert quiet.detectability == pytest.approx(2.0 * again.detectability, rel=1e-3)


def test_a_cause_of_no_name_reaches_its_strength_beyond_the_catalogue() -> None:
    here = scene("pendulum", sd=0.003)
    _, made = single(here, unknown("training", "pendulum"), of_unknown=True)
    assert made.seen.detectability >= 0.9 * BINS[0][0]


@pytest.mark.parametrize("index", [0, 4])
def test_the_same_case_has_the_same_bytes_and_noise_of_its_law(index: int) -> None:
    film, answer = film_case("training", 3, index)
    again, _ = film_case("training", 3, index)
    np.testing.assert_array_equal(film.places, again.places)
    assert film.system == list(RIGS)[index]
    assert np.std(film.places - answer.clean) == pytest.approx(answer.percent / 100.0, rel=0.25)
    assert answer.clean.shape == film.places.shape
    assert (answer.kind == "none") == (answer.detectability == 0.0)
    assert all(name in same for name, same in zip(answer.names, answer.classes, strict=True))


def test_splits_have_other_forms_and_causes() -> None:
    for system, rig in RIGS.items():
        for causes in (other_forms, unknown):
            mine, theirs = (
                {(c.knob, *c.draw(np.random.default_rng(1), rig).items()) for c in causes(split, system)}
                for split in ("training", "scored")
            )
            assert not mine & theirs


def test_verdicts_are_resumed_and_scored(tmp_path: Path) -> None:
    plan = runs.Plan("training", 3, 1, 5, 400, system="pendulum")
    verdicts, answers = runs.run(plan, tmp_path)
    first = verdicts.read_text()
    runs.run(plan, tmp_path)
    assert verdicts.read_text() == first
    (case,) = joined(verdicts, answers)
    assert case.cells["system"] == "pendulum"
    assert {m.name for m in body_metrics([case])} >= {"pendulum: CPU s a scan, median"}


CELLS = {
    "system": "pendulum",
    "kind": "known",
    "noise": "iid",
    "names": "torque",
    "classes": "gravity_tilt|torque",
    "stages": "dynamics",
    "detectability": "9",
    "perpendicular": "3",
    "ceiling": "1",
    "frame": "-1",
    "region": "-1",
    "size": "-0.5",
    "verdict": "named",
    "leader": "torque",
    "leader_probability": "0.8",
    "set": "torque",
    "set_probability": "0.9",
    "unknown_probability": "0.05",
    "stage": "dynamics",
    "amplitude": "0.55",
    "amplitude_low": "0.45",
    "amplitude_high": "0.7",
    "closure": "0.9",
    "closure_low": "0.8",
    "closure_high": "1.0",
    "closed": "0.95",
    "seconds": "1",
}


def test_metrics_count_what_each_system_got_right() -> None:
    right = Judged(CELLS)
    wrong = Judged(CELLS | {"leader": "lens_distortion", "set": "lens_distortion"})
    alarm = Judged(CELLS | {"kind": "none", "names": "", "classes": "", "detectability": "0", "system": "rigid_body"})
    found = {m.name: m for m in body_metrics([right, wrong, alarm])}
    assert found["bodies: class first, d' 8-12"].value == 0.5
    assert found["bodies: pendulum: class first, d' >= 6"].value == 0.5
    assert found["bodies: rigid_body: false alarms"].value == 1.0
    assert found["bodies: size within 0.20"].value == 1.0
    assert found["bodies: size's interval holds it"].value == 1.0
    assert "bodies: onset within a frame" not in found
    assert found["bodies: closure interval covers but for 0.01"].value == 1.0
    beyond = body_metrics([Judged(CELLS | {"closure_high": "0.93"}), Judged(CELLS | {"closure_high": "0.945"})])
    assert {m.name: m.value for m in beyond}["pendulum: closure interval covers but for 0.01"] == 0.5


def test_plans_that_make_no_sense() -> None:
    usual = runs.Plan("training", 3, 1, 5, 400, system="bodies")
    assert usual.stem == "withheld_training_seed3_bodies"
    with pytest.raises(InputError, match="give bodies or one of pendulum"):
        replace(usual, system="yo-yo")
    with pytest.raises(InputError, match="--system bodies: leave --images"):
        replace(usual, images=True)


def test_a_matched_filter_names_a_strong_cause_beside_others() -> None:
    axes = 10.0 * np.eye(6)
    columns = [("other", axes[1]), ("third", axes[2])]
    named = [
        named_by_filters(axes[0], "mine", columns, (same,), np.random.default_rng(2)) for same in ("mine", "other")
    ]
    assert named == [1.0, 0.0]
