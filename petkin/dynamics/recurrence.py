"""y_0 = 0, y_{i+1} = f_i y_i + v_i along the last axis: how an exact solution walks from knot to knot."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from numba import njit
from torch import Tensor


def linear_recurrence(factors: Float[Tensor, "*b n"], values: Float[Tensor, "*b n"]) -> Float[Tensor, "*b m"]:
    """All n + 1 states of y_{i+1} = f_i y_i + v_i from y_0 = 0; differentiable.

    Args:
        factors: f_i, |f_i| <= 1 for stability.
        values: v_i, of the same shape.
    """
    factors, values = torch.broadcast_tensors(factors, values)
    if values.device.type == "cpu" and values.dtype == torch.float64:
        return _Compiled.apply(factors, values)  # type: ignore[no-any-return]
    return _doubling(factors, values)


def _doubling(factor: Tensor, value: Tensor) -> Tensor:
    """In log2(n) passes of vector operations, for devices where a loop is slow."""
    start = value.new_zeros(*value.shape[:-1], 1)
    span = 1
    while span < value.shape[-1]:
        value = torch.cat([value[..., :span], value[..., span:] + factor[..., span:] * value[..., :-span]], dim=-1)
        factor = torch.cat([factor[..., :span], factor[..., span:] * factor[..., :-span]], dim=-1)
        span *= 2
    return torch.cat([start, value], dim=-1)


class _Compiled(torch.autograd.Function):
    """In one compiled pass. Tangents obey dy_{i+1} = f_i dy_i + (df_i y_i + dv_i); adjoints the same, backwards."""

    @staticmethod
    def forward(factors: Tensor, values: Tensor) -> Tensor:
        n, rows = values.shape[-1], values.shape[:-1].numel()  # no -1: one knot has no steps, n = 0
        rows = _walk(factors.detach().reshape(rows, n).numpy(), values.detach().reshape(rows, n).numpy())
        return torch.from_numpy(rows).reshape(*values.shape[:-1], n + 1)

    @staticmethod
    def setup_context(ctx, inputs, output) -> None:
        ctx.save_for_backward(inputs[0], output)
        ctx.save_for_forward(inputs[0], output)

    @staticmethod
    def backward(ctx, *grads: Tensor):
        (grad,) = grads
        factors, states = ctx.saved_tensors
        # lambda_i = grad_i + f_i lambda_{i+1}: a recurrence on the reversed axis, lambda_{n+1} = 0.
        reverse = torch.flip(grad, [-1])
        ahead = torch.cat([torch.zeros_like(factors[..., :1]), torch.flip(factors, [-1])], dim=-1)
        adjoint = torch.flip(linear_recurrence(ahead, reverse)[..., 1:], [-1])[..., 1:]
        return adjoint * states[..., :-1], adjoint

    @staticmethod
    def jvp(ctx, *tangents: Tensor) -> Tensor:
        factors, states = ctx.saved_tensors
        return linear_recurrence(factors, tangents[0] * states[..., :-1] + tangents[1])


@njit(cache=True, nogil=True, error_model="numpy")
def _walk(factors, values):
    rows, n = values.shape
    answer = np.empty((rows, n + 1))
    for row in range(rows):
        state = 0.0
        answer[row, 0] = 0.0
        for i in range(n):
            state = factors[row, i] * state + values[row, i]
            answer[row, i + 1] = state
    return answer
