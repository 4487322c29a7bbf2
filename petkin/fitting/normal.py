"""Normal equations of many small problems in step, their inverses, and what is done where they lose digits."""

from __future__ import annotations

import numpy as np
from numba import njit

from petkin.fitting import lanes
from petkin.fitting.lanes import LANES, VECTORS

_STRICT = {"contract", "nsz"}

#: A pivot of the scaled matrix below this is taken for zero, and its inverse for this.
SMALLEST, LARGEST = 1e-14, 1e15
#: Share of the curve that a parameter must move to count as felt.
_FELT = 1e-13
_ROUNDING = 1e-16


@njit(cache=True, fastmath=_STRICT, error_model="numpy")
def normal_equations(work, column, theta, held, normal, scale, lost):
    """Lower triangle of C^T G C scaled to unit diagonal; parameters that are held, or not felt, are cut loose.

    Args:
        work: scratch of `lanes` with G in the rows from PRODUCTS on.
        column: C (P + 1, VECTORS, LANES), last the curve itself.
        theta: parameters (P, LANES).
        held: (P, LANES).
        normal: answer (P, P, LANES).
        scale: 1 / sqrt of the diagonal (P, LANES), zero for what is cut loose.
        lost: relative error of the matrix by cancellation (LANES,).
    """
    p = normal.shape[0]
    seen = np.empty((VECTORS, LANES))
    curve = np.empty(LANES)
    lost[:] = 0.0
    for q in range(p, -1, -1):
        _apply(work, column, q, seen)
        if q == p:
            for n in range(LANES):
                curve[n] = _inner(seen, column, q, n)
            continue
        for s in range(q, p):
            for n in range(LANES):
                normal[s, q, n] = _inner(seen, column, s, n)
        for n in range(LANES):
            square = normal[q, q, n]
            free = (not held[q, n]) & (square > 0.0) & (square < np.inf)
            free = free & (theta[q, n] * theta[q, n] * square > _FELT * _FELT * curve[n])
            scale[q, n] = 1.0 / np.sqrt(square) if free else 0.0
        for n in range(LANES):
            terms = _ROUNDING * _terms(work, column, q, n) * scale[q, n] * scale[q, n]
            lost[n] = max(lost[n], terms)
    for i in range(p):
        for j in range(i):
            for n in range(LANES):
                both = scale[i, n] * scale[j, n]
                normal[i, j, n] = normal[i, j, n] * both if both > 0.0 else 0.0
        for n in range(LANES):
            normal[i, i, n] = 1.0


@njit(cache=True, fastmath=_STRICT, error_model="numpy")
def _apply(work, column, q, seen):
    """G times a column."""
    for v in range(VECTORS):
        for n in range(LANES):
            k = (lanes.PRODUCTS + VECTORS * v) * LANES + n
            seen[v, n] = (
                work[k] * column[q, 0, n]
                + work[k + LANES] * column[q, 1, n]
                + work[k + 2 * LANES] * column[q, 2, n]
                + work[k + 3 * LANES] * column[q, 3, n]
                + work[k + 4 * LANES] * column[q, 4, n]
            )


@njit(cache=True, fastmath=_STRICT, error_model="numpy", forceinline=True)
def _inner(seen, column, s, n):
    return (
        seen[0, n] * column[s, 0, n]
        + seen[1, n] * column[s, 1, n]
        + seen[2, n] * column[s, 2, n]
        + seen[3, n] * column[s, 3, n]
        + seen[4, n] * column[s, 4, n]
    )


@njit(cache=True, fastmath=_STRICT, error_model="numpy", forceinline=True)
def _terms(work, column, q, n):
    """Sum of squares of what a column is made of."""
    k, step = lanes.PRODUCTS * LANES + n, (VECTORS + 1) * LANES
    return (
        work[k] * column[q, 0, n] ** 2
        + work[k + step] * column[q, 1, n] ** 2
        + work[k + 2 * step] * column[q, 2, n] ** 2
        + work[k + 3 * step] * column[q, 3, n] ** 2
        + work[k + 4 * step] * column[q, 4, n] ** 2
    )


