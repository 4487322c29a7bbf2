"""Divided differences of the exponential: the one formula behind every exact solution of a linear system here.

A chain of first-order systems convolves exponentials, and (Carroll 1952; McCurdy, Ng & Parlett 1984)

    e^{p0 t} * e^{p1 t} * ... * e^{pn t} = exp[p0, ..., pn](t),

the n-th divided difference of x -> e^{x t}. It is smooth where points meet, so equal rates, rates at a pole of the
input and zero rates need no special case, provided that it is computed without cancellation, as below.

Reference: McCurdy A, Ng KC, Parlett BN. Accurate computation of divided differences of the exponential function.
Math Comp 1984;43:501-528. doi:10.1090/S0025-5718-1984-0758198-0
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from petkin.dynamics.arrays import library
from petkin.jit import njit

if TYPE_CHECKING:
    from torch import Tensor

#: Below this spread (p_max - p_min) t the Taylor series is used, above it the recursion; both hold 1e-14 there.
SERIES_SPREAD = 1.0
SERIES_TERMS = 18


def exp_divided_difference(points: tuple[Tensor | Any, ...], t: Tensor | Any) -> Any:
    """exp[p0, ..., pn](t), for any order and any multiplicity of the points.

    Args:
        points: n + 1 real points (1/time), each broadcastable against `t`.
        t: time since the start, >= 0.

    Returns:
        The divided difference (time^n), of the broadcast shape of points and t; a tensor, differentiable in both, where
        one of them is a tensor, an array otherwise.

    Reference: see the module.
    """
    if library(*points, t) is not np:
        from petkin.dynamics.on_tensors import divided_difference

        return divided_difference(points, t)
    if len(points) == 1:
        return np.exp(points[0] * t)
    shape = np.broadcast_shapes(*map(np.shape, points), np.shape(t))
    rows, times = np.empty((*shape, len(points))), np.empty(shape)
    for i, point in enumerate(points):
        rows[..., i] = point
    times[...] = t
    return divided_differences(rows.reshape(-1, len(points)), times.reshape(-1)).reshape(shape)


@njit(nogil=True)
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


@njit()
def _one(p, t, table, offsets, rows):
    m = len(p)
    if (p[m - 1] - p[0]) * t < SERIES_SPREAD:
        return _series_of(p, 0, m, t, offsets, rows)
    for i in range(m):
        table[i] = np.exp(p[i] * t)
    for order in range(1, m):
        for i in range(m - order):
            gap = p[i + order] - p[i]
            if gap * t < SERIES_SPREAD:
                table[i] = _series_of(p, i, order + 1, t, offsets, rows)
            else:
                table[i] = (table[i + 1] - table[i]) / gap
    return table[0]


@njit()
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
    for k in range(1, SERIES_TERMS):
        rows[0] *= offsets[0]
        for i in range(1, m):
            rows[i] = rows[i - 1] + offsets[i] * rows[i]
        factor /= m - 1 + k
        total += rows[m - 1] * factor
        bound *= reach / k  # h_k <= binomial(m - 1 + k, k) reach^k
        if bound < 1e-17:
            break
    return np.exp(centre * t) * lead * total
