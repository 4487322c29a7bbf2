"""solve(): order, accuracy, gradients, batches, number types, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.special
import torch

from petkin.dynamics import (
    Adaptive,
    FixedStep,
    Jump,
    Parameter,
    ParameterSet,
    PiecewiseLinear,
    Shifted,
    System,
    solve,
    solve_linear,
)
from petkin.errors import InputError, NumericalError

from .conftest import KNOTS, LEVELS, forcing_named

D = torch.float64
METHODS = (FixedStep(0.01), Adaptive(1e-10, 1e-12))


def swing(t, x, u, p):
    return torch.stack([x[..., 1], -p[..., 0] / p[..., 1] * torch.sin(x[..., 0])], dim=-1)


PENDULUM = System(
    "pendulum",
    ("angle", "speed"),
    ParameterSet((Parameter("G", "m/s2", 9.81, 0, 20), Parameter("L", "m", 2.0, 0.1, 5))),
    swing,
    (1.2, 0.0),
)


def washout(t, x, u, p):
    return p[..., :1] * u[..., None] - p[..., 1:] * x


TISSUE = System(
    "tissue",
    ("C",),
    ParameterSet((Parameter("K", "1/min", 0.3, 0, 1), Parameter("k", "1/min", 0.15, 0, 1))),
    washout,
    (0.0,),
)

LOGISTIC = System(
    "logistic growth",
    ("n",),
    ParameterSet((Parameter("r", "1/d", 0.8, 0, 2), Parameter("cap", "", 5.0, 0, 9))),
    lambda t, x, u, p: p[..., :1] * x * (1 - x / p[..., 1:]),
    (0.5,),
)


@pytest.mark.parametrize("method", METHODS, ids=("fixed", "adaptive"))
def test_a_users_own_equation(method: FixedStep | Adaptive) -> None:
    t = torch.linspace(0, 10, 21, dtype=D)
    found = solve(LOGISTIC, t, method=method)
    expected = 5.0 / (1 + 9.0 * torch.exp(-0.8 * t))
    torch.testing.assert_close(found.states[:, 0], expected, rtol=1e-8, atol=0)
    torch.testing.assert_close(found.times, t)
    assert found.hits.time.numel() == 0


@pytest.mark.parametrize("method", METHODS, ids=("fixed", "adaptive"))
def test_a_pendulum_keeps_its_energy_and_its_period(method: FixedStep | Adaptive) -> None:
    quarter = np.sqrt(2.0 / 9.81) * scipy.special.ellipk(np.sin(0.6) ** 2)
    t = torch.tensor([0.0, quarter, 2 * quarter, 4 * quarter, 12 * quarter], dtype=D)
    state = solve(PENDULUM, t, method=method).states
    energy = 0.5 * 4.0 * state[:, 1] ** 2 - 9.81 * 2.0 * torch.cos(state[:, 0])
    torch.testing.assert_close(energy, energy[:1].expand(5), rtol=1e-8, atol=0)
    expected = torch.tensor([1.2, 0.0, -1.2, 1.2, 1.2], dtype=D)
    torch.testing.assert_close(state[:, 0], expected, rtol=0, atol=2e-7)


def order_of(errors: list[float], steps: list[float]) -> float:
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def test_fixed_steps_converge_with_fourth_order() -> None:
    quarter = float(np.sqrt(2.0 / 9.81) * scipy.special.ellipk(np.sin(0.6) ** 2))
    steps, errors = [quarter / n for n in (8, 12, 16, 24, 32)], []
    for step in steps:
        state = solve(PENDULUM, torch.tensor([4 * quarter], dtype=D), method=FixedStep(step * (1 + 1e-9))).states
        errors.append(float((state - torch.tensor([1.2, 0.0], dtype=D)).abs().max()))
    assert order_of(errors, steps) == pytest.approx(4.0, abs=0.35)


@pytest.mark.parametrize("name", ["straight lines", "late", "exponentials"])
def test_kinks_and_jumps_of_the_forcing_do_not_spoil_the_order(name: str) -> None:
    """Steps that stop at the knots keep order 4; steps across them would drop to 1 at the doubled knots."""
    forcing, _, _ = forcing_named(name)
    t, p = torch.tensor([13.0], dtype=D), torch.tensor([1.0, 0.7], dtype=D)
    exact = float(forcing.response(torch.tensor(0.7, dtype=D), t))
    steps = [0.4, 0.2, 0.1, 0.05]
    found = [solve(TISSUE, t, method=FixedStep(step), parameters=p, forcing=forcing).states for step in steps]
    errors = [abs(float(value) - exact) for value in found]
    assert order_of(errors, steps) > 3.6
    assert errors[-1] < 1e-5 * exact


def test_a_doubled_knot_is_no_kink_to_the_adaptive_method() -> None:
    """The step count, and so the cost, depends on the tolerance alone."""
    forcing, _, _ = forcing_named("straight lines")
    calls = 0

    def counted(t, x, u, p):
        nonlocal calls
        calls += 1
        return washout(t, x, u, p)

    t = torch.tensor([60.0], dtype=D)
    found = solve(replace(TISSUE, field=counted), t, method=Adaptive(1e-8, 1e-10), forcing=forcing).states
    exact = 0.3 * float(forcing.response(torch.tensor(0.15, dtype=D), t))
    assert float(found) == pytest.approx(exact, rel=1e-7)
    assert calls < 900


def test_output_times_in_any_order_and_at_the_start() -> None:
    t = torch.tensor([3.0, 0.0, 1.0, 3.0], dtype=D)
    state = solve(LOGISTIC, t, method=FixedStep(0.02)).states[:, 0]
    sorted_state = solve(LOGISTIC, torch.tensor([0.0, 1.0, 3.0], dtype=D), method=FixedStep(0.02)).states[:, 0]
    torch.testing.assert_close(state, sorted_state[[2, 0, 1, 2]], rtol=0, atol=0)
    assert float(state[1]) == 0.5


def test_the_start_may_be_elsewhere() -> None:
    """A forcing that sets in before time 0 is followed from its onset; a given start is kept to."""
    forcing, _, _ = forcing_named("straight lines")
    early = Shifted(forcing, -2.0)
    t = torch.tensor([1.0, 5.0], dtype=D)
    p = torch.tensor([1.0, 0.15], dtype=D)
    method = Adaptive(1e-11, 1e-11)
    found = solve(TISSUE, t, method=method, parameters=p, forcing=early).states[:, 0]
    torch.testing.assert_close(found, early.response(torch.tensor(0.15, dtype=D), t), rtol=1e-9, atol=0)
    again = solve(TISSUE, t[1:], method=method, parameters=p, forcing=early, initial=found[:1], start=1.0)
    torch.testing.assert_close(again.states[0], found[1:], rtol=1e-9, atol=0)


@pytest.mark.parametrize("method", [FixedStep(0.05), Adaptive(1e-9, 1e-11)], ids=("fixed", "adaptive"))
def test_a_batch_equals_a_loop(method: FixedStep | Adaptive) -> None:
    """Batches of parameters, initial states and forcings, broadcast."""
    generator = torch.Generator().manual_seed(1)
    p = torch.rand(3, 1, 2, dtype=D, generator=generator) + 0.05
    start = torch.rand(2, 1, dtype=D, generator=generator)
    values = torch.rand(2, len(KNOTS), dtype=D, generator=generator)
    knots, t = torch.tensor(KNOTS, dtype=D), torch.tensor([0.0, 0.7, 8.0], dtype=D)
    whole = solve(TISSUE, t, method=method, parameters=p, initial=start, forcing=PiecewiseLinear(knots, values)).states
    assert whole.shape == (3, 2, 3, 1)
    for i in range(3):
        for j in range(2):
            forcing = PiecewiseLinear(knots, values[j])
            one = solve(TISSUE, t, method=method, parameters=p[i, 0], initial=start[j], forcing=forcing).states
            tight = 1e-13 if isinstance(method, FixedStep) else 1e-7
            torch.testing.assert_close(whole[i, j], one, rtol=tight, atol=0)


def test_every_element_of_an_adaptive_batch_keeps_its_own_accuracy() -> None:
    """One fast element among ten thousand idle ones is not averaged away by the error norm."""
    p = torch.tensor([[0.0, 0.0]] * 10_000 + [[30.0, 30.0]], dtype=D)
    forcing, _, _ = forcing_named("exponentials")
    t = torch.tensor([0.6], dtype=D)
    crowd, alone = (
        solve(TISSUE, t, method=Adaptive(1e-6, 1e-6), parameters=each, forcing=forcing).states[-1, 0, 0]
        for each in (p, p[-1:])
    )
    exact = 30.0 * forcing.response(torch.tensor(30.0, dtype=D), t)[0]
    assert float(alone) == pytest.approx(float(exact), rel=3e-6)
    assert float(crowd) == pytest.approx(float(alone), rel=1e-12)


def test_a_batch_of_delays() -> None:
    forcing, _, _ = forcing_named("straight lines")
    delays, t = torch.tensor([0.0, 1.3, -0.4], dtype=D), torch.tensor([0.5, 4.0], dtype=D)
    together = Shifted(forcing, delays)
    found = solve(TISSUE, t, method=Adaptive(1e-10, 1e-10), forcing=together).states[..., 0]
    exact = 0.3 * together.response(torch.tensor(0.15, dtype=D), t)
    torch.testing.assert_close(found, exact, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("method", [FixedStep(0.1), Adaptive(1e-8, 1e-10)], ids=("fixed", "adaptive"))
def test_gradients_match_finite_differences(method: FixedStep | Adaptive) -> None:
    t = torch.tensor([0.9, 2.0], dtype=D)
    p = torch.tensor([[0.3, 0.15], [0.2, 0.4]], dtype=D, requires_grad=True)
    start = torch.tensor([[1.0], [0.0]], dtype=D, requires_grad=True)
    levels = torch.tensor(LEVELS[:5], dtype=D, requires_grad=True)

    def end(p, start, levels):
        forcing = PiecewiseLinear(torch.tensor(KNOTS[:5], dtype=D), levels)
        return solve(TISSUE, t, method=method, parameters=p, initial=start, forcing=forcing).states

    assert torch.autograd.gradcheck(end, (p, start, levels), rtol=1e-5, atol=1e-7)


def test_gradients_of_a_nonlinear_system() -> None:
    start = torch.tensor([[1.2, 0.3], [-2.0, 0.0]], dtype=D, requires_grad=True)
    p = torch.tensor([9.81, 2.0], dtype=D, requires_grad=True)

    def end(start, p):
        return solve(PENDULUM, torch.tensor([2.0], dtype=D), method=FixedStep(0.05), initial=start, parameters=p).states

    assert torch.autograd.gradcheck(end, (start, p))


@pytest.mark.parametrize("method", [FixedStep(0.02), Adaptive(1e-6, 1e-6)], ids=("fixed", "adaptive"))
def test_single_precision(method: FixedStep | Adaptive) -> None:
    """The state decides the number type; a forcing in double precision keeps its knots."""
    forcing, _, _ = forcing_named("late")
    t = torch.tensor([3.0, 12.0], dtype=D)
    p = torch.tensor([0.3, 0.15])
    found = solve(TISSUE, t, method=method, parameters=p, forcing=forcing).states[:, 0]
    assert found.dtype == torch.float32
    exact = 0.3 * forcing.response(torch.tensor(0.15, dtype=D), t)
    torch.testing.assert_close(found.double(), exact, rtol=2e-5, atol=0)
    single = PiecewiseLinear(torch.tensor(KNOTS), torch.tensor(LEVELS))
    shifted = solve(TISSUE, t.float(), method=method, parameters=p, forcing=Shifted(single, 2.3)).states[:, 0]
    torch.testing.assert_close(shifted.double(), exact, rtol=2e-4, atol=0)


def test_a_known_field_plus_a_residual_is_a_field() -> None:
    """A residual of zero gives the known motion to the bit; a residual of the right form corrects a wrong one."""

    class Hybrid(torch.nn.Module):
        def __init__(self, weight: torch.Tensor) -> None:
            super().__init__()
            self.weight = torch.nn.Parameter(weight)

        def forward(self, t, state, forcing, parameters):
            return swing(t, state, forcing, parameters) + state @ self.weight

    t = torch.linspace(0, 3, 7, dtype=D)
    known = solve(PENDULUM, t, method=FixedStep(0.05)).states
    nothing = Hybrid(torch.zeros(2, 2, dtype=D))
    zero = solve(replace(PENDULUM, field=nothing), t, method=FixedStep(0.05)).states
    assert torch.equal(zero, known)
    (zero**2).sum().backward()
    assert nothing.weight.grad is not None
    assert bool((nothing.weight.grad != 0).all())
    damped = Hybrid(torch.tensor([[0.0, 0.0], [0.0, -0.5]], dtype=D))
    state = solve(replace(PENDULUM, field=damped), t, method=FixedStep(0.05)).states.detach()
    energy = 0.5 * 4.0 * state[:, 1] ** 2 - 9.81 * 2.0 * torch.cos(state[:, 0])
    assert bool((torch.diff(energy) < 0).all())


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_cuda_equals_cpu() -> None:
    forcing, _, _ = forcing_named("straight lines")
    assert isinstance(forcing, PiecewiseLinear)
    t, p = torch.tensor([0.5, 9.0, 20.0], dtype=D), torch.tensor([[0.3, 0.15], [0.1, 0.2]], dtype=D)
    there = PiecewiseLinear(forcing.times.cuda(), forcing.values.cuda())
    for method in METHODS:
        here = solve(TISSUE, t, method=method, parameters=p, forcing=forcing).states
        away = solve(TISSUE, t, method=method, parameters=p.cuda(), forcing=there).states
        assert away.is_cuda
        torch.testing.assert_close(away.cpu(), here, rtol=1e-10, atol=1e-12)
    matrix, drive = -p[:, 1:, None], torch.ones(1, dtype=D)
    away = solve_linear(matrix.cuda(), drive.cuda(), there, t)
    torch.testing.assert_close(away.cpu(), solve_linear(matrix, drive, forcing, t))


EXPLOSION = System(
    "explosion",
    ("x",),
    ParameterSet((Parameter("x0", "", 1.0, 0, 9),)),
    lambda t, x, u, p: p * x**2,
    (1.0,),
)


@pytest.mark.parametrize("method", [FixedStep(0.01), Adaptive()], ids=("fixed", "adaptive"))
def test_a_state_that_leaves_the_numbers_is_named(method: FixedStep | Adaptive) -> None:
    """x' = p x^2 from 1 has its pole at 1/p: 1.25 for element (1,), none before 10 for the others."""
    p = torch.tensor([[0.05], [0.8], [0.01]], dtype=D)
    t = torch.linspace(0, 3, 31, dtype=D)
    with pytest.raises(NumericalError, match=r"explosion: .*element \(1,\).*") as caught:
        solve(EXPLOSION, t, method=method, parameters=p)
    when = float(str(caught.value).split("t = ")[1].split(",")[0].split(";")[0])
    assert 1.2 <= when <= 1.45


