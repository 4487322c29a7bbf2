"""The polish where one rate is free: Newton's steps on what is explained with the amplitudes projected out.

With the columns at work projected out of b and z, the gain is h^2 / g, g = b.b and h = b.z, and x1 = h / g. Readings
between nodes are cubic, so its second derivative is at hand from the same tabulated numbers (see `lanes`).

Positions x count table nodes: u = low + spacing x.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from petkin.fitting.lanes import MAX_STEPS, amplitudes, slope_weights, value_weights
from petkin.fitting.lanes import OWN as RECORD
from petkin.fitting.scan import BLOCK

# Scratch is one flat array of rows of BLOCK numbers, so that the compiler sees that rows do not overlap: the state of
# a curve, ...
POSITION, TRIAL, FIRST, SECOND, THIRD, GAIN, STEPS, DONE, SIZE, ON_AXIS, ON_TRAP = range(11)
# ... and what is gathered at its trial: cell, record of `own`, rows on the curve, rows on b(0).
CELL, OWN, SEEN, TRAP = 11, 12, 26, 30
ROWS = 34
#: Where a curve is: 0 under way, 1 on its last step, or
ENDED = 2.0

#: Largest step, in nodes.
_REACH = 3.0
#: Steps back shorter than this, in nodes, gain nothing but rounding.
_NEAR = 1e-7
#: Below this share of its length, an exponential off the other columns counts as one of them.
_SAME = 1e-12

#: Sums are not reassociated: a curve's result does not depend on its neighbours, to the bit.
_STRICT = {"contract", "nsz"}


@njit(cache=True, fastmath=_STRICT, error_model="numpy")
def gather(z, rows, own, trap, trapped, size, work):
    """What the formulas need of every trial's cell, where it is another than before."""
    cells = np.uint64(own.shape[0] - 1)
    for n in range(size):
        cell = min(np.uint64(work[TRIAL * BLOCK + n]), cells)
        if work[CELL * BLOCK + n] == float(cell):
            continue
        work[CELL * BLOCK + n] = float(cell)
        for k in range(RECORD):
            work[(OWN + k) * BLOCK + n] = own[cell, np.uint64(k)]
        j = np.uint64(2) * cell
        j1, j2, j3 = j + np.uint64(1), j + np.uint64(2), j + np.uint64(3)
        s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
        for r in range(z.shape[0]):
            here = z[r, n]
            s0 += rows[r, j] * here
            s1 += rows[r, j1] * here
            s2 += rows[r, j2] * here
            s3 += rows[r, j3] * here
        work[SEEN * BLOCK + n], work[(SEEN + 1) * BLOCK + n] = s0, s1
        work[(SEEN + 2) * BLOCK + n], work[(SEEN + 3) * BLOCK + n] = s2, s3
        if trapped:
            work[TRAP * BLOCK + n], work[(TRAP + 1) * BLOCK + n] = trap[j], trap[j1]
            work[(TRAP + 2) * BLOCK + n], work[(TRAP + 3) * BLOCK + n] = trap[j2], trap[j3]


@njit(cache=True, fastmath=_STRICT, error_model="numpy", forceinline=True)
def _read(w, row, n, a, e, f):
    """Four gathered numbers under value, slope and bend weights."""
    k = row * BLOCK + n
    w0, w1, w2, w3 = w[k], w[k + BLOCK], w[k + 2 * BLOCK], w[k + 3 * BLOCK]
    return (
        w0 * a[0] + w1 * a[1] + w2 * a[2] + w3 * a[3],
        w0 * e[0] + w1 * e[1] + w2 * e[2] + w3 * e[3],
        w0 * f[0] + w1 * f[1] + w2 * f[2] + w3 * f[3],
    )


@njit(cache=True, fastmath=_STRICT, error_model="numpy", forceinline=True)
def _own_products(w, n, a, e, f):
    """b.b, b.b', b'.b' + b.b''."""
    k = OWN * BLOCK + n
    g00, g01, g02, g03 = w[k], w[k + BLOCK], w[k + 2 * BLOCK], w[k + 3 * BLOCK]
    g11, g12, g13 = w[k + 4 * BLOCK], w[k + 5 * BLOCK], w[k + 6 * BLOCK]
    g22, g23, g33 = w[k + 7 * BLOCK], w[k + 8 * BLOCK], w[k + 9 * BLOCK]
    t0 = g00 * a[0] + g01 * a[1] + g02 * a[2] + g03 * a[3]
    t1 = g01 * a[0] + g11 * a[1] + g12 * a[2] + g13 * a[3]
    t2 = g02 * a[0] + g12 * a[1] + g22 * a[2] + g23 * a[3]
    t3 = g03 * a[0] + g13 * a[1] + g23 * a[2] + g33 * a[3]
    r0 = g00 * e[0] + g01 * e[1] + g02 * e[2] + g03 * e[3]
    r1 = g01 * e[0] + g11 * e[1] + g12 * e[2] + g13 * e[3]
    r2 = g02 * e[0] + g12 * e[1] + g22 * e[2] + g23 * e[3]
    r3 = g03 * e[0] + g13 * e[1] + g23 * e[2] + g33 * e[3]
    return (
        t0 * a[0] + t1 * a[1] + t2 * a[2] + t3 * a[3],
        t0 * e[0] + t1 * e[1] + t2 * e[2] + t3 * e[3],
        (r0 * e[0] + r1 * e[1] + r2 * e[2] + r3 * e[3]) + (t0 * f[0] + t1 * f[1] + t2 * f[2] + t3 * f[3]),
    )


