"""The polish: variable projection for many curves in step, one curve a lane, so that formulas fill vector registers.

Nothing of the length of a curve is touched here. With B(u) read from the table as four Hermite weights times four rows,
all inner products of atoms, of their derivatives and of the curve are those weights times entries of

    gram = rows rows^T,      seen = rows z,

and what is left per step is some four hundred operations on numbers, the same for every lane: what one lane needs and
another does not is selected, not branched around.

Variable projection: Golub GH, Pereyra V. SIAM J Numer Anal 1973;10:413-432, doi:10.1137/0710036; without the
second-order term: Kaufman L. BIT 1975;15:49-57, doi:10.1007/BF01932995.

Positions x count table nodes: u = low + spacing x.
"""

from __future__ import annotations

from petkin.jit import njit

#: Curves in step. All scratch lives in one flat array of rows of this length, whose fixed offsets let the compiler see
#: that rows do not overlap.
LANES = 32

#: Lanes are worked through in whole registers of eight numbers, never in a remainder loop that might round another way:
#: a curve's result does not depend on its neighbours, to the bit. For the same reason sums are not reassociated.
REGISTER = 8
_STRICT = {"contract", "nsz"}

#: Steps after which a polish gives up.
MAX_STEPS = 60

# Rows: the state of a lane ...
POSITION_1, POSITION_2, TRIAL_1, TRIAL_2, BLOOD, FIRST, SECOND, GAIN = range(8)
SLOPE_1, SLOPE_2, CURVE_11, CURVE_12, CURVE_22, DAMPING, EXPECTED, STEPS, DONE, SIZE, BLOOD_SEEN = range(8, 19)
STATE = 19
# ... and what is gathered at its trial: fractions between nodes, records of `own`, rows on the curve, their Gram block;
# cells.
FRACTION_1, FRACTION_2, OWN_1, OWN_2, SEEN_1, SEEN_2, CROSS = 19, 20, 21, 35, 49, 53, 57
CELL_1, CELL_2 = 73, 74
ROWS = 75

#: Entries of a record of `own`: see `search`.
OWN = 14


@njit(fastmath=_STRICT, forceinline=True)
def value_weights(s):
    """Cubic Hermite weights of a reading at the fraction s between two nodes; slopes are per node."""
    s2 = s * s
    s3 = s2 * s
    h = 3.0 * s2 - 2.0 * s3
    return 1.0 - h, s3 - 2.0 * s2 + s, h, s3 - s2


@njit(fastmath=_STRICT, forceinline=True)
def slope_weights(s):
    """Their derivatives."""
    d = 6.0 * (s * s - s)
    return d, 3.0 * s * s - 4.0 * s + 1.0, -d, 3.0 * s * s - 2.0 * s


@njit(fastmath=_STRICT, forceinline=True)
def own_products(w, row, n, a, e):
    """b.b, b.d, d.d and the blood components of b and d, from a gathered record of `own`."""
    k = row * LANES + n
    g00, g01, g02, g03 = w[k], w[k + LANES], w[k + 2 * LANES], w[k + 3 * LANES]
    g11, g12, g13 = w[k + 4 * LANES], w[k + 5 * LANES], w[k + 6 * LANES]
    g22, g23, g33 = w[k + 7 * LANES], w[k + 8 * LANES], w[k + 9 * LANES]
    l0, l1, l2, l3 = w[k + 10 * LANES], w[k + 11 * LANES], w[k + 12 * LANES], w[k + 13 * LANES]
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
        r0 * e[0] + r1 * e[1] + r2 * e[2] + r3 * e[3],
        l0 * a[0] + l1 * a[1] + l2 * a[2] + l3 * a[3],
        l0 * e[0] + l1 * e[1] + l2 * e[2] + l3 * e[3],
    )


@njit(fastmath=_STRICT, forceinline=True)
def combine(w, row, n, a):
    """Four gathered numbers, weighted."""
    k = row * LANES + n
    return w[k] * a[0] + w[k + LANES] * a[1] + w[k + 2 * LANES] * a[2] + w[k + 3 * LANES] * a[3]


@njit(fastmath=_STRICT, forceinline=True)
def _across(w, n, a):
    """The gathered 4 x 4 Gram block between the two atoms' rows, its first side weighted."""
    k = 4 * LANES
    return (
        combine(w, CROSS, n, a),
        combine(w, CROSS, n + k, a),
        combine(w, CROSS, n + 2 * k, a),
        combine(w, CROSS, n + 3 * k, a),
    )


@njit(fastmath=_STRICT, forceinline=True)
def _one(g, h):
    """Amplitude and gain of one atom alone; gain -1 where it is absent or negative."""
    y = h / g
    return y, (h * y if (g > 0.0) & (h > 0.0) else -1.0)


