"""One step of the fits of `box`, 32 of them at a time: what the trial costs, and which trial comes next."""

from __future__ import annotations

import numpy as np

from petkin.fitting import lanes
from petkin.fitting.lanes import LANES
from petkin.fitting.normal import ALL_ROWS, COLUMN, X0, X1, X2, apply, column, dot, sweep
from petkin.jit import njit

# Rows after those of `normal`: five parameters, the next trial, gradient and normal matrix (lower triangle by columns)
# at the parameters, and the state of a fit.
THETA, TRIAL, _GRADIENT, _NORMAL = ALL_ROWS, ALL_ROWS + 5, ALL_ROWS + 10, ALL_ROWS + 15
COST, DAMPING, _EXPECTED, STEPS, DONE, SIZE, PLAIN = range(ALL_ROWS + 30, ALL_ROWS + 37)
RATE_1, RATE_2 = ALL_ROWS + 37, ALL_ROWS + 38
ROWS = ALL_ROWS + 39

MOST_STEPS = 200
_STRICT = {"contract", "nsz"}


@njit(fastmath=_STRICT, forceinline=True)
def _beyond(w, m, n, slow, fast):
    """How far a rate lies outside its interval, in its own units; 0 where no parameter moves it."""
    rate = w[(RATE_1 + m) * LANES + n]
    k = (COLUMN + 2 + 2 * m) * LANES + n
    moves = (w[k] != 0.0) | (w[k + 5 * LANES] != 0.0) | (w[k + 10 * LANES] != 0.0)
    moves = moves | (w[k + 15 * LANES] != 0.0) | (w[k + 20 * LANES] != 0.0)
    below, above = min(rate - slow, 0.0), max(rate - fast, 0.0)
    return (below + above if moves else 0.0), (1.0 / max(slow, 1e-6) if below < 0.0 else 1.0 / fast)


@njit(fastmath=_STRICT)
def evaluate(w, axis, slow, fast, penalty):
    """Cost, gradient and normal matrix at every lane's trial; where they beat the state they become it."""
    for n in range(LANES):
        g = lanes.inner_products(w, n)
        a, e = lanes.weights_1(w, n)
        p, q = lanes.weights_2(w, n)
        h = (
            w[lanes.BLOOD_SEEN * LANES + n],
            lanes.combine(w, lanes.SEEN_1, n, a),
            lanes.combine(w, lanes.SEEN_1, n, e),
            lanes.combine(w, lanes.SEEN_2, n, p),
            lanes.combine(w, lanes.SEEN_2, n, q),
        )
        fitted = (w[X0 * LANES + n] * axis, w[X1 * LANES + n], 0.0, w[X2 * LANES + n], 0.0)
        f = apply(g, fitted)
        size = w[SIZE * LANES + n]
        plain = size - 2.0 * dot(fitted, h) + dot(fitted, f)
        r = (h[0] - f[0], h[1] - f[1], h[2] - f[2], h[3] - f[3], h[4] - f[4])
        far_1, unit_1 = _beyond(w, 0, n, slow, fast)
        far_2, unit_2 = _beyond(w, 1, n, slow, fast)
        k1, k2 = penalty * size * unit_1 * unit_1, penalty * size * unit_2 * unit_2
        cost = plain + k1 * far_1 * far_1 + k2 * far_2 * far_2
        k1, k2 = (k1 if far_1 != 0.0 else 0.0), (k2 if far_2 != 0.0 else 0.0)
        better = cost < w[COST * LANES + n]
        gain = w[COST * LANES + n] - cost
        expected = w[_EXPECTED * LANES + n]
        # Steps that gain much less than expected overshoot: less damping would make them bounce from side to side.
        factor = 0.1 if gain > 0.75 * expected else (1.0 if gain > 0.25 * expected else 4.0)
        damping = w[DAMPING * LANES + n]
        w[DAMPING * LANES + n] = max(damping * factor, 1e-12) if better else max(damping * 10.0, 1e-4)
        w[COST * LANES + n] = cost if better else w[COST * LANES + n]
        w[PLAIN * LANES + n] = plain if better else w[PLAIN * LANES + n]
        c0, c1, c2 = column(w, 0, n, axis), column(w, 1, n, axis), column(w, 2, n, axis)
        c3, c4 = column(w, 3, n, axis), column(w, 4, n, axis)
        s0, s1, s2, s3, s4 = apply(g, c0), apply(g, c1), apply(g, c2), apply(g, c3), apply(g, c4)
        u0, v0 = _moved(w, 0, n)
        u1, v1 = _moved(w, 1, n)
        u2, v2 = _moved(w, 2, n)
        u3, v3 = _moved(w, 3, n)
        u4, v4 = _moved(w, 4, n)
        t1, t2 = k1 * far_1, k2 * far_2
        _keep5(
            w,
            n,
            better,
            dot(c0, r) - t1 * u0 - t2 * v0,
            dot(c1, r) - t1 * u1 - t2 * v1,
            dot(c2, r) - t1 * u2 - t2 * v2,
            dot(c3, r) - t1 * u3 - t2 * v3,
            dot(c4, r) - t1 * u4 - t2 * v4,
        )
        _keep(w, n, better, 0, dot(s0, c0) + k1 * u0 * u0 + k2 * v0 * v0)
        _keep(w, n, better, 1, dot(s0, c1) + k1 * u0 * u1 + k2 * v0 * v1)
        _keep(w, n, better, 2, dot(s0, c2) + k1 * u0 * u2 + k2 * v0 * v2)
        _keep(w, n, better, 3, dot(s0, c3) + k1 * u0 * u3 + k2 * v0 * v3)
        _keep(w, n, better, 4, dot(s0, c4) + k1 * u0 * u4 + k2 * v0 * v4)
        _keep(w, n, better, 5, dot(s1, c1) + k1 * u1 * u1 + k2 * v1 * v1)
        _keep(w, n, better, 6, dot(s1, c2) + k1 * u1 * u2 + k2 * v1 * v2)
        _keep(w, n, better, 7, dot(s1, c3) + k1 * u1 * u3 + k2 * v1 * v3)
        _keep(w, n, better, 8, dot(s1, c4) + k1 * u1 * u4 + k2 * v1 * v4)
        _keep(w, n, better, 9, dot(s2, c2) + k1 * u2 * u2 + k2 * v2 * v2)
        _keep(w, n, better, 10, dot(s2, c3) + k1 * u2 * u3 + k2 * v2 * v3)
        _keep(w, n, better, 11, dot(s2, c4) + k1 * u2 * u4 + k2 * v2 * v4)
        _keep(w, n, better, 12, dot(s3, c3) + k1 * u3 * u3 + k2 * v3 * v3)
        _keep(w, n, better, 13, dot(s3, c4) + k1 * u3 * u4 + k2 * v3 * v4)
        _keep(w, n, better, 14, dot(s4, c4) + k1 * u4 * u4 + k2 * v4 * v4)
        _keep_theta(w, n, better)


