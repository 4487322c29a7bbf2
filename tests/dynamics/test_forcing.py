"""Forcings: values, integrals and responses against quadrature; properties; gradients."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from petkin.dynamics import ExponentialSum, Forcing, PiecewiseLinear, Shifted
from petkin.errors import InputError

from .conftest import COEFFICIENTS, EXPONENTS, KNOTS, LEVELS, POWERS, forcing_named, integrate

D = torch.float64
TIMES = torch.tensor([0.0, 0.2, 0.45, 0.7, 0.9, 3.0, 9.0, 11.0, 40.0, 90.0], dtype=D)
#: 0, equal to two exponents of the input, nearly equal to one, slow, fast.
RATES = torch.tensor([0.0, 0.0104, 0.1191, 0.1191 * (1 + 1e-9), 4.1339, 0.03, 11.0], dtype=D)


def close(value: torch.Tensor, reference: np.ndarray, rel: float = 1e-11) -> None:
    np.testing.assert_allclose(value.numpy(), reference, rtol=rel, atol=1e-11)


def test_values(known_input) -> None:
    forcing, curve, _ = known_input
    close(forcing(TIMES + 1e-7), curve(TIMES.numpy() + 1e-7))
    assert isinstance(forcing, Forcing)


@pytest.mark.parametrize("decay", [0.0, 0.0063, 0.34])
def test_integral_against_quadrature(known_input, decay: float) -> None:
    forcing, curve, kinks = known_input
    reference = [integrate(lambda s: np.exp(-decay * s) * curve(s), float(t), kinks) for t in TIMES]
    close(forcing.integral(TIMES, decay), np.array(reference))


def test_response_against_quadrature(known_input) -> None:
    forcing, curve, kinks = known_input
    reference = [
        [integrate(lambda s, a=a, t=t: np.exp(-a * (t - s)) * curve(s), t, kinks, 0.5) for t in TIMES.tolist()]
        for a in RATES.tolist()
    ]
    close(forcing.response(RATES, TIMES), np.array(reference))


@pytest.mark.parametrize("decay", [0.0, 0.0340])
def test_integral_of_the_response_against_quadrature(known_input, decay: float) -> None:
    """int_0^t e^{-decay s} y(s) ds, its inner integral done by hand: the quadrature is over u alone."""
    forcing, curve, kinks = known_input

    def weight(s: np.ndarray, a: float, t: float) -> np.ndarray:
        p = a + decay
        left = (1 - np.exp(-p * (t - s))) / p if p > 0 else t - s
        return np.exp(-decay * s) * left * curve(s)

    reference = [
        [integrate(lambda s, a=a, t=t: weight(s, a, t), t, kinks, 0.5) for t in TIMES.tolist()] for a in RATES.tolist()
    ]
    close(forcing.response_integral(RATES, TIMES, decay), np.array(reference))


def test_straight_lines_against_the_recursion_from_knot_to_knot() -> None:
    """y <- y e^{-x} + p d phi1 + m d^2 phi2 written out with expm1, for rates where it does not cancel."""
    forcing, curve, _ = forcing_named("straight lines")
    nodes = np.unique(np.concatenate([KNOTS, np.linspace(0, 90, 37)]))
    for a in (0.2, 1.0, 7.0):
        y, path = 0.0, [0.0]
        for low, high in itertools.pairwise(nodes):
            d, (u0, u1) = high - low, curve(np.array([low + 1e-9 * (high - low), high - 1e-9 * (high - low)]))
            slope = (u1 - u0) / (d * (1 - 2e-9))
            fade = -math.expm1(-a * d)
            y = y * math.exp(-a * d) + (u0 - slope * d * 1e-9) * fade / a + slope * (d - fade / a) / a
            path.append(y)
        value = forcing.response(torch.tensor(a, dtype=D), torch.from_numpy(nodes))
        np.testing.assert_allclose(value.numpy(), path, rtol=1e-9, atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from(("straight lines", "exponentials", "late", "early")),
    st.lists(st.floats(0.0, 95.0), min_size=3, max_size=3).map(sorted),
    st.floats(0.0, 8.0),
    st.floats(0.0, 0.4),
)
def test_an_interval_is_the_sum_of_its_parts(name: str, edges: list[float], rate: float, decay: float) -> None:
    """int_a^c = int_a^b + int_b^c, with the second started afresh from the state at b."""
    forcing, _, _ = forcing_named(name)
    a, b, c = forcing.response_integral(torch.tensor(rate, dtype=D), torch.tensor(edges, dtype=D), decay).tolist()
    assert a - 1e-9 <= b + 1e-9 <= c + 2e-9, "the input is positive: its accumulated response cannot fall"
    middle = forcing.response(torch.tensor(rate, dtype=D), torch.tensor([edges[1]], dtype=D))
    rest = _cut(forcing, edges[1]).response_integral(
        torch.tensor(rate, dtype=D), torch.tensor(edges[2:], dtype=D), decay
    )
    p = rate + decay
    span = edges[2] - edges[1]
    tail = float(middle) * math.exp(-decay * edges[1]) * (-math.expm1(-p * span) / p if p * span > 1e-12 else span)
    assert b + tail + float(rest) == pytest.approx(c, rel=1e-8, abs=1e-7)


def _cut(forcing: Forcing, start: float) -> PiecewiseLinear | ExponentialSum:
    """The same input, zero before `start`."""
    delay = forcing.delay if isinstance(forcing, Shifted) else 0.0
    base = forcing.forcing if isinstance(forcing, Shifted) else forcing
    if isinstance(base, ExponentialSum):
        s = max(start - delay - base.onset, 0.0)
        c, e = base.coefficients, base.exponents
        # (s + x) e^{l (s + x)}: the power's term leaves one more of power 0
        coefficients = torch.cat([c * torch.exp(e * s), (c * s * torch.exp(e * s))[:1]])
        coefficients[1:] = torch.cat([(c * torch.exp(e * s))[1:], (c * s * torch.exp(e * s))[:1]])
        return ExponentialSum(coefficients, torch.cat([e, e[:1]]), (*POWERS, 0), onset=max(start, base.onset + delay))
    times = base.times + delay
    later = times > start
    at = torch.tensor([start], dtype=D)
    return PiecewiseLinear(torch.cat([at, times[later]]), torch.cat([forcing(at), base.values[later]]))


@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from(("straight lines", "exponentials")),
    st.floats(-0.4, 20.0),
    st.floats(0.0, 8.0),
    st.floats(0.0, 0.4),
)
def test_time_shift(name: str, delay: float, rate: float, decay: float) -> None:
    forcing, _, _ = forcing_named(name)
    rates, later = torch.tensor(rate, dtype=D), Shifted(forcing, delay)
    t = torch.tensor([0.7, 5.0, 33.0, 80.0], dtype=D) + delay
    sunk = math.exp(-decay * delay)
    torch.testing.assert_close(later.response(rates, t), forcing.response(rates, t - delay), rtol=1e-13, atol=1e-13)
    torch.testing.assert_close(later.integral(t, decay), sunk * forcing.integral(t - delay, decay))
    shifted, plain = later.response_integral(rates, t, decay), forcing.response_integral(rates, t - delay, decay)
    torch.testing.assert_close(shifted, sunk * plain)
    moved = PiecewiseLinear(forcing.times + delay, forcing.values) if isinstance(forcing, PiecewiseLinear) else None
    if moved is not None:
        torch.testing.assert_close(later.response(rates, t), moved.response(rates, t), rtol=1e-10, atol=1e-10)


@settings(max_examples=25, deadline=None)
@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.0, 8.0))
def test_linear_in_the_input(one: float, two: float, rate: float) -> None:
    times, rates = torch.tensor(KNOTS, dtype=D), torch.tensor(rate, dtype=D)
    u, v = torch.tensor(LEVELS, dtype=D), torch.sin(torch.arange(len(KNOTS), dtype=D))
    mixed, *parts = (PiecewiseLinear(times, values) for values in (one * u + two * v, u, v))
    for read in (lambda f: f.response(rates, TIMES), lambda f: f.response_integral(rates, TIMES, 0.1)):
        torch.testing.assert_close(read(mixed), one * read(parts[0]) + two * read(parts[1]), rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("factor", [60.0, 1e-3])
@pytest.mark.parametrize("name", ["straight lines", "exponentials"])
def test_unit_of_time_does_not_matter(name: str, factor: float) -> None:
    """In a unit f times smaller: y of rate a / f at f t is f y, and its integral f^2 int y."""
    forcing, _, _ = forcing_named(name)
    if isinstance(forcing, PiecewiseLinear):
        other: Forcing = PiecewiseLinear(forcing.times * factor, forcing.values)
    elif isinstance(forcing, ExponentialSum):
        powers = factor ** torch.tensor(forcing.powers, dtype=D)
        scaled = forcing.coefficients / powers, forcing.exponents / factor
        other = ExponentialSum(*scaled, forcing.powers, onset=forcing.onset * factor)
    value = other.response_integral(RATES / factor, TIMES * factor, 0.02 / factor)
    torch.testing.assert_close(value, factor**2 * forcing.response_integral(RATES, TIMES, 0.02), rtol=1e-10, atol=1e-9)


def test_positive_inputs_have_positive_responses(known_input) -> None:
    forcing, _, _ = known_input
    assert bool((forcing.response(RATES, TIMES) >= 0).all())


def test_a_doubled_knot_is_a_jump() -> None:
    values = PiecewiseLinear(torch.tensor(KNOTS, dtype=D), torch.tensor(LEVELS, dtype=D))
    left, at = values(torch.tensor([0.7 - 1e-12, 0.7], dtype=D)).tolist()
    assert left == pytest.approx(90.0)
    assert at == pytest.approx(40.0)
    step = PiecewiseLinear(torch.tensor([0.0, 2.0, 2.0], dtype=D), torch.tensor([0.0, 0.0, 5.0], dtype=D))
    t = torch.tensor([1.0, 2.0, 3.0, 12.0], dtype=D)
    expected = 5.0 * (1 - torch.exp(-0.3 * (t - 2.0).clamp(min=0.0))) / 0.3
    torch.testing.assert_close(step.response(torch.tensor(0.3, dtype=D), t), expected)


@pytest.mark.parametrize("kind", [np.asarray, torch.from_numpy])
def test_at_its_own_knots_a_response_is_that_at_any_times(kind) -> None:
    """Jumps, a late onset and steps far shorter than 1 / rate among them."""
    times = np.array([0.3, 0.7, 0.7, 0.70001, 2.0, 2.0, 30.0, 90.0])
    curve = PiecewiseLinear(kind(times), kind(np.array([0.0, 90.0, 40.0, 41.0, 20.0, 25.0, 3.0, 1.0])))
    for rates in (np.array(0.0), np.array(1e-6), np.array([[0.05, 3.0], [60.0, 0.7]])):
        known = curve.response(kind(rates), curve.times)
        asked = curve.response(kind(rates), kind(times.copy()))
        assert known.shape == (*rates.shape, len(times))
        np.testing.assert_allclose(known, asked, rtol=1e-12, atol=1e-12)


def test_one_knot_is_a_constant_from_there() -> None:
    forcing = PiecewiseLinear(torch.tensor([1.0], dtype=D), torch.tensor([[2.0], [3.0]], dtype=D))
    expected = torch.tensor([[0.0, 8.0], [0.0, 12.0]], dtype=D)
    torch.testing.assert_close(forcing.integral(torch.tensor([0.5, 5.0], dtype=D)), expected)
    torch.testing.assert_close(
        forcing.response(torch.tensor(0.0, dtype=D), torch.tensor([0.5, 5.0], dtype=D)), expected
    )


def test_a_constant_input_tends_to_its_level_over_the_rate() -> None:
    forcing = PiecewiseLinear(torch.tensor([0.0], dtype=D), torch.tensor([7.0], dtype=D))
    value = forcing.response(torch.tensor([0.2, 3.0], dtype=D), torch.tensor([500.0], dtype=D))
    torch.testing.assert_close(value[:, 0], torch.tensor([35.0, 7.0 / 3.0], dtype=D))


def test_batches_equal_loops() -> None:
    generator = torch.Generator().manual_seed(0)
    values = torch.rand(3, len(KNOTS), dtype=D, generator=generator)
    coefficients = torch.rand(3, 4, dtype=D, generator=generator)
    exponents = -torch.rand(3, 4, dtype=D, generator=generator)
    rates = torch.rand(5, 1, dtype=D, generator=generator)
    knots = torch.tensor(KNOTS, dtype=D)
    batched = PiecewiseLinear(knots, values), ExponentialSum(coefficients, exponents, POWERS, onset=0.5)
    for forcing in batched:
        for read in ("response", "response_integral"):
            whole = getattr(forcing, read)(rates, TIMES)
            assert whole.shape == (5, 3, len(TIMES))
            for i in range(5):
                for j in range(3):
                    one = (
                        PiecewiseLinear(knots, values[j])
                        if forcing is batched[0]
                        else ExponentialSum(coefficients[j], exponents[j], POWERS, onset=0.5)
                    )
                    torch.testing.assert_close(whole[i, j], getattr(one, read)(rates[i, 0], TIMES), rtol=1e-13, atol=0)


def test_a_batch_of_delays_equals_a_loop() -> None:
    delays = torch.tensor([-0.3, 0.0, 1.7], dtype=D)
    for name in ("straight lines", "exponentials"):
        forcing, _, _ = forcing_named(name)
        together, rates = Shifted(forcing, delays), torch.tensor([[0.1], [2.0]], dtype=D)
        each = [Shifted(forcing, float(delay)) for delay in delays]
        torch.testing.assert_close(together(TIMES), torch.stack([one(TIMES) for one in each]))
        torch.testing.assert_close(
            together.integral(TIMES, 0.1), torch.stack([one.integral(TIMES, 0.1) for one in each])
        )
        for i in range(3):
            one = each[i].response_integral(rates[:, 0], TIMES, 0.1)
            torch.testing.assert_close(together.response_integral(rates[:, 0], TIMES, 0.1)[..., i, :], one)


def test_gradients_match_finite_differences() -> None:
    rates = torch.tensor([0.0104, 0.11, 0.5], dtype=D, requires_grad=True)
    t = torch.tensor([0.9, 5.0, 40.0], dtype=D)
    levels = torch.tensor(LEVELS, dtype=D, requires_grad=True)

    def straight(rates, levels):
        forcing = PiecewiseLinear(torch.tensor(KNOTS, dtype=D), levels)
        return forcing.response(rates, t), forcing.response_integral(rates, t, 0.03), forcing.integral(t, 0.03)

    assert torch.autograd.gradcheck(straight, (rates, levels))
    c = torch.tensor(COEFFICIENTS, dtype=D, requires_grad=True)
    e = torch.tensor(EXPONENTS, dtype=D, requires_grad=True)

    def bolus(rates, c, e, t):
        forcing = ExponentialSum(c, e, POWERS, onset=0.45)
        return forcing(t), forcing.response(rates, t), forcing.response_integral(rates, t, 0.03), forcing.integral(t)

    assert torch.autograd.gradcheck(bolus, (rates, c, e, t.clone().requires_grad_()))


def test_the_derivative_in_time_of_a_response_is_its_equation(known_input) -> None:
    forcing, _, _ = known_input
    t = (TIMES[1:] + 0.013).requires_grad_()
    y = forcing.response(torch.tensor(0.6, dtype=D), t)
    (slope,) = torch.autograd.grad(y.sum(), t)
    torch.testing.assert_close(slope, (forcing(t) - 0.6 * y).detach(), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ["straight lines", "exponentials"])
def test_single_precision(name: str) -> None:
    forcing, _, _ = forcing_named(name)
    if isinstance(forcing, PiecewiseLinear):
        single: Forcing = PiecewiseLinear(forcing.times.float(), forcing.values.float())
    elif isinstance(forcing, ExponentialSum):
        single = ExponentialSum(forcing.coefficients.float(), forcing.exponents.float(), POWERS, onset=forcing.onset)
    t = TIMES[4:]
    value = single.response(RATES.float(), t.float())
    assert value.dtype == torch.float32
    torch.testing.assert_close(value.double(), forcing.response(RATES, t), rtol=2e-4, atol=1e-4)


def test_what_cannot_be_used_is_refused() -> None:
    with pytest.raises(InputError, match="as many values as knots"):
        PiecewiseLinear(torch.zeros(3), torch.zeros(2))
    with pytest.raises(InputError, match="must ascend"):
        PiecewiseLinear(torch.tensor([0.0, 2.0, 1.0]), torch.zeros(3))
    with pytest.raises(InputError, match="one coefficient, exponent and power"):
        ExponentialSum(torch.zeros(2), torch.zeros(2), (0,))


@pytest.mark.parametrize("delay", [None, 2.3, (-0.4, 0.0, 7.5)], ids=["at once", "late", "delays"])
def test_arrays_give_arrays_and_one_tensor_makes_tensors(delay) -> None:
    """A forcing of arrays, of tensors, and either asked with the other kind of times and rates: the same numbers."""
    decay, held = 0.03, PiecewiseLinear(np.array(KNOTS), np.array(LEVELS))
    t, rates = TIMES.numpy(), RATES.numpy()

    def asked(forcing: Forcing, t, rates) -> list:
        found = [forcing(t), forcing.integral(t), forcing.integral(t, decay), forcing.knots]
        return [*found, forcing.response(rates, t), forcing.response_integral(rates, t, decay)]

    def shifted(forcing: Forcing, kind) -> Forcing:
        return forcing if delay is None else Shifted(forcing, delay if isinstance(delay, float) else kind(delay))

    arrays = asked(shifted(held, np.array), t, rates)
    assert all(isinstance(found, np.ndarray) for found in arrays)
    tensors = asked(shifted(held.tensors, lambda d: torch.tensor(d, dtype=D)), TIMES, RATES)
    mixed = asked(shifted(held, np.array), TIMES, RATES), asked(shifted(held.tensors, np.array), t, rates)
    for others in (tensors, *mixed):
        for i, (array, other) in enumerate(zip(arrays, others)):
            assert isinstance(other, torch.Tensor) or i == 3
            np.testing.assert_allclose(np.asarray(other), array, rtol=1e-13, atol=1e-13)
    assert all(isinstance(found, torch.Tensor) for found in tensors)
