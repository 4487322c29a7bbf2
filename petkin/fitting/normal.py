"""Inverse normal equations of many curves in step, and what is done where they lose digits.

The column of a parameter in the Jacobian is a combination of five vectors, the axis, both atoms and both of their
derivatives, whose inner products are tabulated: J^T W J = C^T G C with G 5 x 5, no vector of frames is touched. Five
parameters are room for every model here; what is held, not felt or absent is cut loose. All is straight-line code on
one flat array of rows, as in `lanes`, which the compiler turns into vector registers.
"""

from __future__ import annotations

import numpy as np

from petkin.fitting import lanes
from petkin.fitting.lanes import LANES, ROWS
from petkin.jit import njit

#: Most parameters, and vectors that their columns are made of.
PARAMETERS, VECTORS = 5, 5

# Rows after those that `lanes` gathers: the curve at the optimum, then five a parameter: value, derivatives of the
# amplitude on the axis, of amplitude and rate of the first exponential, of the second; whether it is free (1.0) ...
X0, X1, X2, SPEED_1, SPEED_2 = range(ROWS, ROWS + 5)
VALUE, COLUMN, FREE = ROWS + 5, ROWS + 10, ROWS + 35
# ... and the answers: 1 / length of a column (0 where cut loose), lower triangle of the inverse, relative error.
SCALE, INVERSE, LOST = ROWS + 40, ROWS + 45, ROWS + 60
ALL_ROWS = ROWS + 61

_STRICT = {"contract", "nsz"}
#: A pivot of the scaled matrix below this is taken for zero, and its inverse for this.
SMALLEST_PIVOT, LARGEST_INVERSE = 1e-14, 1e30
#: Share of the curve that a parameter must move to count as felt.
_FELT = 1e-13
ROUNDING = 1e-16


@njit(fastmath=_STRICT, forceinline=True)
def column(w, q, n, axis):
    """A parameter's column in the five vectors."""
    k = (COLUMN + 5 * q) * LANES + n
    moved_1 = w[k + 2 * LANES] * w[X1 * LANES + n] * w[SPEED_1 * LANES + n]
    moved_2 = w[k + 4 * LANES] * w[X2 * LANES + n] * w[SPEED_2 * LANES + n]
    return w[k] * axis, w[k + LANES], moved_1, w[k + 3 * LANES], moved_2


@njit(fastmath=_STRICT, forceinline=True)
def apply(g, c):
    """G c; G = (l1, k1, l2, k2 on the axis, then rows of the rest's upper triangle)."""
    l1, k1, l2, k2, g11, c11, g12, c21, d11, c12, d12, g22, c22, d22 = g
    return (
        c[0] + l1 * c[1] + k1 * c[2] + l2 * c[3] + k2 * c[4],
        l1 * c[0] + g11 * c[1] + c11 * c[2] + g12 * c[3] + c21 * c[4],
        k1 * c[0] + c11 * c[1] + d11 * c[2] + c12 * c[3] + d12 * c[4],
        l2 * c[0] + g12 * c[1] + c12 * c[2] + g22 * c[3] + c22 * c[4],
        k2 * c[0] + c21 * c[1] + d12 * c[2] + c22 * c[3] + d22 * c[4],
    )


@njit(fastmath=_STRICT, forceinline=True)
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4]


@njit(fastmath=_STRICT, forceinline=True)
def scale_of(w, q, n, own, square):
    """1 / length of a column; 0 where the parameter is held or moves the curve by nothing but rounding."""
    felt = w[VALUE * LANES + q * LANES + n] ** 2 * own > _FELT * _FELT * square
    free = (w[(FREE + q) * LANES + n] > 0.0) & (own > 0.0) & (own < np.inf) & felt
    scale = 1.0 / np.sqrt(own) if free else 0.0
    w[(SCALE + q) * LANES + n] = scale
    return scale