@njit(fastmath=_STRICT, forceinline=True)
def _moved(w, q, n):
    """How a parameter moves both rates."""
    k = (COLUMN + 5 * q + 2) * LANES + n
    return w[k], w[k + 2 * LANES]


@njit(fastmath=_STRICT, forceinline=True)
def _keep(w, n, better, entry, value):
    k = (_NORMAL + entry) * LANES + n
    w[k] = value if better else w[k]


@njit(fastmath=_STRICT, forceinline=True)
def _keep5(w, n, better, g0, g1, g2, g3, g4):
    k = _GRADIENT * LANES + n
    w[k] = g0 if better else w[k]
    w[k + LANES] = g1 if better else w[k + LANES]
    w[k + 2 * LANES] = g2 if better else w[k + 2 * LANES]
    w[k + 3 * LANES] = g3 if better else w[k + 3 * LANES]
    w[k + 4 * LANES] = g4 if better else w[k + 4 * LANES]


@njit(fastmath=_STRICT, forceinline=True)
def _keep_theta(w, n, better):
    k, t = THETA * LANES + n, TRIAL * LANES + n
    w[k] = w[t] if better else w[k]
    w[k + LANES] = w[t + LANES] if better else w[k + LANES]
    w[k + 2 * LANES] = w[t + 2 * LANES] if better else w[k + 2 * LANES]
    w[k + 3 * LANES] = w[t + 3 * LANES] if better else w[k + 3 * LANES]
    w[k + 4 * LANES] = w[t + 4 * LANES] if better else w[k + 4 * LANES]


@njit(fastmath=_STRICT, forceinline=True)
def _free(w, n, q, diagonal, ends):
    """1 / sqrt of a parameter's own curvature, 0 where it is held: on a bound that the gradient pushes it against."""
    value, gradient = w[(THETA + q) * LANES + n], w[(_GRADIENT + q) * LANES + n]
    held = ((value <= ends[2, q]) & (gradient <= 0.0)) | ((value >= ends[3, q]) & (gradient >= 0.0))
    free = (not held) & (diagonal > 0.0) & (diagonal < np.inf)
    return 1.0 / np.sqrt(diagonal) if free else 0.0


