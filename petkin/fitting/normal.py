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
def normal_equations(work, start, column, theta, held, normal, scale, lost, seen, square):
    """Lower triangle of C^T G C scaled to unit diagonal; parameters that are held, or not felt, are cut loose.

    Args:
        work: scratch of `lanes` with G in the rows from PRODUCTS on.
        start: first of the LANES curves in `theta` and `held`.
        column: C (P + 1, VECTORS, LANES), last the curve itself.
        theta: parameters (P, N).
        held: (P, N).
        normal: answer (P, P, LANES).
        scale: 1 / sqrt of the diagonal (P, LANES), zero for what is cut loose.
        lost: relative error of the matrix by cancellation (LANES,).
        seen, square: scratch (VECTORS, LANES), (LANES,).
    """
    p = normal.shape[0]
    _apply(work, column, p, seen)
    for n in range(LANES):
        lost[n] = 0.0
        square[n] = _inner(seen, column, p, n)
    for q in range(p):
        _apply(work, column, q, seen)
        for s in range(q, p):
            for n in range(LANES):
                normal[s, q, n] = _inner(seen, column, s, n)
        for n in range(LANES):
            own = normal[q, q, n]
            free = (not held[q, start + n]) & (own > 0.0) & (own < np.inf)
            free = free & (theta[q, start + n] ** 2 * own > _FELT * _FELT * square[n])
            scale[q, n] = 1.0 / np.sqrt(own) if free else 0.0
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
    for i in range(p):
        for j in range(i + 1):
            for k in range(j):
                for n in range(LANES):
                    normal[i, j, n] -= normal[i, k, n] * normal[j, k, n]
            for n in range(LANES):
                if i == j:
                    value = normal[i, i, n]
                    inverse[i, i, n] = 1.0 / np.sqrt(value) if value > SMALLEST else LARGEST
                else:
                    normal[i, j, n] *= inverse[j, j, n]
    for n in range(LANES):
        steepest = 0.0
        for i in range(p):
            steepest = max(steepest, inverse[i, i, n])
        lost[n] *= steepest * steepest
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


@njit(cache=True, fastmath=_STRICT, error_model="numpy")
def orthogonalise(rows, position, start, n, column, scale, normal, vectors, axes, work):
    """The same inverse for one lane from its columns themselves, by modified Gram-Schmidt: half the digits lost.

    Args:
        rows: the table (R, 2 nodes).
        position: of the exponentials between nodes (m, N).
        start, n: the curve is start + n, its lane n.
        column, scale, normal: as above; what is cut loose stays so, the answer is the lower triangle.
        vectors, axes, work: scratch (VECTORS, R), (P, R), (2, P, P).
    """
    p = normal.shape[0]
    upper, inverse = work[0], work[1]
    _read_vectors(rows, position, start + n, vectors)
    for q in range(p):
        _combine(column, scale, q, n, vectors, axes)
        for k in range(q):
            upper[k, q] = _dot(axes, k, q)
            for r in range(axes.shape[1]):
                axes[q, r] -= upper[k, q] * axes[k, r]
        square = _dot(axes, q, q)
        felt = square > SMALLEST
        inverse[q, q] = 1.0 / np.sqrt(square) if felt else (LARGEST if scale[q, n] > 0.0 else 0.0)
        for r in range(axes.shape[1]):
            axes[q, r] = axes[q, r] * inverse[q, q] if felt else 0.0
        for j in range(q):
            inverse[j, q] = 0.0
            for k in range(j, q):
                inverse[j, q] -= inverse[j, k] * upper[k, q] * inverse[q, q]
    for i in range(p):
        for j in range(i + 1):
            normal[i, j, n] = 0.0
            for k in range(i, p):
                normal[i, j, n] += inverse[i, k] * inverse[j, k] * scale[i, n] * scale[j, n]


@njit(cache=True, error_model="numpy")
def _read_vectors(rows, position, curve, vectors):
    """The five vectors of a curve."""
    for r in range(vectors.shape[1]):
        for v in range(VECTORS):
            vectors[v, r] = 0.0
        vectors[0, r] = 1.0 if r == 0 else 0.0
    for m in range(position.shape[0]):
        i = min(int(position[m, curve]), rows.shape[1] // 2 - 2)
        a, e = lanes.value_weights(position[m, curve] - i), lanes.slope_weights(position[m, curve] - i)
        for r in range(vectors.shape[1]):
            for k in range(4):
                vectors[1 + 2 * m, r] += a[k] * rows[r, 2 * i + k]
                vectors[2 + 2 * m, r] += e[k] * rows[r, 2 * i + k]


@njit(cache=True, error_model="numpy")
def _combine(column, scale, q, n, vectors, axes):
    """A parameter's column at unit length, zero where it is cut loose; its scale from the column itself."""
    for r in range(axes.shape[1]):
        axes[q, r] = 0.0
        for v in range(VECTORS):
            axes[q, r] += column[q, v, n] * vectors[v, r] * scale[q, n]
    if scale[q, n] > 0.0:
        length = np.sqrt(_dot(axes, q, q))
        scale[q, n] /= length
        for r in range(axes.shape[1]):
            axes[q, r] /= length


@njit(cache=True, error_model="numpy")
def _dot(axes, i, j):
    total = 0.0
    for r in range(axes.shape[1]):
        total += axes[i, r] * axes[j, r]
    return total
