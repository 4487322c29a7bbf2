"""Moving bodies: two solvers agree, a missing law is named, and what one flight cannot tell is said."""

from __future__ import annotations

import json
from importlib.resources import files

import jsonschema
import numpy as np
import pytest

from petkin.errors import InputError
from petkin_bench.gaps import BODIES, MovingBodies, find_body, withheld
from petkin_bench.gaps.moving import Body

SCHEMA = json.loads((files("petkin.reporting") / "schemas" / "gap-report-1.json").read_text())


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
def test_the_engines_steps_agree_with_an_adaptive_solver(body: Body) -> None:
    for name in ("damping_linear", "restitution", "drag_quadratic", "frame_rate"):
        if name not in {h.name for h in body.hypotheses}:
            continue
        term = withheld.effect_at(body, name, 0.5)
        start, shared = withheld.drawn_start(body, np.random.default_rng(2))
        points = withheld.seen(
            body.points(withheld.run(body, start, shared, {name: term})), body.interval, {name: term}
        )
        exact = np.moveaxis(points, 0, -1).reshape(1, -1)
        steps = MovingBodies(body, exact).predict(start[None], shared, (term,))
        assert np.abs(steps - exact).max() < 2e-3


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
def test_a_start_can_be_read_off_the_picture(body: Body) -> None:
    start, shared = withheld.drawn_start(body, np.random.default_rng(3))
    points = body.points(withheld.run(body, start, shared, {}))
    assert body.start(points, body.interval) == pytest.approx(start, abs=0.5)


def test_a_pendulums_damping_is_named() -> None:
    answer = withheld.one_case(find_body("pendulum"), "damping_linear=0.3", trials=2, noise=0.01, seed=1)
    jsonschema.validate(answer, SCHEMA)
    assert any("damping_linear" in label for label in answer["verdict"]["set"])
    assert answer["where"]["stages"][0]["stage"] == "dynamics"


def test_one_flight_cannot_split_tilt_wind_and_roll() -> None:
    """Gravity turned, a steady wind and a camera turned: the same parabola."""
    body = withheld.single_flight(find_body("bouncing_ball"))
    answer = withheld.one_case(body, "gravity_tilt=0.5", trials=1, noise=0.003, seed=4)
    assert {"gravity_tilt", "wind", "camera_roll"} <= set("+".join(answer["verdict"]["set"]).split("+"))
    assert answer["verdict"]["kind"] == "ambiguous"


def test_names_that_are_not_there() -> None:
    with pytest.raises(InputError, match="choose one of pendulum, mass_spring, bouncing_ball"):
        find_body("yo-yo")
    with pytest.raises(InputError, match="pendulum has no effect 'wind'"):
        withheld.one_case(find_body("pendulum"), "wind", trials=1, noise=0.01, seed=0)