@njit(fastmath=_STRICT, forceinline=True)
def _terms(g, c, scale):
    """Sum of squares of what a column at unit length is made of: how much of it may have cancelled."""
    total = c[0] * c[0] + g[4] * c[1] * c[1] + g[8] * c[2] * c[2] + g[11] * c[3] * c[3] + g[13] * c[4] * c[4]
    return total * scale * scale if scale > 0.0 else 0.0


@njit(fastmath=_STRICT, forceinline=True)
def sweep(a, steepest):
    """Gauss-Jordan on the first variable of a symmetric 5 x 5 (lower triangle by columns), which then goes last.

    Five of them leave minus the inverse in the first order.
    """
    a00, a10, a20, a30, a40, a11, a21, a31, a41, a22, a32, a42, a33, a43, a44 = a
    p = 1.0 / a00 if a00 > SMALLEST_PIVOT else LARGEST_INVERSE
    b1, b2, b3, b4 = a10 * p, a20 * p, a30 * p, a40 * p
    swept = (
        a11 - b1 * a10,
        a21 - b1 * a20,
        a31 - b1 * a30,
        a41 - b1 * a40,
        b1,
        a22 - b2 * a20,
        a32 - b2 * a30,
        a42 - b2 * a40,
        b2,
        a33 - b3 * a30,
        a43 - b3 * a40,
        b3,
        a44 - b4 * a40,
        b4,
        -p,
    )
    return swept, max(steepest, p)


@njit(fastmath=_STRICT)
def invert(w, axis):
    """Inverse of C^T G C from the gathered rows and the columns, and its relative error by cancellation."""
    for n in range(LANES):
        g = lanes.inner_products(w, n)
        c0, c1, c2 = column(w, 0, n, axis), column(w, 1, n, axis), column(w, 2, n, axis)
        c3, c4 = column(w, 3, n, axis), column(w, 4, n, axis)
        curve = (w[X0 * LANES + n] * axis, w[X1 * LANES + n], 0.0, w[X2 * LANES + n], 0.0)
        square = dot(apply(g, curve), curve)
        s0, s1, s2, s3, s4 = apply(g, c0), apply(g, c1), apply(g, c2), apply(g, c3), apply(g, c4)
        f0, f1 = scale_of(w, 0, n, dot(s0, c0), square), scale_of(w, 1, n, dot(s1, c1), square)
        f2, f3 = scale_of(w, 2, n, dot(s2, c2), square), scale_of(w, 3, n, dot(s3, c3), square)
        f4 = scale_of(w, 4, n, dot(s4, c4), square)
        a = (
            1.0,
            scaled(dot(s0, c1), f0 * f1),
            scaled(dot(s0, c2), f0 * f2),
            scaled(dot(s0, c3), f0 * f3),
            scaled(dot(s0, c4), f0 * f4),
            1.0,
            scaled(dot(s1, c2), f1 * f2),
            scaled(dot(s1, c3), f1 * f3),
            scaled(dot(s1, c4), f1 * f4),
            1.0,
            scaled(dot(s2, c3), f2 * f3),
            scaled(dot(s2, c4), f2 * f4),
            1.0,
            scaled(dot(s3, c4), f3 * f4),
            1.0,
        )
        steepest = 0.0
        a, steepest = sweep(a, steepest)
        a, steepest = sweep(a, steepest)
        a, steepest = sweep(a, steepest)
        a, steepest = sweep(a, steepest)
        a, steepest = sweep(a, steepest)
        _store(w, n, a, f0, f1, f2, f3, f4)
        worst = max(_terms(g, c0, f0), _terms(g, c1, f1), _terms(g, c2, f2), _terms(g, c3, f3), _terms(g, c4, f4))
        w[LOST * LANES + n] = ROUNDING * worst * steepest


@njit(fastmath=_STRICT, forceinline=True)
def scaled(value, both):
    return value * both if both > 0.0 else 0.0


