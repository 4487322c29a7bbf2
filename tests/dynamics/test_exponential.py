"""exp_divided_difference against 80-digit arithmetic."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
import torch

from petkin.dynamics import exp_divided_difference
from petkin.dynamics.on_tensors import _recurse

KINDS = ("apart", "equal", "nearly equal", "partly equal", "two zeros")


def exact(points: list[float], t: float) -> mpmath.mpf:
    """The last entry of the first row of exp(t J), J the points with ones above (Opitz 1964)."""
    with mpmath.workdps(80):
        n = len(points)
        J = mpmath.zeros(n)
        for i, point in enumerate(points):
            J[i, i] = mpmath.mpf(point) * mpmath.mpf(t)
            if i:
                J[i - 1, i] = mpmath.mpf(t)
        return mpmath.expm(J)[0, n - 1]


def draw(kind: str, count: int, rng: np.random.Generator) -> list[float]:
    points = -(10 ** rng.uniform(-3, 1, count))
    if kind == "equal":
        points[:] = points[0]
    elif kind == "nearly equal":
        points = points[0] * (1 + 10 ** rng.uniform(-14, -1) * rng.normal(size=count))
    elif kind == "partly equal":
        points[: count // 2 + 1] = points[0]
    elif kind == "two zeros":
        points[rng.integers(count)] = points[rng.integers(count)] = 0.0
    return points.tolist()


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_the_route_of_other_devices_agrees_with_80_digits(count: int) -> None:
    """Double precision on the CPU is compiled; what a GPU runs is plain torch, and is tried here on the CPU."""
    rng = np.random.default_rng(10 + count)
    for kind in KINDS:
        points, t = draw(kind, count, rng), 10 ** rng.uniform(-2, 1.5, 6)
        ordered = torch.tensor(sorted(points), dtype=torch.float64).expand(6, count)
        value = _recurse(ordered, torch.from_numpy(t), 0, count - 1)
        for one, when in zip(value.tolist(), t.tolist()):
            allowed = 1e-13 + 4e-16 * max(abs(p) for p in points) * when
            assert abs(mpmath.mpf(one) / exact(points, when) - 1) < allowed, (points, when)


def measure(points: list[float], t: float, dtype: torch.dtype = torch.float64) -> float:
    return float(exp_divided_difference(tuple(points), torch.tensor([t], dtype=dtype))[0])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_agrees_with_80_digits(kind: str, count: int) -> None:
    rng = np.random.default_rng(count)
    for _ in range(12):
        points, t = draw(kind, count, rng), 10 ** rng.uniform(-3, 1.9)
        reference = exact(points, t)
        # a rounding of p t alone changes exp(p t) by |p t| eps
        allowed = 1e-13 + 4e-16 * max(abs(p) for p in points) * t
        if reference > mpmath.mpf("1e-290"):
            assert abs(mpmath.mpf(measure(points, t)) / reference - 1) < allowed, (points, t)


@pytest.mark.parametrize("t", [0.0, 1e-12, 1e-3])
def test_small_times_give_the_power(t: float) -> None:
    assert measure([0.3, -2.0, -0.1], t) == pytest.approx(t**2 / 2 * (1 + t * (0.3 - 2.0 - 0.1) / 3), rel=1e-6, abs=0.0)


def test_order_of_points_does_not_matter() -> None:
    t = torch.linspace(0, 60, 50, dtype=torch.float64)
    first = exp_divided_difference((0.0, -0.1, -2.0, -0.1), t)
    second = exp_divided_difference((-0.1, -2.0, -0.1, 0.0), t)
    torch.testing.assert_close(first, second, rtol=0, atol=0)


@pytest.mark.parametrize("spread", [0.0, 1e-9, 1e-3, 0.3, 4.0])
def test_the_derivative_in_a_point_doubles_the_point(spread: float) -> None:
    points = [-0.2, -0.2 - spread, -0.2 - 2 * spread]
    tensors = [torch.tensor(p, dtype=torch.float64, requires_grad=True) for p in points]
    exp_divided_difference(tuple(tensors), torch.tensor(7.0, dtype=torch.float64)).backward()
    for i, tensor in enumerate(tensors):
        assert tensor.grad is not None
        assert float(tensor.grad) == pytest.approx(float(exact([*points, points[i]], 7.0)), rel=1e-9)


def test_gradients_where_near_and_far_times_mix() -> None:
    t = torch.tensor([0.0, 0.5, 3.0, 200.0], dtype=torch.float64, requires_grad=True)
    points = torch.tensor([[0.0, -0.4, -0.9], [-0.3, -0.3, -5.0]], dtype=torch.float64, requires_grad=True)

    def batched(points: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        return exp_divided_difference(tuple(points[:, i, None] for i in range(3)), t)

    assert torch.autograd.gradcheck(batched, (points, t), check_forward_ad=True)
    assert torch.autograd.gradgradcheck(batched, (points, t[:3].detach().requires_grad_()))


def test_single_precision_keeps_six_digits() -> None:
    rng = np.random.default_rng(0)
    for kind in KINDS:
        points, t = draw(kind, 3, rng), 5.0
        assert measure(points, t, torch.float32) == pytest.approx(float(exact(points, t)), rel=3e-5)


def test_long_times_neither_overflow_nor_lose_the_gradient() -> None:
    rate = torch.tensor([5.0, 1e-300, 0.0], dtype=torch.float64, requires_grad=True)
    value = exp_divided_difference((0.0, -rate[:, None]), torch.tensor([0.1, 1e5], dtype=torch.float64))
    value.sum().backward()
    torch.testing.assert_close(value[:, 1], torch.tensor([0.2, 1e5, 1e5], dtype=torch.float64))
    assert rate.grad is not None
    torch.testing.assert_close(rate.grad[1:], torch.full((2,), -0.5 * (0.1**2 + 1e10), dtype=torch.float64))
