"""What is beyond names: nothing of what the catalogue holds, and most of what it does not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from petkin_bench.withheld.beyond import Catalogued, beyond
from petkin_bench.withheld.cases import case
from petkin_bench.withheld.causes import KNOWN, Cause, draw
from petkin_bench.withheld.changes import course, scanner, step_course
from petkin_bench.withheld.classes import class_of, columns_of
from petkin_bench.withheld.making import Made, Scene, scaled
from petkin_bench.withheld.observe import Change, observe
from petkin_bench.withheld.subject import Subject, draw_subject
from petkin_bench.withheld.visibility import Simulator, cosines, perpendicular, seen

BY_NAME = {cause.name: cause for cause in KNOWN}


@pytest.fixture(scope="module")
def subject() -> Subject:
    return draw_subject(np.random.default_rng(4), 3)


def scene_of(subject: Subject) -> Scene:
    return Scene(np.random.default_rng(5), subject, Simulator(), 1.0, 0.0)


@pytest.fixture(scope="module")
def made(subject: Subject) -> Callable[..., Made]:
    def make(cause: Cause, target: float = 8.0) -> Made:
        rng = np.random.default_rng(6)
        tried = (scaled(scene_of(subject), cause, draw(rng, subject), target) for _ in range(30))
        return next(found for found in tried if found is not None)

    return make


def left_of(made: Made) -> float:
    return beyond(made, scene_of(made.subject).law(made.values))


@pytest.mark.parametrize(
    "name", ["gain_step", "attenuation_mismatch", "frame_duration", "flow_change", "randoms_offset"]
)
def test_nothing_of_a_catalogued_effect_is_beyond(made: Callable[..., Made], name: str) -> None:
    assert left_of(made(BY_NAME[name])) < 0.5


def test_nothing_of_two_is_beyond(made: Callable[..., Made], subject: Subject) -> None:
    one, other = (made(BY_NAME[name]) for name in ("gain_step", "attenuation_mismatch"))
    values = observe(subject, (one.change, other.change))
    both = replace(one, values=values, seen=scene_of(subject).seen(values))
    assert both.seen.detectability > 6.0
    assert left_of(both) < 1.0


def test_a_step_of_k4_is_a_change_of_k2_for_good(made: Callable[..., Made]) -> None:
    """Weak effects one region at a time say that much of it is beyond names; in all regions at once nothing is."""
    step = made(Cause("", "tissue", course(step_course, 3), 0.95, onset=True))
    scene = scene_of(step.subject)
    linear = perpendicular(step.seen.left, [c for _, c in columns_of(scene, step, finely=True)])
    found = left_of(step)
    assert found < 0.5 * linear
    assert found < 2.0


def test_what_nothing_explains_is_beyond(made: Callable[..., Made]) -> None:
    waves = Cause(
        "", "imaging", scanner(lambda x, f, s, d: x * (1 + s * np.sin(2.2 * np.sqrt(f.mid) + d.weights[0]))), 0.6
    )
    found = made(waves)
    assert 0.3 * found.seen.detectability < left_of(found) <= found.seen.detectability


def lacking(subject: Subject, simulator: Simulator, name: str) -> Made:
    values = observe(subject)
    noise = scene_of(subject).law(values)
    part = Cause(name, "input", lambda size, drawn: Change(), 1.0)
    drawn = draw(np.random.default_rng(6), subject)
    return Made(part, drawn, 1.0, Change(), subject, simulator, values, seen(values, simulator, subject, noise), 1.0)


@pytest.mark.parametrize("late", [-0.3, 0.2])
def test_a_large_delay_is_a_clock_that_is_off(subject: Subject, late: float) -> None:
    """Though a template of a second is not."""
    made = lacking(replace(subject, delay=late), Simulator(delay=False), "arterial_delay")
    noise, scene = scene_of(subject).law(made.values), replace(scene_of(subject), simulator=made.simulator)
    columns = columns_of(scene, made)
    alike = cosines(np.stack([made.seen.left, *(c for name, c in columns if name == "frame_offset")], axis=1))[0, 1:]
    assert made.seen.detectability > 10.0
    assert alike.max() < 0.95
    assert "frame_offset" in class_of(made, noise, columns)
    assert "dispersion" not in class_of(made, noise, columns)


def test_blood_in_the_regions_is_no_clock(subject: Subject) -> None:
    made = lacking(subject, Simulator(blood_volume=False), "blood_volume")
    assert made.seen.detectability > 6.0
    assert "frame_offset" not in class_of(made, scene_of(subject).law(made.values), [("x", made.seen.left)])


@pytest.mark.parametrize("name", ["time_varying_kinetics", "attenuation_mismatch", "parent_fraction", "flow_change"])
def test_slopes_are_those_of_the_values(subject: Subject, name: str) -> None:
    cause = BY_NAME[name]
    drawn = replace(draw(np.random.default_rng(7), subject), sign=1.0)
    sizes = np.array([0.1, 0.15, 0.2]) if cause.local else np.array([0.1])
    effect = Catalogued(cause, drawn, sizes, float(subject.frames.end[-1]))
    slopes = effect.slopes(subject, (), (), observe(subject, (effect.change(),)))
    assert len(slopes) == effect.coordinates
    for k, slope in enumerate(slopes):
        step = 0.1 * np.eye(len(slopes))[k]
        up, down = (observe(subject, (effect.moved(by).change(),)) for by in (step, -step))
        reference = (up - down) / 0.2
        assert np.abs(reference).max() > 0
        assert np.abs(slope - reference).max() < 0.2 * np.abs(reference).max()


def test_the_answer_of_an_unknown_cause_says_what_is_beyond() -> None:
    """Scans are as they were: only what is told of them goes by the refit."""
    found = [case("training", 37, index)[1] for index in (182, 140)]
    assert [answer.kind for answer in found] == ["unknown", "unknown"]
    assert all(answer.perpendicular < 2.0 < answer.detectability for answer in found)