@njit(cache=True, fastmath=_STRICT, error_model="numpy")
def invert(normal, inverse, scale, lost):
    """Inverse of the scaled matrices by Cholesky, scaled back, into the lower triangle of `normal`.

    `lost` comes in as the relative error of the matrix and goes out as that of the least pivot.
    """
    p = normal.shape[0]
    least = np.ones(LANES)
    for i in range(p):
        for j in range(i + 1):
            for k in range(j):
                for n in range(LANES):
                    normal[i, j, n] -= normal[i, k, n] * normal[j, k, n]
            for n in range(LANES):
                if i == j:
                    value = normal[i, i, n]
                    inverse[i, i, n] = 1.0 / np.sqrt(value) if value > SMALLEST else LARGEST
                    least[n] = min(least[n], max(value, 1e-300))
                else:
                    normal[i, j, n] *= inverse[j, j, n]
    for n in range(LANES):
        lost[n] /= least[n]
    for i in range(p):
        for j in range(i):
            for n in range(LANES):
                inverse[i, j, n] = 0.0
            for k in range(j, i):
                for n in range(LANES):
                    inverse[i, j, n] -= normal[i, k, n] * inverse[k, j, n]
            for n in range(LANES):
                inverse[i, j, n] *= inverse[i, i, n]
    for i in range(p):
        for j in range(i + 1):
            for n in range(LANES):
                normal[i, j, n] = 0.0
            for k in range(i, p):
                for n in range(LANES):
                    normal[i, j, n] += inverse[k, i, n] * inverse[k, j, n]
            for n in range(LANES):
                normal[i, j, n] *= scale[i, n] * scale[j, n]


@njit(cache=True, error_model="numpy")
def orthogonalise(rows, position, column, scale, answer):
    """The same inverse for one curve from its columns themselves, by modified Gram-Schmidt: half the digits lost.

    Args:
        rows: the table (R, 2 nodes).
        position: of the exponentials between nodes (m,).
        column: C (P + 1, VECTORS).
        scale: as above; what is cut loose stays so.
        answer: lower triangle (P, P).
    """
    p, size = answer.shape[0], rows.shape[0]
    vectors = np.zeros((VECTORS, size))
    vectors[0, 0] = 1.0
    for m in range(len(position)):
        i = min(int(position[m]), rows.shape[1] // 2 - 2)
        a, e = lanes.value_weights(position[m] - i), lanes.slope_weights(position[m] - i)
        for r in range(size):
            for k in range(4):
                vectors[1 + 2 * m, r] += a[k] * rows[r, 2 * i + k]
                vectors[2 + 2 * m, r] += e[k] * rows[r, 2 * i + k]
    axes = np.zeros((p, size))
    upper, inverse = np.zeros((p, p)), np.zeros((p, p))
    for q in range(p):
        if scale[q] > 0.0:
            axes[q] = scale[q] * (np.ascontiguousarray(column[q]) @ vectors)
            exact = np.sqrt(axes[q] @ axes[q])
            scale[q] /= exact
            axes[q] /= exact
        for k in range(q):
            upper[k, q] = axes[k] @ axes[q]
            axes[q] -= upper[k, q] * axes[k]
        length = np.sqrt(axes[q] @ axes[q])
        felt = length * length > SMALLEST
        inverse[q, q] = 1.0 / length if felt else (LARGEST if scale[q] > 0.0 else 0.0)
        axes[q] *= inverse[q, q] if felt else 0.0
        for j in range(q):
            total = 0.0
            for k in range(j, q):
                total += inverse[j, k] * upper[k, q]
            inverse[j, q] = -total * inverse[q, q]
    for i in range(p):
        for j in range(i + 1):
            answer[i, j] = (inverse[i, i:] @ inverse[j, i:]) * scale[i] * scale[j]
