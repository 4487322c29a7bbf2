"""Divided differences and recurrences of tensors: with derivatives, and on any device.

On the CPU both run in the compiled code that serves arrays; elsewhere, and in single precision, in vector operations.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from petkin.dynamics.exponential import SERIES_SPREAD, SERIES_TERMS, divided_differences
from petkin.dynamics.recurrence import walk


def divided_difference(points: tuple[Tensor | float, ...], t: Tensor) -> Tensor:
    """exp[p0, ..., pn](t); see `exponential.exp_divided_difference`."""
    tensors = [torch.as_tensor(p, dtype=t.dtype, device=t.device) for p in points]
    if len(tensors) == 1:
        return torch.exp(tensors[0] * t)
    stacked = torch.stack(torch.broadcast_tensors(*tensors), dim=-1)
    if t.device.type == "cpu" and t.dtype == torch.float64:
        return _DividedDifference.apply(stacked, t)  # type: ignore[no-any-return]
    ordered = torch.sort(stacked, dim=-1).values
    return _recurse(ordered, t, 0, len(tensors) - 1)


def recurrence(factors: Float[Tensor, "*#b n"], values: Float[Tensor, "*#b n"]) -> Float[Tensor, "*#b m"]:
    """All n + 1 states of y_{i+1} = f_i y_i + v_i; see `recurrence.linear_recurrence`."""
    factors, values = torch.broadcast_tensors(factors, values)
    if values.device.type == "cpu" and values.dtype == torch.float64:
        return _Recurrence.apply(factors, values)  # type: ignore[no-any-return]
    return _doubling(factors, values)


class _DividedDifference(torch.autograd.Function):
    """In compiled code, an order of magnitude faster; its derivatives are divided differences again.

    d/dp_i exp[..., p_i, ...](t) = exp[..., p_i, p_i, ...](t)
    d/dt exp[p0, ..., pn](t) = pn exp[p0, ..., pn](t) + exp[p0, ..., p(n-1)](t)
    """

    @staticmethod
    def forward(points: Tensor, t: Tensor) -> Tensor:
        shape = np.broadcast_shapes(points.shape[:-1], t.shape)  # torch's loads a second of symbolic algebra
        rows = points.detach().expand(*shape, points.shape[-1]).reshape(-1, points.shape[-1])
        times = t.detach().expand(shape).reshape(-1)
        return torch.from_numpy(divided_differences(rows.numpy(), times.numpy())).reshape(shape)

    @staticmethod
    def setup_context(ctx, inputs, output) -> None:
        points, t = inputs
        ctx.save_for_backward(points, t, output)
        ctx.save_for_forward(points, t, output)

    @staticmethod
    def backward(ctx, *grads: Tensor):
        (grad,) = grads
        points, t, value = ctx.saved_tensors
        by_point = by_time = None
        if ctx.needs_input_grad[0]:
            rows = [(grad * _repeated(points, i, t)).sum_to_size(points.shape[:-1]) for i in range(points.shape[-1])]
            by_point = torch.stack(rows, dim=-1)
        if ctx.needs_input_grad[1]:
            by_time = (grad * _rate_of_change(points, t, value)).sum_to_size(t.shape)
        return by_point, by_time

    @staticmethod
    def jvp(ctx, *tangents: Tensor | None) -> Tensor:
        points, t, value = ctx.saved_tensors
        by_point, by_time = tangents
        total = torch.zeros_like(value)
        if by_point is not None:
            for i in range(points.shape[-1]):
                if bool((by_point[..., i] != 0).any()):
                    total = total + by_point[..., i] * _repeated(points, i, t)
        if by_time is not None and bool((by_time != 0).any()):
            total = total + by_time * _rate_of_change(points, t, value)
        return total


def _repeated(points: Tensor, i: int, t: Tensor) -> Tensor:
    return divided_difference((*points.unbind(-1), points[..., i]), t)


def _rate_of_change(points: Tensor, t: Tensor, value: Tensor) -> Tensor:
    *others, last = points.unbind(-1)
    return last * value + divided_difference(tuple(others), t)


def _recurse(ordered: Tensor, t: Tensor, first: int, last: int) -> Tensor:
    low, high = ordered[..., first], ordered[..., last]
    if first == last:
        return torch.exp(low * t)
    near = (high - low) * t < SERIES_SPREAD
    if bool(near.all()):
        return _series(ordered[..., first : last + 1], t)
    gap = torch.where(high > low, high - low, torch.ones_like(low))
    quotient = (_recurse(ordered, t, first + 1, last) - _recurse(ordered, t, first, last - 1)) / gap
    if not bool(near.any()):
        return quotient
    # Where the quotient is chosen the series may overflow, and a nan there would poison the gradient: give it no time.
    return torch.where(
        near, _series(ordered[..., first : last + 1], torch.where(near, t, torch.zeros_like(t))), quotient
    )


def _series(points: Tensor, t: Tensor) -> Tensor:
    """exp(mean t) t^n sum_k h_k((p - mean) t) / (n + k)!, h_k the complete homogeneous symmetric polynomials."""
    order = points.shape[-1] - 1
    centre = points.mean(dim=-1)
    offsets = [(points[..., i] - centre) * t for i in range(order + 1)]
    rows = [torch.ones_like(offsets[0]) for _ in offsets]  # rows[i] = h_k of the first i + 1 offsets; k = 0 here
    total = rows[-1] / math.factorial(order)
    for k in range(1, SERIES_TERMS):
        left = offsets[0] * rows[0]
        updated = [left]
        for i in range(1, order + 1):
            left = left + offsets[i] * rows[i]
            updated.append(left)
        rows = updated
        total = total + rows[-1] / float(math.factorial(order + k))
    return torch.exp(centre * t) * t**order * total


class _Recurrence(torch.autograd.Function):
    """In one compiled pass. Tangents obey dy_{i+1} = f_i dy_i + (df_i y_i + dv_i); adjoints the same, backwards."""

    @staticmethod
    def forward(factors: Tensor, values: Tensor) -> Tensor:
        n, rows = values.shape[-1], values.shape[:-1].numel()  # no -1: one knot has no steps, n = 0
        rows = walk(factors.detach().reshape(rows, n).numpy(), values.detach().reshape(rows, n).numpy())
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
        adjoint = torch.flip(recurrence(ahead, reverse)[..., 1:], [-1])[..., 1:]
        return adjoint * states[..., :-1], adjoint

    @staticmethod
    def jvp(ctx, *tangents: Tensor) -> Tensor:
        factors, states = ctx.saved_tensors
        return recurrence(factors, tangents[0] * states[..., :-1] + tangents[1])


def _doubling(factor: Tensor, value: Tensor) -> Tensor:
    """In log2(n) passes of vector operations, for devices where a loop is slow."""
    start = value.new_zeros(*value.shape[:-1], 1)
    span = 1
    while span < value.shape[-1]:
        value = torch.cat([value[..., :span], value[..., span:] + factor[..., span:] * value[..., :-span]], dim=-1)
        factor = torch.cat([factor[..., :span], factor[..., span:] * factor[..., :-span]], dim=-1)
        span *= 2
    return torch.cat([start, value], dim=-1)