@njit(cache=True, fastmath=_STRICT, error_model="numpy", forceinline=True)
def step(w, has_axis, trap_lean, trap_size, first, last, tolerance, trapped, signed):
    """Evaluate every trial; where it gains, take it and propose the next by Newton's rule.

    With the columns at work projected out, the gain is h^2 / g, g = b.b, h = b.z; x1 = h / g.
    """
    for n in range(BLOCK):
        trial = w[TRIAL * BLOCK + n]
        s = trial - w[CELL * BLOCK + n]
        a, e, f = value_weights(s), slope_weights(s), (12.0 * s - 6.0, 6.0 * s - 4.0, 6.0 - 12.0 * s, 6.0 * s - 2.0)
        g, g1, g2 = _own_products(w, n, a, e, f)
        h, h1, h2 = _read(w, SEEN, n, a, e, f)
        m, m1, m2 = _read(w, OWN + 10, n, a, e, f)
        z0 = w[ON_AXIS * BLOCK + n]
        m, m1, m2 = (m, m1, m2) if has_axis else (0.0, 0.0, 0.0)
        zt, t0, x2, q, q1, q2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if trapped:
            zt = w[ON_TRAP * BLOCK + n]
            q, q1, q2 = _read(w, TRAP, n, a, e, f)
            unit = 1.0 if has_axis else 0.0
            x0, x1, x2, gain = amplitudes(unit, m, trap_lean * unit, g, q, trap_size, z0, h, zt)
            t0 = trap_lean if x0 > 0.0 else 0.0
        else:
            alone = h * h / g
            off = g - m * m
            y = (h - m * z0) / off
            rest = z0 - m * y
            full = (off > _SAME * g) & (signed | ((y > 0.0) & (rest >= 0.0)))
            bare = z0 * z0 if signed | (z0 > 0.0) else 0.0
            single = (h > 0.0) & (alone > bare) & (not signed)
            gain = z0 * z0 + y * (h - m * z0) if full else (alone if single else bare)
            x1 = y if full else (h / g if single else 0.0)
            x0 = rest if full else (0.0 if single | (bare == 0.0) else z0)
        on = signed | (x0 > 0.0)
        m, m1, m2, z0 = (m if on else 0.0), (m1 if on else 0.0), (m2 if on else 0.0), (z0 if on else 0.0)
        g, g1, g2 = g - m * m, g1 - m * m1, g2 - m1 * m1 - m * m2
        h, h1, h2 = h - m * z0, h1 - m1 * z0, h2 - m2 * z0
        if trapped:
            # the trapped column, off the axis where that takes part
            on = x2 > 0.0
            inverse = 1.0 / (trap_size - t0 * t0) if on else 0.0
            q, q1, q2, zt = q - m * t0, q1 - m1 * t0, q2 - m2 * t0, (zt - t0 * z0) * inverse
            h, h1, h2 = h - q * zt, h1 - q1 * zt, h2 - q2 * zt
            p, p1, p2 = q * inverse, q1 * inverse, q2 * inverse
            g, g1, g2 = g - q * p, g1 - q * p1, g2 - q1 * p1 - q * p2
        # gain' = 2 x1 rise, gain'' = -2 bend
        rise = h1 - x1 * g1
        change = (rise - x1 * g1) / g
        bend = -change * rise - x1 * (h2 - change * g1 - x1 * g2)
        _take(w, n, trial, x0, x1, x2, gain, x1 * rise, bend, first, last, tolerance)


@njit(cache=True, fastmath=_STRICT, error_model="numpy", forceinline=True)
def _take(w, n, trial, x0, x1, x2, gain, slope, bend, first, last, tolerance):
    """Accept a trial that gains and step on from it; go a quarter of the way where it does not."""
    stage, whole = w[DONE * BLOCK + n], w[SIZE * BLOCK + n]
    better = (gain > w[GAIN * BLOCK + n]) & (stage < ENDED)
    w[POSITION * BLOCK + n] = trial if better else w[POSITION * BLOCK + n]
    w[FIRST * BLOCK + n] = x0 if better else w[FIRST * BLOCK + n]
    w[SECOND * BLOCK + n] = x1 if better else w[SECOND * BLOCK + n]
    w[THIRD * BLOCK + n] = x2 if better else w[THIRD * BLOCK + n]
    w[GAIN * BLOCK + n] = gain if better else w[GAIN * BLOCK + n]
    here = w[POSITION * BLOCK + n]
    newton = min(max(slope / bend, -_REACH), _REACH) if bend > 0.0 else (1.0 if slope > 0.0 else -1.0)
    onward = min(max(here + newton, first), last)
    step = onward - here
    small = slope * step <= tolerance * max(whole - gain, 1e-12 * whole)
    small = small & (bend > 0.0) & (onward > first) & (onward < last)
    back = 0.25 * (trial - here)
    steps = w[STEPS * BLOCK + n] + 1.0
    stuck = (step == 0.0) | (x1 == 0.0) if better else abs(back) < _NEAR
    ended = (stage > 0.0) | stuck | (steps >= MAX_STEPS)
    w[TRIAL * BLOCK + n] = onward if better else here + back
    w[STEPS * BLOCK + n] = steps if stage < ENDED else w[STEPS * BLOCK + n]
    w[DONE * BLOCK + n] = ENDED if ended else (1.0 if better & small else 0.0)