@njit(fastmath=_STRICT, forceinline=True)
def _store(w, n, a, f0, f1, f2, f3, f4):
    """Minus the swept matrix, scaled back."""
    k = INVERSE * LANES + n
    w[k], w[k + LANES], w[k + 2 * LANES] = -a[0] * f0 * f0, -a[1] * f0 * f1, -a[2] * f0 * f2
    w[k + 3 * LANES], w[k + 4 * LANES] = -a[3] * f0 * f3, -a[4] * f0 * f4
    w[k + 5 * LANES], w[k + 6 * LANES], w[k + 7 * LANES] = -a[5] * f1 * f1, -a[6] * f1 * f2, -a[7] * f1 * f3
    w[k + 8 * LANES], w[k + 9 * LANES], w[k + 10 * LANES] = -a[8] * f1 * f4, -a[9] * f2 * f2, -a[10] * f2 * f3
    w[k + 11 * LANES], w[k + 12 * LANES], w[k + 13 * LANES] = -a[11] * f2 * f4, -a[12] * f3 * f3, -a[13] * f3 * f4
    w[k + 14 * LANES] = -a[14] * f4 * f4


@njit()
def invert_again(w, n, axis, rows, position_1, position_2, vectors, axes, upper, inverse):
    """The same for one lane from the columns themselves, by modified Gram-Schmidt: half the digits lost.

    Args:
        w: scratch after `invert`.
        n: the lane.
        axis: length of the column along the first coordinate.
        rows: the table (R, 2 nodes).
        position_1, position_2: of the exponentials between nodes.
        vectors, axes, upper, inverse: scratch (VECTORS, R), (PARAMETERS, R), (PARAMETERS, PARAMETERS) twice.
    """
    for r in range(vectors.shape[1]):
        vectors[0, r] = 1.0 if r == 0 else 0.0
    _read_vectors(rows, position_1, vectors[1], vectors[2])
    _read_vectors(rows, position_2, vectors[3], vectors[4])
    for q in range(PARAMETERS):
        _combine(w, q, n, axis, vectors, axes[q])
        for k in range(q):
            upper[k, q] = np.sum(axes[k] * axes[q])
            axes[q] -= upper[k, q] * axes[k]
        square = np.sum(axes[q] * axes[q])
        felt = square > SMALLEST_PIVOT
        free = w[(SCALE + q) * LANES + n] > 0.0
        inverse[q, q] = 1.0 / np.sqrt(square) if felt else (np.sqrt(LARGEST_INVERSE) if free else 0.0)
        axes[q] *= inverse[q, q] if felt else 0.0
        for j in range(q):
            inverse[j, q] = 0.0
            for k in range(j, q):
                inverse[j, q] -= inverse[j, k] * upper[k, q] * inverse[q, q]
    entry = INVERSE
    for j in range(PARAMETERS):
        for i in range(j, PARAMETERS):
            total = 0.0
            for k in range(i, PARAMETERS):
                total += inverse[i, k] * inverse[j, k]
            w[entry * LANES + n] = total * w[(SCALE + i) * LANES + n] * w[(SCALE + j) * LANES + n]
            entry += 1


@njit()
def _read_vectors(rows, position, value, slope):
    """b and db/dx at a position."""
    i = min(int(position), rows.shape[1] // 2 - 2)
    a, e = lanes.value_weights(position - i), lanes.slope_weights(position - i)
    for r in range(len(value)):
        four = rows[r, 2 * i : 2 * i + 4]
        value[r] = a[0] * four[0] + a[1] * four[1] + a[2] * four[2] + a[3] * four[3]
        slope[r] = e[0] * four[0] + e[1] * four[1] + e[2] * four[2] + e[3] * four[3]


@njit()
def _combine(w, q, n, axis, vectors, there):
    """A parameter's column at unit length, zero where it is cut loose; its scale from the column itself."""
    c = column(w, q, n, axis)
    k = (SCALE + q) * LANES + n
    for r in range(len(there)):
        there[r] = 0.0
        if w[k] > 0.0:
            there[r] = (
                c[0] * vectors[0, r]
                + c[1] * vectors[1, r]
                + c[2] * vectors[2, r]
                + c[3] * vectors[3, r]
                + c[4] * vectors[4, r]
            )
    if w[k] > 0.0:
        w[k] = 1.0 / np.sqrt(np.sum(there * there))
        there *= w[k]
