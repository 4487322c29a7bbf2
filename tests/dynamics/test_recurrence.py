"""The walk from knot to knot: compiled and vector route against a plain loop."""

from __future__ import annotations

import pytest
import torch

from petkin.dynamics.on_tensors import _doubling
from petkin.dynamics.recurrence import linear_recurrence

D = torch.float64


def example(*shape: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(5)
    return torch.rand(shape, dtype=D, generator=generator), torch.randn(shape, dtype=D, generator=generator)


@pytest.mark.parametrize("route", [linear_recurrence, _doubling], ids=("compiled", "vector"))
@pytest.mark.parametrize("shape", [(1,), (7,), (2, 3, 8), (3, 0), (0,), (0, 4)])
def test_against_a_loop(route, shape: tuple[int, ...]) -> None:
    factors, values = example(*shape)
    states = [torch.zeros(shape[:-1], dtype=D)]
    for i in range(shape[-1]):
        states.append(factors[..., i] * states[-1] + values[..., i])
    found = route(factors, values)
    assert found.shape == (*shape[:-1], shape[-1] + 1)
    torch.testing.assert_close(found, torch.stack(states, dim=-1), rtol=1e-13, atol=1e-14)


def test_gradients_and_tangents_of_one_or_both_inputs() -> None:
    factors, values = (x.requires_grad_() for x in example(2, 5))
    assert torch.autograd.gradcheck(linear_recurrence, (factors, values), check_forward_ad=True)
    assert torch.autograd.gradgradcheck(linear_recurrence, (factors, values))
    fixed = factors.detach()
    assert torch.autograd.gradcheck(lambda v: linear_recurrence(fixed, v), (values,), check_forward_ad=True)
    held = values.detach()
    assert torch.autograd.gradcheck(lambda f: linear_recurrence(f, held), (factors,), check_forward_ad=True)


def test_broadcasting_and_single_precision() -> None:
    factors, values = example(4, 6)
    wide = linear_recurrence(factors[:, None], values)
    torch.testing.assert_close(wide[2, 3], linear_recurrence(factors[2], values[3]))
    single = linear_recurrence(factors.float(), values.float())
    assert single.dtype == torch.float32
    torch.testing.assert_close(single.double(), linear_recurrence(factors, values), rtol=1e-5, atol=1e-6)
