"""One linear system, four ways: closed form, matrix exponential, fine-step Runge-Kutta, adaptive Runge-Kutta."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import torch

from petkin.dynamics import (
    Adaptive,
    ExponentialSum,
    FixedStep,
    Forcing,
    Parameter,
    ParameterSet,
    PiecewiseLinear,
    Shifted,
    System,
    exp_divided_difference,
    integrate_linear,
    solve,
    solve_linear,
)
from petkin.errors import InputError

from .conftest import COEFFICIENTS, EXPONENTS, INPUTS, KNOTS, LEVELS, POWERS, forcing_named, integrate

D = torch.float64
TIMES = torch.tensor([0.8, 1.3, 2.0, 3.3], dtype=D)


def chain_closed_form(forcing: Forcing, a: float, b: float, times: torch.Tensor) -> torch.Tensor:
    """e^{-b t} * e^{-a t} * u (convolved) by divided differences, a term for every corner or exponential of u."""
    delay = float(forcing.delay) if isinstance(forcing, Shifted) else 0.0
    base = forcing.forcing if isinstance(forcing, Shifted) else forcing
    total = torch.zeros_like(times)
    if isinstance(base, ExponentialSum):
        s = (times - delay - base.onset).clamp(min=0.0)
        for c, e, n in zip(base.coefficients.tolist(), base.exponents.tolist(), base.powers):
            total = total + c * math.factorial(n) * exp_divided_difference((-a, -b, *([e] * (n + 1))), s)
        return total
    pieces = list(itertools.pairwise(zip(KNOTS, LEVELS)))
    corners = [(KNOTS[-1], LEVELS[-1], 0.0)]  # (where, height of a step that starts there, slope of a ramp that does)
    for (p, u), (q, v) in pieces:
        slope = (v - u) / (q - p) if q > p else 0.0
        corners += [(p, u, slope), (q, -v, -slope)] if q > p else []
    for knot, height, slope in corners:
        s = (times - delay - knot).clamp(min=0.0)
        total = total + height * exp_divided_difference((0.0, -a, -b), s)
        total = total + slope * exp_divided_difference((0.0, 0.0, -a, -b), s)
    return total


def two_compartments(rates: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """x1' = u - a x1, x2' = x1 - b x2."""
    a, b = rates[..., 0], rates[..., 1]
    zero = torch.zeros_like(a)
    matrix = torch.stack([torch.stack([-a, zero], -1), torch.stack([zero + 1, -b], -1)], -2)
    return matrix, torch.tensor([1.0, 0.0], dtype=rates.dtype)


def chain_field(t: torch.Tensor, x: torch.Tensor, u: torch.Tensor | None, p: torch.Tensor) -> torch.Tensor:
    assert u is not None
    return torch.stack([u - p[..., 0] * x[..., 0], x[..., 0] - p[..., 1] * x[..., 1]], dim=-1)


CHAIN = System(
    "chain",
    ("x1", "x2"),
    ParameterSet((Parameter("a", "1/min", 0.1, 0, 10), Parameter("b", "1/min", 0.2, 0, 10))),
    chain_field,
    (0.0, 0.0),
)


def rate_pairs() -> torch.Tensor:
    rng = np.random.default_rng(4)
    pairs = [tuple(10 ** rng.uniform(-2.5, 0.5, 2)) for _ in range(6)]
    slow, fast, late = 0.0104, 4.1339, 0.1191
    pairs += [(0.3, 0.3), (0.3, 0.3 * (1 + 1e-10)), (0.3, 0.3001), (0.0, 0.0), (0.0, 0.5), (slow, slow), (late, slow)]
    return torch.tensor([*pairs, (late, fast), (fast, fast), (fast, fast * (1 - 1e-8)), (slow, 0.0)], dtype=D)


@pytest.mark.parametrize("name", INPUTS)
def test_four_ways_agree_to_eight_digits(name: str) -> None:
    """Random rates, equal and nearly equal ones, zeros, and rates at the input's own exponents."""
    forcing, _, _ = forcing_named(name)
    rates = rate_pairs()
    matrix, drive = two_compartments(rates)
    exponential = solve_linear(matrix, drive, forcing, TIMES)
    response = forcing.response(rates[:, 0], TIMES)
    closed = torch.stack([chain_closed_form(forcing, *pair, TIMES) for pair in rates.tolist()])
    fixed = solve(CHAIN, TIMES, method=FixedStep(0.005), parameters=rates, forcing=forcing).states
    adaptive = solve(CHAIN, TIMES, method=Adaptive(1e-11, 1e-11), parameters=rates, forcing=forcing).states
    exact = torch.stack([response, closed], dim=-1)
    torch.testing.assert_close(exponential, exact, rtol=2e-12, atol=1e-12)
    torch.testing.assert_close(fixed, exact, rtol=1e-8, atol=1e-9)
    torch.testing.assert_close(adaptive, exact, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("name", INPUTS)
@pytest.mark.parametrize("decay", [0.0, 0.0063, 0.34])
def test_integrals_agree(name: str, decay: float) -> None:
    forcing, _, _ = forcing_named(name)
    rates, times = rate_pairs(), torch.tensor([0.0, 0.2, 5.0, 60.0, 90.0], dtype=D)
    value = integrate_linear(*two_compartments(rates), forcing, times, decay=decay)
    expected = forcing.response_integral(rates[:, 0], times, decay)
    torch.testing.assert_close(value[..., 0], expected, rtol=1e-11, atol=1e-11)


def test_integral_against_quadrature_of_the_state() -> None:
    forcing, _, kinks = forcing_named("late")
    matrix = torch.tensor([[-0.4, 0.1], [0.3, -0.1]], dtype=D)
    drive, start = torch.tensor([0.5, 0.2], dtype=D), torch.tensor([4.0, 1.0], dtype=D)

    def weighted(s: np.ndarray) -> np.ndarray:
        return (solve_linear(matrix, drive, forcing, torch.from_numpy(s), initial=start)[:, 1]).numpy() * np.exp(
            -0.1 * s
        )

    end = torch.tensor([31.0], dtype=D)
    value = integrate_linear(matrix, drive, forcing, end, initial=start, decay=0.1)
    assert float(value[0, 1]) == pytest.approx(integrate(weighted, 31.0, kinks, 10.0), rel=1e-11)


def test_reversible_compartments_against_their_two_exponentials() -> None:
    """x' = A x + b u with A = [[-(k2 + k3), k4], [k3, -k4]]: responses at the two eigenvalues (Huang 1980)."""
    forcing, _, _ = forcing_named("exponentials")
    rng = np.random.default_rng(1)
    k2, k3, k4 = (torch.from_numpy(10 ** rng.uniform(-2, 0, 20)) for _ in range(3))
    matrix = torch.stack([torch.stack([-(k2 + k3), k4], -1), torch.stack([k3, -k4], -1)], -2)
    state = solve_linear(matrix, torch.tensor([0.3, 0.0], dtype=D), forcing, TIMES)
    root = torch.sqrt((k2 + k3 + k4) ** 2 - 4 * k2 * k4)
    slow, fast = (k2 + k3 + k4 - root) / 2, (k2 + k3 + k4 + root) / 2
    weight = 0.3 / (fast - slow)
    total = (weight * (k3 + k4 - slow))[:, None] * forcing.response(slow, TIMES)
    total = total + (weight * (fast - k3 - k4))[:, None] * forcing.response(fast, TIMES)
    torch.testing.assert_close(state.sum(dim=-1), total, rtol=1e-11, atol=0)


def test_oscillation_without_drive_is_a_cosine() -> None:
    matrix = torch.tensor([[0.0, 1.0], [-9.0, 0.0]], dtype=D)
    nothing = PiecewiseLinear(torch.tensor([0.0], dtype=D), torch.tensor([0.0], dtype=D))
    t = torch.linspace(0, 12, 40, dtype=D)
    value = solve_linear(matrix, torch.zeros(2, dtype=D), nothing, t, initial=torch.tensor([2.0, 0.0], dtype=D))
    torch.testing.assert_close(value[:, 0], 2 * torch.cos(3 * t), rtol=0, atol=1e-12)


def test_splitting_the_time_axis_changes_nothing() -> None:
    """Stopping, and going on from there with a forcing shifted back, gives the same end."""
    matrix, drive = torch.tensor([[-0.4, 0.1], [0.3, -0.1]], dtype=D), torch.tensor([0.5, 0.2], dtype=D)
    forcing, _, _ = forcing_named("straight lines")
    whole = solve_linear(matrix, drive, forcing, torch.tensor([3.0, 30.0], dtype=D))
    rest = solve_linear(matrix, drive, Shifted(forcing, -3.0), torch.tensor([27.0], dtype=D), initial=whole[0])
    torch.testing.assert_close(rest[0], whole[1], rtol=1e-12, atol=0)


def test_an_input_that_sets_in_before_time_zero_is_followed_from_its_onset() -> None:
    rate = torch.tensor(0.3, dtype=D)
    for name in ("straight lines", "exponentials"):
        early = Shifted(forcing_named(name)[0], -2.0)
        system = -rate[None, None], torch.ones(1, dtype=D), early, TIMES
        torch.testing.assert_close(solve_linear(*system)[:, 0], early.response(rate, TIMES), rtol=1e-12, atol=0)
        area = integrate_linear(*system, decay=0.1)[:, 0]
        torch.testing.assert_close(area, early.response_integral(rate, TIMES, 0.1), rtol=1e-12, atol=0)


def test_batches_of_everything() -> None:
    generator = torch.Generator().manual_seed(2)
    matrix = -torch.rand(4, 1, 2, 2, dtype=D, generator=generator)
    drive = torch.rand(4, 1, 2, dtype=D, generator=generator)
    values = torch.rand(3, len(KNOTS), dtype=D, generator=generator)
    knots, times = torch.tensor(KNOTS, dtype=D), torch.tensor([20.0, 0.0, 5.0], dtype=D)
    forcing = PiecewiseLinear(knots, values)
    state, area = (way(matrix, drive, forcing, times) for way in (solve_linear, integrate_linear))
    assert state.shape == area.shape == (4, 3, 3, 2)
    for i, j in itertools.product(range(4), range(3)):
        one = matrix[i, 0], drive[i, 0], PiecewiseLinear(knots, values[j]), times
        torch.testing.assert_close(state[i, j], solve_linear(*one))
        torch.testing.assert_close(area[i, j], integrate_linear(*one))
    delays = torch.tensor([-0.2, 1.0, 2.0], dtype=D)
    for name in ("straight lines", "exponentials"):
        base, _, _ = forcing_named(name)
        together = solve_linear(matrix, drive, Shifted(base, delays), times)
        for j, delay in enumerate(delays.tolist()):
            one = solve_linear(matrix[:, 0], drive[:, 0], Shifted(Shifted(base, delay - 1.0), 1.0), times)
            torch.testing.assert_close(together[:, j], one, rtol=1e-9, atol=1e-9)


def test_gradients_match_finite_differences() -> None:
    matrix = torch.tensor([[-0.4, 0.1], [0.3, -0.1]], dtype=D, requires_grad=True)
    drive = torch.tensor([0.5, 0.0], dtype=D, requires_grad=True)
    start = torch.tensor([1.0, 0.0], dtype=D, requires_grad=True)
    levels = torch.tensor([0.0, 9.0, 4.0, 1.0], dtype=D, requires_grad=True)
    coefficients = torch.tensor(COEFFICIENTS, dtype=D, requires_grad=True)
    exponents = torch.tensor(EXPONENTS, dtype=D, requires_grad=True)
    times = torch.tensor([0.5, 3.0], dtype=D)

    def lines(matrix, drive, start, levels):
        forcing = PiecewiseLinear(torch.tensor([0.0, 1.0, 1.0, 4.0], dtype=D), levels)
        system = matrix, drive, forcing, times
        return solve_linear(*system, initial=start), integrate_linear(*system, initial=start, decay=0.1)

    def bolus(matrix, coefficients, exponents):
        forcing = ExponentialSum(coefficients, exponents, POWERS, onset=0.2)
        return solve_linear(matrix, torch.tensor([0.5, 0.0], dtype=D), forcing, times)

    assert torch.autograd.gradcheck(lines, (matrix, drive, start, levels))
    assert torch.autograd.gradcheck(bolus, (matrix, coefficients, exponents))


def test_single_precision() -> None:
    forcing = PiecewiseLinear(torch.tensor(KNOTS), torch.tensor(LEVELS))
    matrix = torch.tensor([[-0.4, 0.1], [0.3, -0.1]])
    value = solve_linear(matrix, torch.tensor([0.5, 0.0]), forcing, TIMES)
    assert value.dtype == torch.float32
    double = PiecewiseLinear(torch.tensor(KNOTS, dtype=D), torch.tensor(LEVELS, dtype=D))
    exact = solve_linear(matrix.double(), torch.tensor([0.5, 0.0], dtype=D), double, TIMES)
    torch.testing.assert_close(value.double(), exact, rtol=2e-5, atol=1e-5)


def test_what_cannot_be_solved_is_refused() -> None:
    forcing, _, _ = forcing_named("straight lines")
    matrix, drive = torch.eye(2, dtype=D), torch.ones(2, dtype=D)
    with pytest.raises(InputError, match="before its start at t = 0"):
        solve_linear(matrix, drive, forcing, torch.tensor([-1.0], dtype=D))
    with pytest.raises(InputError, match="square matrix"):
        solve_linear(matrix, torch.ones(3, dtype=D), forcing, TIMES)

    class Other:
        knots = torch.zeros(1, dtype=D)

    with pytest.raises(InputError, match="not for Other"):
        solve_linear(matrix, drive, Other(), TIMES)  # pyright: ignore[reportArgumentType]
