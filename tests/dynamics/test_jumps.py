"""State-triggered jumps against event loops solved by hand, and their gradients."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
import scipy.integrate
import torch
from torch import Tensor

from petkin.dynamics import Adaptive, FixedStep, Jump, Parameter, ParameterSet, PiecewiseLinear, System, solve
from petkin.errors import NumericalError

from .conftest import KNOTS, forcing_named

D = torch.float64
WALL = 5.0


def fall(t: Tensor, x: Tensor, u: Tensor | None, p: Tensor) -> Tensor:
    return torch.stack([x[..., 1], -p[..., 0]], dim=-1)


def bounce(t: Tensor, x: Tensor, p: Tensor) -> Tensor:
    return torch.stack([x[..., 0], -p[..., 1] * x[..., 1]], dim=-1)


FLOOR = Jump("floor", lambda t, x, p: x[..., 0], bounce)
BALL = System(
    "ball",
    ("height", "speed"),
    ParameterSet((Parameter("G", "m/s2", 9.81, 0, 20), Parameter("e", "", 0.8, 0, 1))),
    fall,
    (1.0, 0.0),
    (FLOOR,),
)


def box_field(t: Tensor, x: Tensor, u: Tensor | None, p: Tensor) -> Tensor:
    """x = (x, y, vx, vy), gravity of size p0 in the direction p1."""
    pull = torch.stack([torch.cos(p[..., 1]), torch.sin(p[..., 1])], dim=-1)
    return torch.cat([x[..., 2:], p[..., :1] * pull], dim=-1)


def box_wall(axis: int, sign: float) -> Jump:
    flip = torch.ones(4, dtype=D)
    flip[2 + axis] = -1.0
    return Jump(
        f"wall {'xy'[axis]}{sign:+g}", lambda t, x, p: WALL - sign * x[..., axis], lambda t, x, p: x * flip.to(x)
    )


BOX = System(
    "ball in a box",
    ("x", "y", "vx", "vy"),
    ParameterSet((Parameter("G", "", 2.0, 0, 5), Parameter("direction", "rad", 0.3, -4, 4))),
    box_field,
    (0.0, 0.0, 1.0, 1.0),
    tuple(box_wall(axis, sign) for axis in (0, 1) for sign in (1.0, -1.0)),
)


def parabola_between_walls(x: float, v: float, a: float, times: list[float]) -> tuple[list[float], list[float]]:
    """Positions at the times and hit times of one axis: quadratics from wall to wall."""
    now, hits, found = 0.0, [], []
    for t in times:
        while True:
            waits = []
            for wall in (WALL, -WALL):
                roots = np.roots([0.5 * a, v, x - wall]) if a else np.array([(wall - x) / v])
                outward = [r.real for r in roots if abs(r.imag) < 1e-12 and (v + a * r.real) * wall > 0]
                waits += [r for r in outward if r > 1e-10]
            wait = min(waits, default=math.inf)
            if now + wait > t:
                break
            x, v, now = math.copysign(WALL, x + v * wait + 0.5 * a * wait**2), -(v + a * wait), now + wait
            hits.append(now)
        x, v, now = x + v * (t - now) + 0.5 * a * (t - now) ** 2, v + a * (t - now), t
        found.append(x)
    return found, hits


@pytest.mark.parametrize(
    "method", [FixedStep(0.1), FixedStep(3.0), Adaptive(step=0.25)], ids=("fine", "coarse", "adaptive")
)
def test_a_bouncing_ball_hits_when_the_parabola_does(method: FixedStep | Adaptive) -> None:
    """Falls from 1 m, keeps 0.8 of its speed a bounce: hits at T (1 + 2 e + 2 e^2 + ...), T = sqrt(2 / G)."""
    first = math.sqrt(2.0 / 9.81)
    expected = [first * (1 + 2 * sum(0.8**k for k in range(1, n))) for n in range(1, 8)]
    end = 0.5 * (expected[-1] + expected[-1] + 2 * first * 0.8**7)
    found = solve(BALL, torch.tensor([end], dtype=D), method=method)
    np.testing.assert_allclose(found.hits.time.numpy(), expected, rtol=1e-12)
    top = 0.5 * 9.81 * (first * 0.8**7) ** 2
    np.testing.assert_allclose(found.states[0].numpy(), [top, 0.0], atol=1e-10)
    assert found.hits.element.tolist() == [0] * 7


def random_balls(count: int) -> tuple[Tensor, Tensor]:
    rng = np.random.default_rng(7)
    start = np.column_stack([rng.uniform(-4.5, 4.5, (count, 2)), rng.uniform(-9, 9, (count, 2))])
    gravity = np.column_stack([rng.uniform(0.2, 5, count), rng.uniform(-3, 3, count)])
    return torch.from_numpy(start), torch.from_numpy(gravity)


@pytest.mark.parametrize("method", [FixedStep(0.25), FixedStep(1.0)], ids=("fine", "coarse"))
def test_balls_in_a_box_follow_their_parabolas(method: FixedStep) -> None:
    """A batch, each element with its own walls and times; in a coarse step several hits follow each other."""
    start, gravity = random_balls(20)
    t = torch.linspace(0, 5, 11, dtype=D)
    found = solve(BOX, t, method=method, parameters=gravity, initial=start)
    most = 0
    for i, ((x, y, vx, vy), (g, phi)) in enumerate(zip(start.tolist(), gravity.tolist())):
        of_x, hits_x = parabola_between_walls(x, vx, g * math.cos(phi), t.tolist())
        of_y, hits_y = parabola_between_walls(y, vy, g * math.sin(phi), t.tolist())
        np.testing.assert_allclose(found.states[i, :, 0].numpy(), of_x, atol=1e-9)
        np.testing.assert_allclose(found.states[i, :, 1].numpy(), of_y, atol=1e-9)
        mine = found.hits.element == i
        np.testing.assert_allclose(found.hits.time[mine].numpy(), sorted(hits_x + hits_y), atol=1e-10)
        most = max(most, int(mine.sum()))
    assert most >= 6


def test_a_batch_equals_a_loop() -> None:
    start, gravity = random_balls(4)
    t = torch.linspace(0, 4, 5, dtype=D)
    whole = solve(BOX, t, method=FixedStep(0.5), parameters=gravity.reshape(2, 2, 2), initial=start.reshape(2, 2, 4))
    for i in range(4):
        one = solve(BOX, t, method=FixedStep(0.5), parameters=gravity[i], initial=start[i])
        torch.testing.assert_close(whole.states[i // 2, i % 2], one.states, rtol=1e-12, atol=1e-12)
        torch.testing.assert_close(whole.hits.time[whole.hits.element == i], one.hits.time, rtol=1e-12, atol=0)
        assert whole.hits.jump[whole.hits.element == i].tolist() == one.hits.jump.tolist()


def test_gradients_pass_through_several_bounces() -> None:
    """Of states and of hit times, with respect to initial state and parameters, against finite differences."""
    start = torch.tensor([[1.0, 0.3], [0.4, -1.0]], dtype=D, requires_grad=True)
    p = torch.tensor([[9.81, 0.8], [5.0, 0.9]], dtype=D, requires_grad=True)

    def end(start, p):
        found = solve(BALL, torch.tensor([0.7, 2.0], dtype=D), method=FixedStep(0.25), initial=start, parameters=p)
        assert found.hits.time.numel() == 6
        return found.states, found.hits.time

    assert torch.autograd.gradcheck(end, (start, p), rtol=1e-5, atol=1e-6)


def test_gradient_of_a_hit_time_in_closed_form() -> None:
    height = torch.tensor(1.3, dtype=D, requires_grad=True)
    G = torch.tensor(9.81, dtype=D, requires_grad=True)
    start, p = torch.stack([height, torch.zeros((), dtype=D)]), torch.stack([G, torch.ones((), dtype=D)])
    found = solve(BALL, torch.tensor([0.6], dtype=D), method=FixedStep(0.2), initial=start, parameters=p)
    by_height, by_G = torch.autograd.grad(found.hits.time[0], (height, G))
    first = math.sqrt(2 * 1.3 / 9.81)
    assert float(found.hits.time[0].detach()) == pytest.approx(first, rel=1e-13)
    assert float(by_height) == pytest.approx(first / (2 * 1.3), rel=1e-10)
    assert float(by_G) == pytest.approx(-first / (2 * 9.81), rel=1e-10)


def test_gradients_in_a_box_with_two_hits_in_one_step() -> None:
    start = torch.tensor([3.0, -2.0, 9.0, 7.0], dtype=D, requires_grad=True)
    p = torch.tensor([2.0, 0.4], dtype=D, requires_grad=True)

    def end(start, p):
        found = solve(BOX, torch.tensor([4.0], dtype=D), method=FixedStep(2.0), initial=start, parameters=p)
        assert found.hits.time.numel() >= 5
        return found.states

    assert torch.autograd.gradcheck(end, (start, p), rtol=1e-5, atol=1e-6)


def hard_pendulum() -> System:
    """A pendulum with a stop at 0.3 rad: neither the flow nor the guard is a polynomial."""

    def field(t: Tensor, x: Tensor, u: Tensor | None, p: Tensor) -> Tensor:
        return torch.stack([x[..., 1], -p[..., 0] * torch.sin(x[..., 0])], dim=-1)

    stop = Jump("stop", lambda t, x, p: torch.sin(0.3 - x[..., 0]), lambda t, x, p: x * x.new_tensor([1.0, -0.9]))
    return System(
        "pendulum", ("angle", "speed"), ParameterSet((Parameter("w2", "", 4.9, 0, 9),)), field, (-1.4, 0.0), (stop,)
    )


@pytest.mark.parametrize("method", [FixedStep(0.02), Adaptive(1e-11, 1e-12, 0.2)], ids=("fixed", "adaptive"))
def test_a_pendulum_with_a_stop_against_an_event_loop(method: FixedStep | Adaptive) -> None:
    def event(t: float, x: np.ndarray) -> float:
        return 0.3 - x[0]

    event.terminal, event.direction = True, -1  # type: ignore[attr-defined]
    now, state, hits = 0.0, np.array([-1.4, 0.0]), []
    while True:
        leg = scipy.integrate.solve_ivp(
            lambda t, x: [x[1], -4.9 * np.sin(x[0])], (now, 5.0), state, "DOP853", rtol=1e-12, atol=1e-13, events=event
        )
        now, state = leg.t[-1], leg.y[:, -1]
        if leg.status == 0:
            break
        hits.append(now)
        state = np.array([0.3, -0.9 * state[1]])
    found = solve(hard_pendulum(), torch.tensor([5.0], dtype=D), method=method)
    assert len(hits) >= 3
    np.testing.assert_allclose(found.hits.time.numpy(), hits, atol=3e-8)
    np.testing.assert_allclose(found.states[0].numpy(), state, atol=3e-7)


def test_gradients_of_a_pendulum_with_a_stop() -> None:
    start = torch.tensor([-1.4, 0.2], dtype=D, requires_grad=True)
    p = torch.tensor([4.9], dtype=D, requires_grad=True)

    def end(start, p):
        found = solve(
            hard_pendulum(), torch.tensor([1.3], dtype=D), method=FixedStep(0.04), initial=start, parameters=p
        )
        return found.states, found.hits.time

    assert torch.autograd.gradcheck(end, (start, p), rtol=1e-4, atol=1e-5)


def counting(rate: float, guard: Callable, reset: Callable) -> System:
    return System(
        "clockwork",
        ("x",),
        ParameterSet((Parameter("rate", "", rate, 0, 9),)),
        lambda t, x, u, p: p.expand(x.shape),
        (0.0,),
        (Jump("tick", guard, reset),),
    )


def test_a_reset_may_throw_the_state_elsewhere() -> None:
    """A saw tooth: x' = 1.25, back to 0 at 1; three teeth in one step."""
    saw = counting(1.25, lambda t, x, p: 1.0 - x[..., 0], lambda t, x, p: torch.zeros_like(x))
    found = solve(saw, torch.tensor([1.0, 2.5, 6.0], dtype=D), method=FixedStep(2.5))
    np.testing.assert_allclose(found.hits.time.numpy(), [0.8, 1.6, 2.4, 3.2, 4.0, 4.8, 5.6], rtol=1e-13)
    np.testing.assert_allclose(found.states[:, 0].numpy(), [0.25, 0.125, 0.5], atol=1e-12)


