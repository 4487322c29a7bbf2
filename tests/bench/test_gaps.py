"""Moving bodies: two solvers agree, a missing law is named, and what one flight cannot tell is said."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from typer.testing import CliRunner

from petkin.diagnosis import Term
from petkin.errors import InputError
from petkin_bench.cli import app
from petkin_bench.gaps import BODIES, MovingBodies, find_body, runs
from petkin_bench.gaps.moving import Body, travelled
from petkin_bench.gaps.moving import seen as camera
from petkin_bench.gaps.rigid_body import rotated
from petkin_bench.withheld.bodies.rigs import RIGS

REPORT = "sub-pendulum_desc-gap_report.json"
SCHEMA = json.loads((files("petkin.reporting") / "schemas" / "gap-report-1.json").read_text())


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
def test_two_mechanics_agree_on_every_effect(body: Body) -> None:
    """The diagnosis and the generator of the blind check have other coordinates, solvers and laws of their own."""
    rig = RIGS[body.name]
    starts, parameters = rig.drawn(np.random.default_rng(2), 3)
    every = np.tile(parameters, (3, 1))
    places = np.moveaxis(rig.seen(starts, every, {}), 1, -1).reshape(3, -1)
    for hypothesis in body.hypotheses:
        if hypothesis.name == "exposure_blur":
            continue  # the generator's shutter opens at the clock, the product's about it: see below
        term = runs.effect_at(body, hypothesis.name, 0.5)
        # dry friction fades near standstill as x / sqrt(x^2 + soft^2) there: as much in all as tanh(x / 0.02)
        kit = {hypothesis.name: float(term.amplitude), **term.setting, "soft": 0.02 * np.log(2.0)}
        exact = MovingBodies(body, np.moveaxis(rig.seen(starts, every, kit), 1, -1).reshape(places.shape)).samples
        predicted = MovingBodies(body, places).predict(_states(body, starts), parameters, (term,))
        bound = 1.5e-3 if hypothesis.name == "damping_coulomb" else 1e-5
        np.testing.assert_allclose(predicted, exact, atol=bound)


def test_what_a_shaking_camera_moves_is_told_from_the_points_own_noise() -> None:
    rng, body = np.random.default_rng(4), find_body("rigid_body")
    own, shared = 0.01 * rng.standard_normal((3, 4, 2, 45)), 0.02 * rng.standard_normal((3, 1, 2, 45))
    simulator = MovingBodies(body, (own + shared).reshape(3, -1))
    spread = simulator.spread(simulator.samples).reshape(3, 4, 2, 45)
    assert spread[:, 1:].max() == spread.min() == 1.0
    assert spread[0, 0, 0, 0] == pytest.approx(np.sqrt(1.0 + 4 * 2.0**2), rel=0.2)
    np.testing.assert_allclose(simulator.places(simulator.samples), simulator.data, atol=1e-12)


def test_a_shutter_averages_about_the_middle_of_its_time() -> None:
    rig, share = RIGS["pendulum"], 0.6
    starts, parameters = rig.drawn(np.random.default_rng(2), 2)
    every = np.tile(parameters, (2, 1))
    blurred = rig.seen(starts, every, {"exposure_blur": share})
    clock = (np.arange(rig.frames) + 0.5 * share) * rig.interval
    sharp = rig.picture(rig.places(starts, every, {}, clock))
    body = find_body("pendulum")
    term = {"exposure_blur": Term(next(h for h in body.hypotheses if h.name == "exposure_blur"), share, {})}
    change = np.abs(blurred - sharp)[:, 2:-2].max()
    wrong = np.abs(blurred - camera(sharp, body.interval, term))[:, 2:-2].max()
    assert change > 3e-4
    assert wrong < 0.1 * change


def one_case(body: Body, effect: str, *, trials: int, noise: float, seed: int) -> dict[str, Any]:
    data = runs.one_effect(body, effect, trials=trials, noise=noise, seed=seed)
    return runs.answer_about(body, data, seed=seed)[1]


def _states(body: Body, starts: np.ndarray) -> np.ndarray:
    """Of a spring, the generator has the middle of its masses and how far they are apart."""
    if body.name != "mass_spring":
        return starts
    middle, apart = starts[:, ::2], 0.5 * starts[:, 1::2]
    return np.stack([middle + apart, middle - apart], axis=2).reshape(len(starts), -1)


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
def test_a_start_can_be_read_off_the_picture(body: Body) -> None:
    rig, rng = RIGS[body.name], np.random.default_rng(3)
    starts, parameters = rig.drawn(rng, 6)
    for points, start in zip(rig.seen(starts, np.tile(parameters, (6, 1)), {}), _states(body, starts), strict=True):
        assert body.begun(points)[0] == pytest.approx(start, abs=1.2)


def test_a_ball_that_falls_back_beyond_a_wall_was_thrown_back_there() -> None:
    """It would turn round by itself within the step; exactly, it leaves the wall as fast as it came."""
    body, pull, rise, begin = find_body("bouncing_ball"), 10.0, 0.1, np.sqrt(2.05)
    start = np.array([[0.0, body.wall - rise, 0.0, begin]])
    found = travelled(replace(body, frames=4), start, np.array([pull]), {})[0, 3, 1]
    speed = np.sqrt(begin**2 - 2.0 * pull * rise)
    since = 3 * body.interval - (begin - speed) / pull
    assert found == pytest.approx(body.wall - speed * since - 0.5 * pull * since**2, abs=1e-9)


def test_a_pendulums_damping_is_named() -> None:
    answer = one_case(find_body("pendulum"), "damping_linear=0.3", trials=2, noise=0.01, seed=1)
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
    answer = one_case(find_body(system), f"{effect}=0.5", trials=3, noise=0.005, seed=7)
    chosen = answer["verdict"]["set"]
    assert {effect, *alike} & set(chosen[0].split("+"))
    assert any(effect in label.split("+") for label in chosen)


def test_a_turn_follows_its_rate() -> None:
    """The rotation vector under a constant spin about a slanted axis is the matrix exponential."""
    body = find_body("rigid_body")
    turn, spin = np.array([0.3, -0.5, 0.4]), np.array([0.7, 0.2, -0.9])
    state, rate = np.concatenate([np.zeros(3), turn]), np.empty(6)
    for _ in range(1000):
        body.rate(state, np.concatenate([np.zeros(3), spin]), rate)
        state = state + 1e-3 * rate
    corner = np.array([1.0, -0.4, 0.2])
    expected = rotated(spin, rotated(turn, corner))
    np.testing.assert_allclose(rotated(state[3:], corner), expected, atol=2e-3)


def test_energy_stays_in_the_double_pendulum() -> None:
    body = find_body("double_pendulum")
    (start,), shared = RIGS["double_pendulum"].drawn(np.random.default_rng(1), 1)
    nothing, faster = body.sizes({}), np.empty(2)

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        body.law(t, y[:2], y[2:], shared, nothing, faster)
        return np.concatenate([y[2:], faster])

    first, second, fast, late = solve_ivp(rate, (0.0, 4.0), start, rtol=1e-9, atol=1e-10).y
    moving = fast**2 + 0.5 * late**2 + fast * late * np.cos(first - second)
    energy = moving - shared[0] / 1.5 * (2.0 * np.cos(first) + np.cos(second))
    assert np.ptp(energy) < 1e-6 * np.ptp(moving)


def test_one_flight_cannot_split_tilt_wind_and_roll() -> None:
    """Gravity turned, a steady wind and a camera turned: the same parabola."""
    body = runs.single_flight(find_body("bouncing_ball"))
    answer = one_case(body, "gravity_tilt=0.5", trials=1, noise=0.003, seed=4)
    assert {"gravity_tilt", "wind", "camera_roll"} <= set("+".join(answer["verdict"]["set"]).split("+"))
    assert answer["verdict"]["kind"] == "ambiguous"


def test_runs_that_are_written_are_read_again(tmp_path: Path) -> None:
    body = find_body("mass_spring")
    data = runs.one_effect(body, "mass_ratio=0.5", trials=2, noise=0.01, seed=3)
    path = tmp_path / "runs.csv"
    path.write_text(runs.written_runs(body, data))
    short = "".join(line for line in path.read_text().splitlines(True) if line.split(",")[1] not in ("48", "49"))
    (tmp_path / "short.csv").write_text(short)
    again, places = runs.read_runs(path, body)
    assert again == body
    np.testing.assert_array_equal(places, data)
    fewer, places = runs.read_runs(tmp_path / "short.csv", body)
    assert fewer.frames == 48
    np.testing.assert_array_equal(places.reshape(2, 4, 48), data.reshape(2, 4, 50)[..., :48])
    assert MovingBodies(fewer, places).predict(_states(body, data[:, :4]), np.array([10.0])).shape == (2, 4 * 48)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "cannot be read as a table"),
        ("trial,frame,x,y\n1,0,0,0\n", "has no column point; it needs trial, frame, point, x, y"),
        ("trial,frame,point,x,y\n1,0,1,0,0\n1,1,1,nowhere,0\n", "row 3 holds something that is no number"),
        ("trial,frame,point,x,y\n1,0,1,0,0\n1,1,1,0,0\n2,0,1,0,0\n", "every point once in each of its 2 frames"),
        ("trial,frame,point,x,y\n1,0,1,0,0\n1,0,1,0,0\n", "every point once in each of its 1 frames"),
        ("trial,frame,point,x,y\n1,0,1,0,0\n1,1,1,0,0\n", "needs 1 points a frame, and 16 frames or more"),
    ],
)
def test_runs_that_cannot_be_read(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "runs.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        runs.read_runs(tmp_path / "runs.csv", find_body("pendulum"))


def test_names_that_are_not_there() -> None:
    with pytest.raises(InputError, match="one of pendulum, mass_spring, bouncing_ball, double_pendulum, rigid_body"):
        find_body("yo-yo")
    with pytest.raises(InputError, match="pendulum has no effect 'wind'"):
        one_case(find_body("pendulum"), "wind", trials=1, noise=0.01, seed=0)


def test_the_command_writes_runs_that_it_reads_again(tmp_path: Path) -> None:
    out, asked = tmp_path / "out", ["diagnose", "--system", "pendulum"]
    made = CliRunner().invoke(app, [*asked, "--effect", "damping_quadratic=0.1", "--out", str(out)])
    again = CliRunner().invoke(
        app, [*asked, "--runs", str(out / "sub-pendulum_runs.csv"), "--out", str(tmp_path / "own")]
    )
    assert made.output == again.output
    assert made.output.startswith("Damping quadratic of 0.")
    page = (out / REPORT).with_suffix(".html").read_text()
    assert made.output.strip() in page
    assert page.count("<img ") == 2 + 6 + 1
    assert "<script" not in page
    first, second = (json.loads((folder / REPORT).read_text()) for folder in (out, tmp_path / "own"))
    jsonschema.validate(first, SCHEMA)
    assert {k: v for k, v in first.items() if k != "provenance"} == {
        k: v for k, v in second.items() if k != "provenance"
    }
    both = CliRunner().invoke(app, [*asked, "--runs", "x.csv", "--effect", "torque"])
    assert isinstance(both.exception, InputError)
    assert str(both.exception) == "--runs and --effect: give one of them."
