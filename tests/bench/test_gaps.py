"""Moving bodies: two solvers agree, a missing law is named, and what one flight cannot tell is said."""

from __future__ import annotations

import json
from importlib.resources import files

import jsonschema
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from petkin.errors import InputError
from petkin_bench.gaps import BODIES, MovingBodies, find_body, withheld
from petkin_bench.gaps.moving import Body
from petkin_bench.gaps.rigid_body import rotated

SCHEMA = json.loads((files("petkin.reporting") / "schemas" / "gap-report-1.json").read_text())


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
def test_the_engines_steps_agree_with_an_adaptive_solver(body: Body) -> None:
    for name in ("damping_linear", "restitution", "drag_quadratic", "frame_rate", "mass_ratio", "force_elevation"):
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


@pytest.mark.parametrize(
    ("system", "effect", "alike"),
    [
        ("double_pendulum", "mass_ratio", ()),
        ("double_pendulum", "damping_coulomb", ("damping_linear", "damping_quadratic")),
        ("double_pendulum", "gravity_tilt", ("camera_roll",)),
        ("rigid_body", "force_elevation", ()),
        ("rigid_body", "spin_damping", ()),
        ("mass_spring", "mass_ratio", ()),
    ],
)
def test_what_was_put_in_is_in_the_set(system: str, effect: str, alike: tuple[str, ...]) -> None:
    """Itself, or what looks the same in these runs, comes first; itself is in the set."""
    answer = withheld.one_case(find_body(system), f"{effect}=0.5", trials=3, noise=0.005, seed=7)
    chosen = answer["verdict"]["set"]
    assert {effect, *alike} & set(chosen[0].split("+"))
    assert any(effect in label.split("+") for label in chosen)


def test_a_turn_follows_its_rate() -> None:
    """The rotation vector under a constant spin about a slanted axis is the matrix exponential."""
    body = find_body("rigid_body")
    turn, spin = np.array([0.3, -0.5, 0.4]), np.array([0.7, 0.2, -0.9])
    state = np.concatenate([np.zeros(3), turn])
    for _ in range(1000):
        state = state + 1e-3 * body.rate(state, np.concatenate([np.zeros(3), spin]))
    corner = np.array([1.0, -0.4, 0.2])
    expected = rotated(spin, rotated(turn, corner))
    np.testing.assert_allclose(rotated(state[3:], corner), expected, atol=2e-3)


def test_energy_stays_in_the_double_pendulum() -> None:
    body = find_body("double_pendulum")
    start, shared = withheld.drawn_start(body, np.random.default_rng(1))

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[2:], body.law(t, y[:2], y[2:], shared, {})])

    first, second, fast, faster = solve_ivp(rate, (0.0, 4.0), start, rtol=1e-9, atol=1e-10).y
    moving = fast**2 + 0.5 * faster**2 + fast * faster * np.cos(first - second)
    energy = moving - shared[0] / 1.5 * (2.0 * np.cos(first) + np.cos(second))
    assert np.ptp(energy) < 1e-6 * np.ptp(moving)


def test_one_flight_cannot_split_tilt_wind_and_roll() -> None:
    """Gravity turned, a steady wind and a camera turned: the same parabola."""
    body = withheld.single_flight(find_body("bouncing_ball"))
    answer = withheld.one_case(body, "gravity_tilt=0.5", trials=1, noise=0.003, seed=4)
    assert {"gravity_tilt", "wind", "camera_roll"} <= set("+".join(answer["verdict"]["set"]).split("+"))
    assert answer["verdict"]["kind"] == "ambiguous"


def test_names_that_are_not_there() -> None:
    with pytest.raises(InputError, match="one of pendulum, mass_spring, bouncing_ball, double_pendulum, rigid_body"):
        find_body("yo-yo")
    with pytest.raises(InputError, match="pendulum has no effect 'wind'"):
        withheld.one_case(find_body("pendulum"), "wind", trials=1, noise=0.01, seed=0)
