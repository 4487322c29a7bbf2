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

import torch
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
    ordered = torch.sort(stacked, dim=-1).values
    return _recurse(ordered, t, 0, len(tensors) - 1)


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
    # Where the quotient is chosen the series may overflow, and a nan there would poison the gradient: feed it zero time.
    return torch.where(near, _series(ordered[..., first : last + 1], torch.where(near, t, torch.zeros_like(t))), quotient)


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