def test_a_guard_of_time_alone_is_a_dose() -> None:
    dose = counting(0.0, lambda t, x, p: 2.5 - t + 0.0 * x[..., 0], lambda t, x, p: x + 3.0)
    found = solve(dose, torch.tensor([2.4, 2.6, 9.0], dtype=D), method=FixedStep(1.0))
    np.testing.assert_allclose(found.states[:, 0].numpy(), [0.0, 3.0, 3.0])
    np.testing.assert_allclose(found.hits.time.numpy(), [2.5], rtol=1e-13)


@pytest.mark.parametrize("step", [0.3, 2.0])
def test_a_kick_that_lets_the_state_pass_fires_once_a_crossing(step: float) -> None:
    """x'' = -x; every fall through zero adds 1/2 to the size of the speed; the guard is not left, only passed."""
    kick = Jump("kick", lambda t, x, p: x[..., 0], lambda t, x, p: x - x.new_tensor([0.0, 0.5]))
    system = System(
        "swing",
        ("x", "v"),
        ParameterSet((Parameter("w", "", 1.0, 0, 2),)),
        lambda t, x, u, p: torch.stack([x[..., 1], -p[..., 0] * x[..., 0]], dim=-1),
        (1.0, 0.0),
        (kick,),
    )
    t = torch.tensor([6 * math.pi], dtype=D)
    found = solve(system, t, method=Adaptive(1e-11, 1e-12, step))
    np.testing.assert_allclose(found.hits.time.numpy(), [math.pi * (0.5 + 2 * n) for n in range(3)], atol=1e-8)
    np.testing.assert_allclose(found.states[0].numpy(), [2.5, 0.0], atol=1e-7)


