"""The normal equations of `normal` where one exponential and at most three parameters are all: half the work."""

from __future__ import annotations

import numpy as np

from petkin.fitting import lanes
from petkin.fitting.lanes import LANES, OWN
from petkin.fitting.normal import (
    COLUMN,
    INVERSE,
    LARGEST_INVERSE,
    LOST,
    ROUNDING,
    SMALLEST_PIVOT,
    SPEED_1,
    X0,
    X1,
    scale_of,
    scaled,
)
from petkin.jit import njit

#: Most parameters.
PARAMETERS = 3

_STRICT = {"contract", "nsz"}


@njit()
def gather_one(w, own, position):
    """What the inner products need at every curve's rate."""
    last = np.uint64(own.shape[0] - 1)
    for n in range(LANES):
        x = position[0, n]
        i = min(np.uint64(x), last)
        w[lanes.FRACTION_1 * LANES + n] = x - i
        for k in range(OWN):
            w[(lanes.OWN_1 + k) * LANES + n] = own[i, np.uint64(k)]


@njit(fastmath=_STRICT, forceinline=True)
def _column(w, q, n, axis):
    """A parameter's column in axis, b and db/dx."""
    k = (COLUMN + 5 * q) * LANES + n
    return w[k] * axis, w[k + LANES], w[k + 2 * LANES] * w[X1 * LANES + n] * w[SPEED_1 * LANES + n]


@njit(fastmath=_STRICT, forceinline=True)
def _apply(g, c):
    """G c."""
    bb, bd, dd, lean, lean_change = g
    return (
        c[0] + lean * c[1] + lean_change * c[2],
        lean * c[0] + bb * c[1] + bd * c[2],
        lean_change * c[0] + bd * c[1] + dd * c[2],
    )


@njit(fastmath=_STRICT, forceinline=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(fastmath=_STRICT, forceinline=True)
def _terms(g, c, scale):
    """Sum of squares of what a column at unit length is made of: how much of it may have cancelled."""
    return (c[0] * c[0] + g[0] * c[1] * c[1] + g[2] * c[2] * c[2]) * scale * scale if scale > 0.0 else 0.0


@njit(fastmath=_STRICT, forceinline=True)
def _sweep(a, steepest):
    """Gauss-Jordan on the first variable of a symmetric 3 x 3 (lower triangle by columns), which then goes last."""
    a00, a10, a20, a11, a21, a22 = a
    p = 1.0 / a00 if a00 > SMALLEST_PIVOT else LARGEST_INVERSE
    b1, b2 = a10 * p, a20 * p
    return (a11 - b1 * a10, a21 - b1 * a20, b1, a22 - b2 * a20, b2, -p), max(steepest, p)


@njit(fastmath=_STRICT)
def invert_one(w, axis):
    """As `normal.invert`: the same rows are filled in, for the first three parameters."""
    for n in range(LANES):
        values, slopes = lanes.weights_1(w, n)
        g = lanes.own_products(w, lanes.OWN_1, n, values, slopes)
        c0, c1, c2 = _column(w, 0, n, axis), _column(w, 1, n, axis), _column(w, 2, n, axis)
        curve = (w[X0 * LANES + n] * axis, w[X1 * LANES + n], 0.0)
        square = _dot(_apply(g, curve), curve)
        s0, s1, s2 = _apply(g, c0), _apply(g, c1), _apply(g, c2)
        f0, f1 = scale_of(w, 0, n, _dot(s0, c0), square), scale_of(w, 1, n, _dot(s1, c1), square)
        f2 = scale_of(w, 2, n, _dot(s2, c2), square)
        a = (1.0, scaled(_dot(s0, c1), f0 * f1), scaled(_dot(s0, c2), f0 * f2), 1.0, scaled(_dot(s1, c2), f1 * f2), 1.0)
        a, steepest = _sweep(a, 0.0)
        a, steepest = _sweep(a, steepest)
        a, steepest = _sweep(a, steepest)
        k = INVERSE * LANES + n
        w[k], w[k + LANES], w[k + 2 * LANES] = -a[0] * f0 * f0, -a[1] * f0 * f1, -a[2] * f0 * f2
        w[k + 5 * LANES], w[k + 6 * LANES], w[k + 9 * LANES] = -a[3] * f1 * f1, -a[4] * f1 * f2, -a[5] * f2 * f2
        worst = max(_terms(g, c0, f0), _terms(g, c1, f1), _terms(g, c2, f2))
        w[LOST * LANES + n] = ROUNDING * worst * steepest
