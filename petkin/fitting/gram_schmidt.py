"""Compiled passes of `linear`: curves in step, orthogonalised by modified Gram-Schmidt, with what their noise does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.jit import njit

Array = NDArray[np.float64]

#: Curves in step. As in `lanes`, no loop that rounds has a remainder that might round another way; rows of lanes are
#: passed by number, never as views, which cost more than the sums over them.
_LANES = 64
_STRICT = {"contract", "nsz"}
#: Activity (kBq/mL) from which on a value counts as infinite: its square must stay a number.
_LARGEST = 1e30
#: A column whose part outside the span of the others is shorter than this share of it says nothing new.
INDEPENDENT = 1e-12


def scratch(frames: int, vectors: int, used: int, unknowns: int) -> tuple[Array, ...]:
    """Rows of lanes: curves, vectors, components, lengths, triangular inverse, noise, products, sums."""
    square = unknowns * unknowns
    rows = frames, vectors * used, vectors * unknowns, vectors, square, unknowns * frames, 2 * square, 2
    return tuple(np.zeros((count, _LANES)) for count in rows)


@njit(nogil=True, fastmath=_STRICT)
def solve_curves(frames, offset, scale, operators, spans, axes, inverse, spread, lanes, answer):
    """Fill `answer` (unknowns, covariance, WRSS, freedom, total, finite) of curves (K, N), frames first.

    The other arguments are those of `LinearSolver`; `lanes` is `scratch`. Without own columns, covariance and freedom
    are left alone: all curves have the same.
    """
    y, vectors, parts, lengths, triangle, noise, products, sums = lanes
    theta, covariance, wrss, freedom, total, finite = answer
    unknowns, last = theta.shape[0], operators.shape[0] - 1
    for first in range(0, len(wrss), _LANES):
        width = min(_LANES, len(wrss) - first)
        here = slice(first, first + width)
        _read(frames[:, here], offset, scale, y, sums)
        total[here] = sums[0, :width]
        finite[here] = sums[1, :width] == 0.0
        for v in range(last + 1):
            _apply(operators[v], spans[v], y, vectors, v)
            _orthogonalise(v, vectors, axes, parts, lengths, sums)
        _invert(parts, inverse, triangle, unknowns)
        wrss[here] = lengths[last, :width]
        for i in range(unknowns):
            _inner(triangle, i * unknowns, parts, last * unknowns, unknowns, products, i)
            theta[i, here] = products[i, :width]
        if last > 0:
            _spread_noise(spread, vectors, lengths, products, noise, sums, axes.shape[0], unknowns)
            freedom[here] = sums[0, :width]
            _covariance(noise, triangle, products, unknowns, y.shape[0])
            for i in range(unknowns):
                for m in range(unknowns):
                    covariance[i, m, here] = products[max(i, m) * unknowns + min(i, m), :width]


@njit(nogil=True, fastmath=_STRICT)
def _read(block, offset, scale, y, sums):
    """Curves without their offset; in `sums`, the total of each and how many of its values are no numbers."""
    for n in range(_LANES):
        sums[0, n], sums[1, n] = 0.0, 0.0
    for k in range(block.shape[0]):
        for n in range(block.shape[1]):
            y[k, n] = block[k, n]
        for n in range(_LANES):
            sums[0, n] += y[k, n]
        for n in range(_LANES):
            sums[1, n] += 0.0 if abs(y[k, n]) < _LARGEST else 1.0
        for n in range(_LANES):
            y[k, n] = (y[k, n] - offset[k]) * scale


@njit(nogil=True, fastmath=_STRICT)
def _apply(operator, spans, y, vectors, v):
    """Vector v of every curve: operator times curve."""
    used = operator.shape[0]
    for u in range(used):
        _combine(operator, u, spans[u, 0], spans[u, 1], y, 0, vectors, v * used + u)


@njit(nogil=True, fastmath=_STRICT)
def _combine(matrix, row, begin, end, x, base, out, at):
    """out[at] = sum_k matrix[row, k] x[base + k], begin <= k < end."""
    for n in range(_LANES):
        out[at, n] = 0.0
    k = begin
    while k + 4 <= end:
        a, b, c, d = matrix[row, k], matrix[row, k + 1], matrix[row, k + 2], matrix[row, k + 3]
        i = base + k
        for n in range(_LANES):
            out[at, n] += (a * x[i, n] + b * x[i + 1, n]) + (c * x[i + 2, n] + d * x[i + 3, n])
        k += 4
    while k < end:
        for n in range(_LANES):
            out[at, n] += matrix[row, k] * x[base + k, n]
        k += 1


@njit(nogil=True, fastmath=_STRICT)
def _inner(x, i, y, j, count, out, at):
    """out[at] = sum_u x[i + u] y[j + u]."""
    for n in range(_LANES):
        out[at, n] = 0.0
    for u in range(count):
        for n in range(_LANES):
            out[at, n] += x[i + u, n] * y[j + u, n]


@njit(nogil=True, fastmath=_STRICT)
def _orthogonalise(v, vectors, axes, parts, lengths, sums):
    """Vector v without its components along the axes and the vectors before it; `lengths`, squared, what is left."""
    shared, used = axes.shape
    own, part = v * used, v * (parts.shape[0] // lengths.shape[0])
    _inner(vectors, own, vectors, own, used, sums, 0)
    for s in range(shared):
        _combine(axes, s, 0, used, vectors, own, parts, part + s)
        for u in range(used):
            for n in range(_LANES):
                vectors[own + u, n] -= axes[s, u] * parts[part + s, n]
    for j in range(v):
        at = part + shared + j
        _inner(vectors, j * used, vectors, own, used, parts, at)
        for n in range(_LANES):
            parts[at, n] /= lengths[j, n]
        for u in range(used):
            for n in range(_LANES):
                vectors[own + u, n] -= vectors[j * used + u, n] * parts[at, n]
    _inner(vectors, own, vectors, own, used, lengths, v)
    if v < lengths.shape[0] - 1:
        for n in range(_LANES):
            new = lengths[v, n] > INDEPENDENT * INDEPENDENT * sums[0, n]
            lengths[v, n] = lengths[v, n] if new else np.nan


@njit(nogil=True, fastmath=_STRICT)
def _invert(parts, inverse, triangle, unknowns):
    """Inverse of the triangular matrix that makes the columns from the orthogonal vectors."""
    shared = inverse.shape[0]
    for i in range(unknowns):
        for j in range(unknowns):
            fixed = inverse[i, j] if i < shared and j < shared else (1.0 if i == j else 0.0)
            for n in range(_LANES):
                triangle[i * unknowns + j, n] = fixed
    for j in range(shared, unknowns):
        for i in range(j - 1, -1, -1):
            at = i * unknowns + j
            for m in range(max(shared, i + 1), j + 1):
                _subtract_product(triangle, at, parts, (m - shared) * unknowns + i, m * unknowns + j)
        for i in range(shared):  # from components along the axes to unknowns; rows below still hold components
            at = i * unknowns + j
            for n in range(_LANES):
                triangle[at, n] *= inverse[i, i]
            for m in range(i + 1, shared):
                for n in range(_LANES):
                    triangle[at, n] += inverse[i, m] * triangle[m * unknowns + j, n]


@njit(nogil=True, fastmath=_STRICT)
def _subtract_product(triangle, at, parts, i, j):
    for n in range(_LANES):
        triangle[at, n] -= parts[i, n] * triangle[j, n]


@njit(nogil=True, fastmath=_STRICT)
def _spread_noise(spread, vectors, lengths, theta, noise, sums, shared, unknowns):
    """How every frame's noise moves the components along axes and vectors; in `sums`, the freedom of the residuals.

    Row i * frames + k of `noise`: component i per unit noise of frame k, from L = R - sum theta_j O_j.
    """
    transposed, spans, along, traces = spread
    last, frames, used = transposed.shape[0] - 1, transposed.shape[1], transposed.shape[2]
    for n in range(_LANES):
        sums[0, n] = traces[last, last]
    for v in range(last):
        for n in range(_LANES):
            sums[0, n] -= 2.0 * traces[last, v] * theta[shared + v, n]
        for m in range(last):
            for n in range(_LANES):
                sums[0, n] += traces[v, m] * theta[shared + v, n] * theta[shared + m, n]
    for s in range(shared):
        for k in range(frames):
            for n in range(_LANES):
                noise[s * frames + k, n] = along[last, s, k]
            for v in range(last):
                for n in range(_LANES):
                    noise[s * frames + k, n] -= along[v, s, k] * theta[shared + v, n]
    for j in range(last):
        for k in range(frames):
            at = (shared + j) * frames + k
            _combine(transposed[last], k, spans[last, k, 0], spans[last, k, 1], vectors, j * used, noise, at)
            for v in range(last):
                _combine(transposed[v], k, spans[v, k, 0], spans[v, k, 1], vectors, j * used, sums, 1)
                for n in range(_LANES):
                    noise[at, n] -= sums[1, n] * theta[shared + v, n]
            for n in range(_LANES):
                noise[at, n] /= lengths[j, n]
    for i in range(unknowns):
        _inner(noise, i * frames, noise, i * frames, frames, sums, 1)
        for n in range(_LANES):
            sums[0, n] -= sums[1, n] * (lengths[i - shared, n] if i >= shared else 1.0)


@njit(nogil=True, fastmath=_STRICT)
def _covariance(noise, triangle, products, unknowns, frames):
    """T M T^T into the lower triangle of `products`, M the inner products of the rows of noise, T the inverse."""
    square = unknowns * unknowns
    for i in range(unknowns):
        for m in range(i + 1):
            at = i * unknowns + m
            _inner(noise, i * frames, noise, m * frames, frames, products, at)
            for n in range(_LANES):
                products[m * unknowns + i, n] = products[at, n]
    for i in range(unknowns):
        for m in range(unknowns):  # M is symmetric: its rows are its columns
            _inner(triangle, i * unknowns, products, m * unknowns, unknowns, products, square + i * unknowns + m)
    for i in range(unknowns):
        for m in range(i + 1):
            _inner(products, square + i * unknowns, triangle, m * unknowns, unknowns, products, i * unknowns + m)