def test_two_walls_at_the_same_moment() -> None:
    """Into the corner: both walls are hit, one right after the other, and neither is passed."""
    start = torch.tensor([[2.0, 2.0, 3.0, 3.0], [2.0, 1.0, 3.0, 4.0], [2.0, 2.0, 3.0, 3.0 + 1e-13]], dtype=D)
    p = torch.tensor([0.0, 0.0], dtype=D)
    for step in (0.3, 0.7, 4.0):
        found = solve(BOX, torch.tensor([3.0], dtype=D), method=FixedStep(step), parameters=p, initial=start)
        expected = torch.tensor([[-1.0, -1.0, -3.0, -3.0], [-1.0, -3.0, -3.0, -4.0], [-1.0, -1.0, -3.0, -3.0]], dtype=D)
        torch.testing.assert_close(found.states[:, 0], expected, rtol=0, atol=1e-11)
        np.testing.assert_allclose(found.hits.time.numpy(), np.ones(6), atol=1e-12)


def test_many_corners_and_no_escape() -> None:
    """Rounding decides which wall of a corner comes first and may put the state beyond the other: both are hit."""
    rng = np.random.default_rng(3)
    speed, wait = rng.uniform(0.5, 9.0, (300, 2)), rng.uniform(0.05, 0.9, (300, 1))
    start = torch.from_numpy(np.concatenate([WALL - speed * wait, speed], axis=1))
    p = torch.zeros(2, dtype=D)
    found = solve(BOX, torch.tensor([1.0], dtype=D), method=FixedStep(1.0), parameters=p, initial=start)
    expected = np.concatenate([WALL - speed * (1.0 - wait), -speed], axis=1)
    np.testing.assert_allclose(found.states[:, 0].numpy(), expected, atol=1e-11)