@njit(fastmath=_STRICT, forceinline=True)
def _stepped(w, n, q, step, ends):
    """The trial of a parameter, inside the box, and the step that it makes."""
    value = w[(THETA + q) * LANES + n]
    trial = min(max(value + step, ends[0, q]), ends[1, q])
    w[(TRIAL + q) * LANES + n] = trial
    return trial - value


@njit(fastmath=_STRICT)
def propose(w, ends, tolerance):
    """The next trial of every lane, and which lanes are done."""
    for n in range(LANES):
        k, i = _NORMAL * LANES + n, _GRADIENT * LANES + n
        m00, m10, m20, m30 = w[k], w[k + LANES], w[k + 2 * LANES], w[k + 3 * LANES]
        m40, m11, m21, m31 = w[k + 4 * LANES], w[k + 5 * LANES], w[k + 6 * LANES], w[k + 7 * LANES]
        m41, m22, m32, m42 = w[k + 8 * LANES], w[k + 9 * LANES], w[k + 10 * LANES], w[k + 11 * LANES]
        m33, m43, m44 = w[k + 12 * LANES], w[k + 13 * LANES], w[k + 14 * LANES]
        f0, f1, f2 = _free(w, n, 0, m00, ends), _free(w, n, 1, m11, ends), _free(w, n, 2, m22, ends)
        f3, f4 = _free(w, n, 3, m33, ends), _free(w, n, 4, m44, ends)
        one = 1.0 + w[DAMPING * LANES + n]
        a = (
            one,
            m10 * f0 * f1,
            m20 * f0 * f2,
            m30 * f0 * f3,
            m40 * f0 * f4,
            one,
            m21 * f1 * f2,
            m31 * f1 * f3,
            m41 * f1 * f4,
            one,
            m32 * f2 * f3,
            m42 * f2 * f4,
            one,
            m43 * f3 * f4,
            one,
        )
        a, _ = sweep(a, 0.0)
        a, _ = sweep(a, 0.0)
        a, _ = sweep(a, 0.0)
        a, _ = sweep(a, 0.0)
        a, _ = sweep(a, 0.0)
        g0, g1, g2 = w[i] * f0, w[i + LANES] * f1, w[i + 2 * LANES] * f2
        g3, g4 = w[i + 3 * LANES] * f3, w[i + 4 * LANES] * f4
        a00, a10, a20, a30, a40, a11, a21, a31, a41, a22, a32, a42, a33, a43, a44 = a
        t0 = _stepped(w, n, 0, -f0 * (a00 * g0 + a10 * g1 + a20 * g2 + a30 * g3 + a40 * g4), ends)
        t1 = _stepped(w, n, 1, -f1 * (a10 * g0 + a11 * g1 + a21 * g2 + a31 * g3 + a41 * g4), ends)
        t2 = _stepped(w, n, 2, -f2 * (a20 * g0 + a21 * g1 + a22 * g2 + a32 * g3 + a42 * g4), ends)
        t3 = _stepped(w, n, 3, -f3 * (a30 * g0 + a31 * g1 + a32 * g2 + a33 * g3 + a43 * g4), ends)
        t4 = _stepped(w, n, 4, -f4 * (a40 * g0 + a41 * g1 + a42 * g2 + a43 * g3 + a44 * g4), ends)
        expected = 2.0 * (w[i] * t0 + w[i + LANES] * t1 + w[i + 2 * LANES] * t2)
        expected += 2.0 * (w[i + 3 * LANES] * t3 + w[i + 4 * LANES] * t4)
        expected -= m00 * t0 * t0 + m11 * t1 * t1 + m22 * t2 * t2 + m33 * t3 * t3 + m44 * t4 * t4
        expected -= 2.0 * (t0 * (m10 * t1 + m20 * t2 + m30 * t3 + m40 * t4) + t1 * (m21 * t2 + m31 * t3 + m41 * t4))
        expected -= 2.0 * (t2 * (m32 * t3 + m42 * t4) + t3 * m43 * t4)
        size, steps = w[SIZE * LANES + n], w[STEPS * LANES + n]
        least = tolerance * max(w[COST * LANES + n], 0.0) + 1e-14 * size
        done = (abs(expected) <= least) | (w[DAMPING * LANES + n] > 1e10) | (steps >= MOST_STEPS)
        w[_EXPECTED * LANES + n] = expected
        w[DONE * LANES + n] = 1.0 if done else 0.0
        w[STEPS * LANES + n] = steps if done else steps + 1.0