def test_what_does_not_fit_is_refused() -> None:
    t = torch.tensor([1.0], dtype=D)
    with pytest.raises(InputError, match=r"axis of 2 \(angle, speed\)"):
        solve(PENDULUM, t, initial=torch.zeros(3, dtype=D))
    with pytest.raises(InputError, match=r"parameters must end in an axis of 2 \(G, L\)"):
        solve(PENDULUM, t, parameters=torch.tensor(1.0))
    with pytest.raises(InputError, match="not finite"):
        solve(PENDULUM, t, initial=torch.tensor([0.0, torch.nan], dtype=D))
    with pytest.raises(InputError, match="do not fit"):
        solve(PENDULUM, t, initial=torch.zeros(3, 2, dtype=D), parameters=torch.ones(4, 2, dtype=D))
    with pytest.raises(InputError, match="t = -1, before its start at t = 0"):
        solve(PENDULUM, -t)
    with pytest.raises(InputError, match="list of finite numbers"):
        solve(PENDULUM, torch.zeros(0, dtype=D))
    with pytest.raises(InputError, match="the field returns the shape"):
        solve(replace(PENDULUM, field=lambda t, x, u, p: x[..., :1]), t)
    wall = Jump("wall", lambda t, x, p: x, lambda t, x, p: x)
    with pytest.raises(InputError, match="give the method a `step`"):
        solve(replace(PENDULUM, jumps=(wall,)), t, method=Adaptive())
    with pytest.raises(InputError, match="one number an element"):
        solve(replace(PENDULUM, jumps=(wall,)), t, method=FixedStep(0.1))
    with pytest.raises(InputError, match=r"rtol 1e-08 is finer than torch\.float32"):
        solve(PENDULUM, t, initial=torch.zeros(2))
    with pytest.raises(InputError, match="must be positive"):
        FixedStep(0.0)
    with pytest.raises(InputError, match="must be positive"):
        Adaptive(rtol=0.0)
    with pytest.raises(InputError, match="2 states"):
        replace(PENDULUM, initial=(0.0,))