def two_guards(second: Jump, start: tuple[float, float]) -> System:
    """x' = v; at t = 0.5 the speed turns round; and a second jump."""
    turn = Jump("turn", lambda t, x, p: 0.5 - t + 0.0 * x[..., 0], lambda t, x, p: x * x.new_tensor([1.0, -1.0]))
    none = ParameterSet((Parameter("a", "", 0.0, 0, 1),))
    drift: Callable = lambda t, x, u, p: torch.stack([x[..., 1], 0.0 * x[..., 1]], dim=-1)  # noqa: E731
    return System("two guards", ("x", "v"), none, drift, start, (turn, second))


def test_a_guard_is_armed_by_where_the_state_was_not_by_where_it_would_have_gone() -> None:
    """Without the turn x would rise through zero within the step and arm the second guard; with it, it never does."""
    second = Jump("fall", lambda t, x, p: x[..., 0], lambda t, x, p: x + 100.0)
    for step in (0.1, 2.0):
        found = solve(two_guards(second, (-1.0, 1.0)), torch.tensor([2.0], dtype=D), method=FixedStep(step))
        assert found.hits.jump.tolist() == [0]
        np.testing.assert_allclose(found.states[0].numpy(), [-2.0, -1.0], atol=1e-12)


def test_a_reset_through_another_guard_fires_it_at_once() -> None:
    """At t = 0.5 the turn throws x from 1.5 to 1.5 - 4: through the guard at 0, which adds 10."""
    system = two_guards(
        Jump("fall", lambda t, x, p: x[..., 0], lambda t, x, p: x + x.new_tensor([10.0, 0.0])), (1.0, 1.0)
    )
    throw = Jump("throw", system.jumps[0].guard, lambda t, x, p: x - x.new_tensor([4.0, 0.0]))
    system = System(system.name, system.states, system.parameters, system.field, (1.0, 1.0), (throw, system.jumps[1]))
    found = solve(system, torch.tensor([2.0], dtype=D), method=FixedStep(1.0))
    np.testing.assert_allclose(found.hits.time.numpy(), [0.5, 0.5], rtol=1e-13)
    np.testing.assert_allclose(found.states[0].numpy(), [9.0, 1.0], rtol=1e-13)