@njit(fastmath=_STRICT, forceinline=True)
def _two(g, between, other, h, k):
    """Amplitudes and gain of two atoms; gain -1 where either is absent or negative, or both are the same."""
    det = g * other - between * between
    inverse = 1.0 / det
    y, x = (h * other - k * between) * inverse, (k * g - h * between) * inverse
    ok = (g > 0.0) & (other > 0.0) & (det > 1e-14 * g * other) & (y >= 0.0) & (x >= 0.0)
    return y, x, (h * y + k * x if ok else -1.0)


@njit(fastmath=_STRICT, forceinline=True)
def amplitudes(g00, g01, g02, g11, g12, g22, h0, h1, h2):
    """argmin |.|^2 over x >= 0 of three atoms with Gram g and projections h; an absent atom has g = h = 0.

    Returns x0, x1, x2 and the explained sum of squares h.x: the best of all supports whose own optimum is feasible.
    """
    y0, gain = _one(g00, h0)
    better = gain > 0.0
    x0, best = (y0 if better else 0.0), (gain if better else 0.0)
    y1, gain = _one(g11, h1)
    better = gain > best
    x0, x1, best = (0.0 if better else x0), (y1 if better else 0.0), (gain if better else best)
    y2, gain = _one(g22, h2)
    better = gain > best
    x0, x1, x2 = (0.0 if better else x0), (0.0 if better else x1), (y2 if better else 0.0)
    best = gain if better else best
    y0, y1, gain = _two(g00, g01, g11, h0, h1)
    better = gain > best
    x0, x1, x2 = (y0 if better else x0), (y1 if better else x1), (0.0 if better else x2)
    best = gain if better else best
    y0, y2, gain = _two(g00, g02, g22, h0, h2)
    better = gain > best
    x0, x1, x2 = (y0 if better else x0), (0.0 if better else x1), (y2 if better else x2)
    best = gain if better else best
    y1, y2, gain = _two(g11, g12, g22, h1, h2)
    better = gain > best
    x0, x1, x2 = (0.0 if better else x0), (y1 if better else x1), (y2 if better else x2)
    best = gain if better else best
    # All three: the blood eliminated first, which keeps the digits of two nearly equal exponentials.
    inverse = 1.0 / g00
    f, e = g01 * inverse, g02 * inverse
    a11, a12, a22 = g11 - f * g01, g12 - f * g02, g22 - e * g02
    det = a11 * a22 - a12 * a12
    r1, r2 = h1 - f * h0, h2 - e * h0
    y1, y2 = (r1 * a22 - r2 * a12) / det, (r2 * a11 - r1 * a12) / det
    y0 = (h0 - g01 * y1 - g02 * y2) * inverse
    full = (g00 > 0.0) & (g11 > 0.0) & (g22 > 0.0) & (det > 1e-14 * g11 * g22)
    full = full & (y0 >= 0.0) & (y1 >= 0.0) & (y2 >= 0.0)
    x0, x1, x2 = (y0 if full else x0), (y1 if full else x1), (y2 if full else x2)
    return x0, x1, x2, (h0 * y0 + h1 * y1 + h2 * y2 if full else best)


@njit(fastmath=_STRICT, forceinline=True)
def _inverse(on1, on2, g11, g12, g22):
    """Inverse of the Gram matrix of the exponentials at work, zero elsewhere (and where both are the same)."""
    det = g11 * g22 - g12 * g12
    both = on1 & on2 & (det > 1e-14 * g11 * g22)
    scale = 1.0 / det
    alone1, alone2 = on1 & (not on2), on2 & (not on1)
    i11 = g22 * scale if both else (1.0 / g11 if alone1 else 0.0)
    i22 = g11 * scale if both else (1.0 / g22 if alone2 else 0.0)
    return i11, (-g12 * scale if both else 0.0), i22


