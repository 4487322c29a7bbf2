"""Standard errors of every curve: the compiled Gauss-Newton covariance."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from petkin.fitting.sensitivity import derivatives
from petkin.fitting.table import RATE_OFFSET, Compression
from petkin.kinetics import CompartmentModel

Array = NDArray[np.float64]
_FAST = {"reassoc", "contract", "nsz", "arcp"}


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def read(basis, slope, low, spacing, u, b, d):
    """Cubic Hermite reading of b(u) and db/du."""
    x = (u - low) / spacing
    i = min(max(int(x), 0), basis.shape[0] - 2)
    s = x - i
    s2 = s * s
    s3 = s2 * s
    h00 = 2.0 * s3 - 3.0 * s2 + 1.0
    h10 = (s3 - 2.0 * s2 + s) * spacing
    h01 = 3.0 * s2 - 2.0 * s3
    h11 = (s3 - s2) * spacing
    p00 = (6.0 * s2 - 6.0 * s) / spacing
    p10 = 3.0 * s2 - 4.0 * s + 1.0
    p11 = 3.0 * s2 - 2.0 * s
    for r in range(basis.shape[1]):
        b[r] = h00 * basis[i, r] + h10 * slope[i, r] + h01 * basis[i + 1, r] + h11 * slope[i + 1, r]
        d[r] = p00 * (basis[i, r] - basis[i + 1, r]) + p10 * slope[i, r] + p11 * slope[i + 1, r]


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def dot(a, b):
    total = 0.0
    for r in range(a.shape[0]):
        total += a[r] * b[r]
    return total


def covariances(model: CompartmentModel, packed: Compression, parameters: Array, held: NDArray[np.bool_]) -> Array:
    """(J^T W J)^-1 of every curve, W the frame weights.

    Args:
        model: compartment model.
        packed: compressed table.
        parameters: (N, P).
        held: (N, P), parameters that count as known (fixed, or on a bound).

    Returns:
        (N, P, P): zero rows for held parameters; 1e30 times the scale where the rest cannot be told apart.
    """
    exponentials, chain = derivatives(
        lambda *k: tuple(v for pair in model.impulse(*k) for v in pair), parameters[:, :-1]
    )
    spacing = float(packed.u[1] - packed.u[0])
    vB = np.ascontiguousarray(parameters[:, -1])
    return _invert_all(
        packed.basis, packed.slope, float(packed.u[0]), spacing, packed.blood, exponentials, chain, vB, held
    )


@njit(cache=True, parallel=True, error_model="numpy")
def _invert_all(basis, slope, low, spacing, blood, exponentials, chain, vB, held):
    count, size, rates = len(vB), basis.shape[1], chain.shape[2]
    pairs = exponentials.shape[1] // 2
    p = rates + 1
    answer = np.zeros((count, p, p))
    high = low + spacing * (basis.shape[0] - 1)
    for n in prange(count):
        columns = np.zeros((p, size))
        b, d = np.empty(size), np.empty(size)
        for m in range(pairs):
            phi, rate = exponentials[n, 2 * m], exponentials[n, 2 * m + 1]
            u = min(max(np.log(rate + RATE_OFFSET), low), high)
            read(basis, slope, low, spacing, u, b, d)
            speed = phi / (rate + RATE_OFFSET)
            for q in range(rates):
                up, across = chain[n, 2 * m, q] * (1.0 - vB[n]), chain[n, 2 * m + 1, q] * speed * (1.0 - vB[n])
                for r in range(size):
                    columns[q, r] += up * b[r] + across * d[r]
            for r in range(size):
                columns[rates, r] -= phi * b[r]
        columns[rates, 0] += blood
        _invert(columns, held[n], answer[n])
    return answer


@njit(cache=True, error_model="numpy")
def _invert(columns, held, out):
    """Inverse of the Gram matrix of the free columns, scaled to unit diagonal, by Cholesky."""
    p = columns.shape[0]
    free = np.empty(p, np.int64)
    scale = np.empty(p)
    count = 0
    for q in range(p):
        norm = np.sqrt(dot(columns[q], columns[q]))
        if not held[q] and norm > 0.0 and np.isfinite(norm):
            free[count] = q
            scale[count] = norm
            count += 1
    lower = np.zeros((count, count))
    for i in range(count):
        for j in range(i + 1):
            value = dot(columns[free[i]], columns[free[j]]) / (scale[i] * scale[j])
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            if i == j:
                lower[i, i] = np.sqrt(value) if value > 1e-14 else 1e-15
            else:
                lower[i, j] = value / lower[j, j]
    inverse = np.zeros((count, count))  # of the lower triangle
    for i in range(count):
        inverse[i, i] = 1.0 / lower[i, i]
        for j in range(i):
            value = 0.0
            for k in range(j, i):
                value -= lower[i, k] * inverse[k, j]
            inverse[i, j] = value / lower[i, i]
    for i in range(count):
        for j in range(i + 1):
            value = 0.0
            for k in range(i, count):
                value += inverse[k, i] * inverse[k, j]
            value /= scale[i] * scale[j]
            out[free[i], free[j]] = value
            out[free[j], free[i]] = value