def test_a_hit_exactly_at_an_output_time_is_reported_after_the_jump() -> None:
    start, p = torch.tensor([2.0, 0.0, 3.0, 0.0], dtype=D), torch.tensor([0.0, 0.0], dtype=D)
    for step in (0.25, 1.0):
        found = solve(BOX, torch.tensor([1.0, 2.0], dtype=D), method=FixedStep(step), parameters=p, initial=start)
        assert found.hits.time.tolist() == pytest.approx([1.0])
        torch.testing.assert_close(found.states[:, 0], torch.tensor([5.0, 2.0], dtype=D))
        torch.testing.assert_close(found.states[:, 2], torch.tensor([-3.0, -3.0], dtype=D))


@pytest.mark.parametrize(("peak", "hits"), [(WALL - 1e-4, 0), (WALL + 1e-2, 1)])
def test_a_near_miss_is_no_hit_and_a_graze_is_one(peak: float, hits: int) -> None:
    """A throw against gravity whose top lies just below or above the wall, inside one step."""
    start, p = (
        torch.tensor([[0.0, 0.0, math.sqrt(2 * 2.0 * peak), 0.0]], dtype=D),
        torch.tensor([2.0, math.pi], dtype=D),
    )
    found = solve(BOX, torch.tensor([3.0], dtype=D), method=FixedStep(0.5), parameters=p, initial=start)
    assert found.hits.time.numel() == hits
    exact, _ = parabola_between_walls(0.0, float(start[0, 2]), -2.0, [3.0])
    assert float(found.states[0, 0, 0]) == pytest.approx(exact[0], abs=1e-9)


def test_jumps_under_a_batch_of_forcings() -> None:
    """x' = u - k x with a reset at 4: with steps u the charge times are logarithms."""
    fire = Jump("fire", lambda t, x, p: 4.0 - x[..., 0], lambda t, x, p: torch.zeros_like(x))
    system = System(
        "charge",
        ("x",),
        ParameterSet((Parameter("k", "", 0.5, 0, 1),)),
        lambda t, x, u, p: u[..., None] - p * x if u is not None else x,
        (0.0,),
        (fire,),
    )
    knots = torch.tensor([0.0, 3.0, 3.0], dtype=D)
    levels = torch.tensor([[4.0, 4.0, 6.0], [1.0, 1.0, 5.0], [2.5, 2.5, 2.5]], dtype=D)
    p = torch.tensor([0.5], dtype=D)
    method = FixedStep(0.02)
    found = solve(
        system, torch.tensor([4.3], dtype=D), method=method, parameters=p, forcing=PiecewiseLinear(knots, levels)
    )

    def charge(x: float, u: float) -> float:
        return math.log((u - 0.5 * x) / (u - 0.5 * 4.0)) / 0.5

    first = charge(0.0, 4.0)
    left = 8.0 * (1 - math.exp(-0.5 * (3.0 - 2 * first)))
    expected = {0: [first, 2 * first, 3.0 + charge(left, 6.0)], 1: [], 2: [charge(0.0, 2.5)]}
    expected[1] = [3.0 + charge(2.0 * (1 - math.exp(-1.5)), 5.0)]
    for i in range(3):
        np.testing.assert_allclose(found.hits.time[found.hits.element == i].numpy(), expected[i], rtol=1e-8)