@njit(fastmath=_STRICT)
def evaluate(w, registers, blood):
    """Amplitudes and gain at every lane's trial; where they beat the state they become it, with their derivatives.

    Args:
        w: scratch, ROWS * LANES.
        registers: lanes in use, in multiples of REGISTER.
        blood: length of the blood atom.
    """
    g00 = blood * blood
    for n in range(registers * REGISTER):
        a, e = value_weights(w[FRACTION_1 * LANES + n]), slope_weights(w[FRACTION_1 * LANES + n])
        g11, c11, d11, l1, k1 = own_products(w, OWN_1, n, a, e)
        h1, m1 = combine(w, SEEN_1, n, a), combine(w, SEEN_1, n, e)
        p, q = value_weights(w[FRACTION_2 * LANES + n]), slope_weights(w[FRACTION_2 * LANES + n])
        g22, c22, d22, l2, k2 = own_products(w, OWN_2, n, p, q)
        h2, m2 = combine(w, SEEN_2, n, p), combine(w, SEEN_2, n, q)
        u0, u1, u2, u3 = _across(w, n, a)
        v0, v1, v2, v3 = _across(w, n, e)
        g12 = u0 * p[0] + u1 * p[1] + u2 * p[2] + u3 * p[3]
        c12 = v0 * p[0] + v1 * p[1] + v2 * p[2] + v3 * p[3]  # d1 . b2
        c21 = u0 * q[0] + u1 * q[1] + u2 * q[2] + u3 * q[3]  # d2 . b1
        d12 = v0 * q[0] + v1 * q[1] + v2 * q[2] + v3 * q[3]
        x0, x1, x2, gain = amplitudes(g00, blood * l1, blood * l2, g11, g12, g22, w[BLOOD_SEEN * LANES + n], h1, h2)
        on0, on1, on2 = x0 > 0.0, x1 > 0.0, x2 > 0.0
        s1 = x1 * (m1 - x0 * blood * k1 - x1 * c11 - x2 * c12)
        s2 = x2 * (m2 - x0 * blood * k2 - x1 * c21 - x2 * c22)
        # off the blood axis where blood takes part
        l1, l2 = (l1 if on0 else 0.0), (l2 if on0 else 0.0)
        k1, k2 = (k1 if on0 else 0.0), (k2 if on0 else 0.0)
        i11, i12, i22 = _inverse(on1, on2, g11 - l1 * l1, g12 - l1 * l2, g22 - l2 * l2)
        c11, c12, c21, c22 = c11 - k1 * l1, c12 - k1 * l2, c21 - k2 * l1, c22 - k2 * l2
        t1, t2 = c11 * i11 + c12 * i12, c11 * i12 + c12 * i22
        j11 = x1 * x1 * (d11 - k1 * k1 - t1 * c11 - t2 * c12)
        j12 = x1 * x2 * (d12 - k1 * k2 - t1 * c21 - t2 * c22)
        t1, t2 = c21 * i11 + c22 * i12, c21 * i12 + c22 * i22
        j22 = x2 * x2 * (d22 - k2 * k2 - t1 * c21 - t2 * c22)
        _take(w, n, x0, x1, x2, gain, s1, s2, j11, j12, j22)


@njit(fastmath=_STRICT, forceinline=True)
def _take(w, n, x0, x1, x2, gain, s1, s2, j11, j12, j22):
    """Accept the trial where it gains, and set the damping by how well the gain was foretold."""
    rise = gain - w[GAIN * LANES + n]
    better = rise > 0.0
    damping = w[DAMPING * LANES + n]
    eased = max(damping * 0.1, 1e-9) if rise > 0.25 * w[EXPECTED * LANES + n] else damping * 2.0
    w[DAMPING * LANES + n] = eased if better else max(damping * 10.0, 1e-2)
    w[POSITION_1 * LANES + n] = w[TRIAL_1 * LANES + n] if better else w[POSITION_1 * LANES + n]
    w[POSITION_2 * LANES + n] = w[TRIAL_2 * LANES + n] if better else w[POSITION_2 * LANES + n]
    w[BLOOD * LANES + n] = x0 if better else w[BLOOD * LANES + n]
    w[FIRST * LANES + n] = x1 if better else w[FIRST * LANES + n]
    w[SECOND * LANES + n] = x2 if better else w[SECOND * LANES + n]
    w[GAIN * LANES + n] = gain if better else w[GAIN * LANES + n]
    w[SLOPE_1 * LANES + n] = s1 if better else w[SLOPE_1 * LANES + n]
    w[SLOPE_2 * LANES + n] = s2 if better else w[SLOPE_2 * LANES + n]
    w[CURVE_11 * LANES + n] = j11 if better else w[CURVE_11 * LANES + n]
    w[CURVE_12 * LANES + n] = j12 if better else w[CURVE_12 * LANES + n]
    w[CURVE_22 * LANES + n] = j22 if better else w[CURVE_22 * LANES + n]


