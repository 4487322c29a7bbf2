"""Divided differences of the exponential: the one formula behind every exact solution of a linear system here.

A chain of first-order systems convolves exponentials, and (Carroll 1952; McCurdy, Ng & Parlett 1984)

    e^{p0 t} * e^{p1 t} * ... * e^{pn t} = exp[p0, ..., pn](t),

the n-th divided difference of x -> e^{x t}. It is smooth where points meet, so equal rates, rates at a pole of the
input and zero rates need no special case, provided that it is computed without cancellation, as below.

Reference: McCurdy A, Ng KC, Parlett BN. Accurate computation of divided differences of the exponential function.
Math Comp 1984;43:501-528. doi:10.1090/S0025-5718-1984-0758198-0
"""

from __future__ import annotations

import math

import numpy as np
import torch
from numba import njit
from torch import Tensor

#: Below this spread (p_max - p_min) t the Taylor series is used, above it the recursion; both hold 1e-14 there.
_SERIES_SPREAD = 1.0
_SERIES_TERMS = 18


def exp_divided_difference(points: tuple[Tensor | float, ...], t: Tensor) -> Tensor:
    """exp[p0, ..., pn](t), for any order and any multiplicity of the points.

    Args:
        points: n + 1 real points (1/time), each broadcastable against `t`.
        t: time since the start, >= 0.

    Returns:
        The divided difference (time^n), of the broadcast shape of points and t; differentiable in both.

    Reference: see the module.
    """
    tensors = [torch.as_tensor(p, dtype=t.dtype, device=t.device) for p in points]
    if len(tensors) == 1:
        return torch.exp(tensors[0] * t)
    stacked = torch.stack(torch.broadcast_tensors(*tensors), dim=-1)
    if t.device.type == "cpu" and t.dtype == torch.float64:
        return _Compiled.apply(stacked, t)  # type: ignore[no-any-return]
    ordered = torch.sort(stacked, dim=-1).values
    return _recurse(ordered, t, 0, len(tensors) - 1)


class _Compiled(torch.autograd.Function):
    """The same in compiled code, an order of magnitude faster; its derivatives are divided differences again.

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
    return exp_divided_difference((*points.unbind(-1), points[..., i]), t)


def _rate_of_change(points: Tensor, t: Tensor, value: Tensor) -> Tensor:
    *others, last = points.unbind(-1)
    return last * value + exp_divided_difference(tuple(others), t)


@njit(cache=True, nogil=True, error_model="numpy")
def divided_differences(points, t):
    """exp[points[n]](t[n]) for every row of points (N, m), float64."""
    count, m = points.shape
    answer = np.empty(count)
    p, table, offsets, rows = np.empty(m), np.empty(m), np.empty(m), np.empty(m)
    for n in range(count):
        for i in range(m):  # insertion sort, ascending
            value = points[n, i]
            j = i
            while j > 0 and p[j - 1] > value:
                p[j] = p[j - 1]
                j -= 1
            p[j] = value
        answer[n] = _one(p, t[n], table, offsets, rows)
    return answer


@njit(cache=True, error_model="numpy")
def _one(p, t, table, offsets, rows):
    m = len(p)
    if (p[m - 1] - p[0]) * t < _SERIES_SPREAD:
        return _series_of(p, 0, m, t, offsets, rows)
    for i in range(m):
        table[i] = np.exp(p[i] * t)
    for order in range(1, m):
        for i in range(m - order):
            gap = p[i + order] - p[i]
            if gap * t < _SERIES_SPREAD:
                table[i] = _series_of(p, i, order + 1, t, offsets, rows)
            else:
                table[i] = (table[i + 1] - table[i]) / gap
    return table[0]


@njit(cache=True, error_model="numpy")
def _series_of(p, first, m, t, offsets, rows):
    """As `_series` over p[first : first + m], ended where further terms no longer count."""
    centre = 0.0
    for i in range(m):
        centre += p[first + i]
    centre /= m
    lead = 1.0
    for i in range(m):
        offsets[i] = (p[first + i] - centre) * t
        rows[i] = 1.0
        if i > 0:
            lead *= t / i
    reach = max(offsets[m - 1], -offsets[0])
    factor = total = bound = 1.0
    for k in range(1, _SERIES_TERMS):
        rows[0] *= offsets[0]
        for i in range(1, m):
            rows[i] = rows[i - 1] + offsets[i] * rows[i]
        factor /= m - 1 + k
        total += rows[m - 1] * factor
        bound *= reach / k  # h_k <= binomial(m - 1 + k, k) reach^k
        if bound < 1e-17:
            break
    return np.exp(centre * t) * lead * total


def _recurse(ordered: Tensor, t: Tensor, first: int, last: int) -> Tensor:
    low, high = ordered[..., first], ordered[..., last]
    if first == last:
        return torch.exp(low * t)
    near = (high - low) * t < _SERIES_SPREAD
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
    for k in range(1, _SERIES_TERMS):
        left = offsets[0] * rows[0]
        updated = [left]
        for i in range(1, order + 1):
            left = left + offsets[i] * rows[i]
            updated.append(left)
        rows = updated
        total = total + rows[-1] / float(math.factorial(order + k))
    return torch.exp(centre * t) * t**order * total