def test_single_precision() -> None:
    start, gravity = random_balls(10)
    t = torch.linspace(0, 5, 6, dtype=D)
    double = solve(BOX, t, method=FixedStep(0.1), parameters=gravity, initial=start)
    single = solve(BOX, t, method=FixedStep(0.1), parameters=gravity.float(), initial=start.float())
    assert single.states.dtype == torch.float32
    assert len(single.hits.time) == len(double.hits.time)
    torch.testing.assert_close(single.states[..., :2].double(), double.states[..., :2], rtol=0, atol=2e-4)


@pytest.mark.parametrize("method", [FixedStep(0.1), FixedStep(2.0)], ids=("fine", "coarse"))
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_endless_hits_are_refused(method: FixedStep, dtype: torch.dtype) -> None:
    """With half the speed a bounce the ball rests at 3 T; only the second element gets there before the end."""
    p = torch.tensor([[0.5, 0.5], [9.81, 0.5]], dtype=dtype)
    with pytest.raises(
        NumericalError, match=r"Element \(1,\) hits 'floor' again and again near t = 1\.3[45]"
    ) as caught:
        solve(BALL, torch.tensor([1.8], dtype=D), method=method, parameters=p)
    assert "pile up" in str(caught.value)


def test_a_ball_at_rest_on_the_floor_is_refused() -> None:
    with pytest.raises(NumericalError, match=r"'floor'.*t = "):
        solve(BALL, torch.tensor([1.0], dtype=D), method=FixedStep(0.1), initial=torch.zeros(2, dtype=D))
    stuck = Jump("floor", FLOOR.guard, lambda t, x, p: torch.zeros_like(x))
    dead = System(BALL.name, BALL.states, BALL.parameters, fall, (1.0, 0.0), (stuck,))
    with pytest.raises(NumericalError, match=r"Element \(\) .*'floor'.* t = 0\.45"):
        solve(dead, torch.tensor([1.0], dtype=D), method=FixedStep(0.1))


def test_jumps_between_the_kinks_of_a_forcing() -> None:
    """Driven through jumps of its own and of the forcing, against a loop of the same equation by scipy."""
    forcing, curve, _ = forcing_named("straight lines")
    fire = Jump("fire", lambda t, x, p: 20.0 - x[..., 0], lambda t, x, p: 0.25 * x)
    system = System(
        "charge",
        ("x",),
        ParameterSet((Parameter("k", "", 0.2, 0, 1),)),
        lambda t, x, u, p: u[..., None] - p * x if u is not None else x,
        (0.0,),
        (fire,),
    )
    found = solve(system, torch.tensor([9.5], dtype=D), method=FixedStep(0.05), forcing=forcing)

    def event(t: float, x: np.ndarray) -> float:
        return 20.0 - x[0]

    event.terminal, event.direction = True, -1  # type: ignore[attr-defined]
    x, hits = 0.0, []
    for low, high in itertools.pairwise([*np.unique([k for k in KNOTS if k < 9.5]), 9.5]):
        now = low
        while now < high:
            inside = lambda t, low=low, high=high: float(curve(np.clip(t, low + 1e-12, high - 1e-12)))  # noqa: E731
            leg = scipy.integrate.solve_ivp(
                lambda t, y, inside=inside: [inside(t) - 0.2 * y[0]],
                (now, high),
                [x],
                rtol=1e-11,
                atol=1e-12,
                events=event,
            )
            now, x = leg.t[-1], leg.y[0, -1]
            if leg.status == 1:
                hits.append(now)
                x = 5.0
    assert len(hits) >= 5
    np.testing.assert_allclose(found.hits.time.numpy(), hits, atol=1e-7)
    np.testing.assert_allclose(float(found.states[0, 0]), x, rtol=1e-6)