@njit(fastmath=_STRICT)
def propose(w, registers, first, last, reach, tolerance):
    """The next trial of every lane, and which lanes are done.

    Args:
        w: scratch.
        registers: lanes in use, in multiples of REGISTER.
        first, last: positions that rates keep between.
        reach: largest step.
        tolerance: a lane is done when its expected relative gain in cost falls below this.
    """
    for n in range(registers * REGISTER):
        x, y = w[POSITION_1 * LANES + n], w[POSITION_2 * LANES + n]
        s1, s2 = w[SLOPE_1 * LANES + n], w[SLOPE_2 * LANES + n]
        j11, j12, j22 = w[CURVE_11 * LANES + n], w[CURVE_12 * LANES + n], w[CURVE_22 * LANES + n]
        # a rate on an end of the table that the slope pushes outwards stays there
        move1 = (j11 > 0.0) & ((s1 > 0.0) | (x > first)) & ((s1 < 0.0) | (x < last))
        move2 = (j22 > 0.0) & ((s2 > 0.0) | (y > first)) & ((s2 < 0.0) | (y < last))
        s1, j11 = (s1 if move1 else 0.0), (j11 if move1 else 0.0)
        s2, j22 = (s2 if move2 else 0.0), (j22 if move2 else 0.0)
        j12 = j12 if move1 & move2 else 0.0
        damping = w[DAMPING * LANES + n]
        m11, m22 = j11 * (1.0 + damping), j22 * (1.0 + damping)
        det = m11 * m22 - j12 * j12
        both = move1 & move2 & (det > 1e-14 * m11 * m22)
        inverse = 1.0 / det
        alone1 = s1 / m11 if move1 else 0.0
        alone2 = s2 / m22 if move2 & (not move1) else 0.0
        t1 = (s1 * m22 - s2 * j12) * inverse if both else alone1
        t2 = (s2 * m11 - s1 * j12) * inverse if both else alone2
        largest = max(abs(t1), abs(t2))
        shrink = reach / largest if largest > reach else 1.0
        p, q = x + t1 * shrink, y + t2 * shrink
        cut1, cut2 = (p < first) | (p > last), (q < first) | (q > last)
        p, q = min(max(p, first), last), min(max(q, first), last)
        # At an end of the interval one rate stops there and the other takes its best step beside it.
        beside1 = min(max((s1 - j12 * (q - y)) / m11, -reach), reach)
        beside2 = min(max((s2 - j12 * (p - x)) / m22, -reach), reach)
        change1, change2 = cut2 & move1, cut1 & move2 & (not (cut2 & move1))
        p = min(max(x + beside1, first), last) if change1 else p
        q = min(max(y + beside2, first), last) if change2 else q
        t1, t2 = p - x, q - y
        expected = 2.0 * (s1 * t1 + s2 * t2) - (j11 * t1 * t1 + 2.0 * j12 * t1 * t2 + j22 * t2 * t2)
        whole = w[SIZE * LANES + n]
        steps = w[STEPS * LANES + n]
        small = expected <= tolerance * max(whole - w[GAIN * LANES + n], 1e-12 * whole)
        # A step that was cut says little of what is to be gained: shorter ones come first.
        done = (small & (not (cut1 | cut2))) | (damping > 1e8) | (steps >= MAX_STEPS) | (not (move1 | move2))
        w[TRIAL_1 * LANES + n], w[TRIAL_2 * LANES + n] = p, q
        w[EXPECTED * LANES + n] = expected
        w[DONE * LANES + n] = 1.0 if done else 0.0
        w[STEPS * LANES + n] = steps if done else steps + 1.0


@njit(fastmath=_STRICT, forceinline=True)
def weights_1(w, n):
    """Value and slope weights of the first exponential."""
    return value_weights(w[FRACTION_1 * LANES + n]), slope_weights(w[FRACTION_1 * LANES + n])


@njit(fastmath=_STRICT, forceinline=True)
def weights_2(w, n):
    """Of the second."""
    return value_weights(w[FRACTION_2 * LANES + n]), slope_weights(w[FRACTION_2 * LANES + n])


@njit(fastmath=_STRICT, forceinline=True)
def inner_products(w, n):
    """Products of the unit axis, b1, db1/dx, b2 and db2/dx at a lane's trial, row by row of the upper triangle."""
    a, e = value_weights(w[FRACTION_1 * LANES + n]), slope_weights(w[FRACTION_1 * LANES + n])
    g11, c11, d11, l1, k1 = own_products(w, OWN_1, n, a, e)
    p, q = value_weights(w[FRACTION_2 * LANES + n]), slope_weights(w[FRACTION_2 * LANES + n])
    g22, c22, d22, l2, k2 = own_products(w, OWN_2, n, p, q)
    u0, u1, u2, u3 = _across(w, n, a)
    v0, v1, v2, v3 = _across(w, n, e)
    g12 = u0 * p[0] + u1 * p[1] + u2 * p[2] + u3 * p[3]
    c21 = u0 * q[0] + u1 * q[1] + u2 * q[2] + u3 * q[3]
    c12 = v0 * p[0] + v1 * p[1] + v2 * p[2] + v3 * p[3]
    d12 = v0 * q[0] + v1 * q[1] + v2 * q[2] + v3 * q[3]
    return l1, k1, l2, k2, g11, c11, g12, c21, d11, c12, d12, g22, c22, d22
