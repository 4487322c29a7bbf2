"""Look up, polish, look again: the compiled search for the best rates of every curve.

Per curve, in compressed coordinates z (see `table`), minimise over amplitudes x >= 0 and rates u

    | z - x0 blood - x1 b(u1) - x2 b(u2) |^2.

1. *Look up*: every pair of coarse nodes, amplitudes by the closed form, scored branch-free over a block of curves at once.
2. *Polish*: variable projection (Golub & Pereyra 1973, doi:10.1137/0710036; Kaufman's Jacobian 1975) in u with exact
   three-variable non-negative least squares at every step and Levenberg-Marquardt damping.
3. *Look again*: where the residual still points along an exponential, restart from it (Frank-Wolfe's test for a sum of
   non-negative exponentials) and keep the better end.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

#: Reassociated sums let the compiler use vector registers; NaN and infinity keep their meaning.
_FAST = {"reassoc", "contract", "nsz", "arcp"}

#: Curves that share one pass over the coarse pairs.
BLOCK = 64

#: What the second atom of a curve is: absent, free, or fixed at the table's first node (trapping, a = 0).
SINGLE, PAIR, TRAPPED = 1, 2, 3

#: Columns of the kernel's answer.
U1, U2, X0, X1, X2, COST, STEPS = range(7)

#: Steps after which a polish gives up.
MAX_STEPS = 60


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


@njit(cache=True, error_model="numpy")
def _amplitudes(g00, g01, g02, g11, g12, g22, h0, h1, h2):
    """argmin |.|^2 over x >= 0 of three atoms with Gram g and projections h; an absent atom has g = h = 0.

    Returns x0, x1, x2 and the explained sum of squares h.x. All supports are tried unless the full one is feasible.
    """
    best = 0.0
    x0 = x1 = x2 = 0.0
    have0, have1, have2 = g00 > 0.0, g11 > 0.0, g22 > 0.0
    if have0 and have1 and have2:
        f = g01 / g00
        e = g02 / g00
        a11, a12, a22 = g11 - f * g01, g12 - f * g02, g22 - e * g02
        det = a11 * a22 - a12 * a12
        if det > 1e-14 * g11 * g22:
            r1, r2 = h1 - f * h0, h2 - e * h0
            y1 = (r1 * a22 - r2 * a12) / det
            y2 = (r2 * a11 - r1 * a12) / det
            y0 = (h0 - g01 * y1 - g02 * y2) / g00
            if y0 >= 0.0 and y1 >= 0.0 and y2 >= 0.0:
                return y0, y1, y2, h0 * y0 + h1 * y1 + h2 * y2
    if have0 and h0 > 0.0:
        best, x0 = h0 * h0 / g00, h0 / g00
    if have1 and h1 * h1 > best * g11 and h1 > 0.0:
        best, x0, x1 = h1 * h1 / g11, 0.0, h1 / g11
    if have2 and h2 * h2 > best * g22 and h2 > 0.0:
        best, x0, x1, x2 = h2 * h2 / g22, 0.0, 0.0, h2 / g22
    if have0 and have1:
        det = g00 * g11 - g01 * g01
        y0, y1 = h0 * g11 - h1 * g01, h1 * g00 - h0 * g01
        if det > 1e-14 * g00 * g11 and y0 >= 0.0 and y1 >= 0.0 and h0 * y0 + h1 * y1 > best * det:
            best, x0, x1, x2 = (h0 * y0 + h1 * y1) / det, y0 / det, y1 / det, 0.0
    if have0 and have2:
        det = g00 * g22 - g02 * g02
        y0, y2 = h0 * g22 - h2 * g02, h2 * g00 - h0 * g02
        if det > 1e-14 * g00 * g22 and y0 >= 0.0 and y2 >= 0.0 and h0 * y0 + h2 * y2 > best * det:
            best, x0, x1, x2 = (h0 * y0 + h2 * y2) / det, y0 / det, 0.0, y2 / det
    if have1 and have2:
        det = g11 * g22 - g12 * g12
        y1, y2 = h1 * g22 - h2 * g12, h2 * g11 - h1 * g12
        if det > 1e-14 * g11 * g22 and y1 >= 0.0 and y2 >= 0.0 and h1 * y1 + h2 * y2 > best * det:
            best, x0, x1, x2 = (h1 * y1 + h2 * y2) / det, 0.0, y1 / det, y2 / det
    return x0, x1, x2, best


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _project(z, blood, second, b1, b2):
    """Amplitudes and explained sum of squares at the atoms b1, b2 (b2 ignored unless `second`)."""
    g11, h1 = dot(b1, b1), dot(b1, z)
    g12 = g22 = h2 = g02 = 0.0
    if second:
        g12, g22, h2, g02 = dot(b1, b2), dot(b2, b2), dot(b2, z), blood * b2[0]
    return _amplitudes(blood * blood, blood * b1[0], g02, g11, g12, g22, blood * z[0], h1, h2)


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _curvature(d, e, b1, b2, on0, on1, on2):
    """d . P e with P the projector off the active atoms (blood is axis 0)."""
    skip = d[0] * e[0] if on0 else 0.0
    value = dot(d, e) - skip
    m0 = 1.0 if on0 else 0.0
    c1 = dot(d, b1) - m0 * d[0] * b1[0]
    k1 = dot(e, b1) - m0 * e[0] * b1[0]
    g11 = dot(b1, b1) - m0 * b1[0] * b1[0]
    if on1 and not on2:
        return value - c1 * k1 / g11
    c2 = dot(d, b2) - m0 * d[0] * b2[0]
    k2 = dot(e, b2) - m0 * e[0] * b2[0]
    g22 = dot(b2, b2) - m0 * b2[0] * b2[0]
    if on2 and not on1:
        return value - c2 * k2 / g22
    if on1 and on2:
        g12 = dot(b1, b2) - m0 * b1[0] * b2[0]
        det = g11 * g22 - g12 * g12
        if det > 1e-14 * g11 * g22:
            return value - (c1 * (k1 * g22 - k2 * g12) + c2 * (k2 * g11 - k1 * g12)) / det
    return value


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _polish(z, size, blood, kind, basis, slope, low, spacing, u1, u2, tolerance, work, out):
    """Levenberg-Marquardt on the variable-projection functional from (u1, u2); the end goes to `out`."""
    b1, d1, b2, d2 = work[0], work[1], work[2], work[3]
    high = low + spacing * (basis.shape[0] - 1)
    second = kind != SINGLE
    free2 = kind == PAIR
    read(basis, slope, low, spacing, u1, b1, d1)
    if second:
        read(basis, slope, low, spacing, u2, b2, d2)
    x0, x1, x2, gain = _project(z, blood, second, b1, b2)
    damping = 1e-3
    steps = 0
    while steps < MAX_STEPS:
        on0, on1, on2 = x0 > 0.0, x1 > 0.0, x2 > 0.0
        s1 = s2 = j11 = j22 = j12 = 0.0
        if on1:
            s1 = x1 * (dot(d1, z) - x0 * blood * d1[0] - x1 * dot(d1, b1))
            if second:
                s1 -= x1 * x2 * dot(d1, b2)
            if (s1 > 0.0 or u1 > low) and (s1 < 0.0 or u1 < high):
                j11 = x1 * x1 * _curvature(d1, d1, b1, b2, on0, on1, on2)
        if on2 and free2:
            s2 = x2 * (dot(d2, z) - x0 * blood * d2[0] - x1 * dot(d2, b1) - x2 * dot(d2, b2))
            if (s2 > 0.0 or u2 > low) and (s2 < 0.0 or u2 < high):
                j22 = x2 * x2 * _curvature(d2, d2, b1, b2, on0, on1, on2)
        if j11 > 0.0 and j22 > 0.0:
            j12 = x1 * x2 * _curvature(d1, d2, b1, b2, on0, on1, on2)
        if j11 <= 0.0 and j22 <= 0.0:
            break
        moved = False
        done = False
        while steps < MAX_STEPS:
            steps += 1
            m11, m22 = j11 * (1.0 + damping), j22 * (1.0 + damping)
            t1 = t2 = 0.0
            if j11 > 0.0 and j22 > 0.0 and m11 * m22 - j12 * j12 > 1e-14 * m11 * m22:
                det = m11 * m22 - j12 * j12
                t1 = (s1 * m22 - s2 * j12) / det
                t2 = (s2 * m11 - s1 * j12) / det
            elif j11 > 0.0:
                t1 = s1 / m11
            else:
                t2 = s2 / m22
            largest = max(abs(t1), abs(t2))
            if largest > 2.0:
                t1 *= 2.0 / largest
                t2 *= 2.0 / largest
            # At an end of the interval one rate stops there and the other takes its best step beside it.
            c1, c2 = min(max(u1 + t1, low), high) - u1, min(max(u2 + t2, low), high) - u2
            cut = c1 != t1 or c2 != t2
            if c2 != t2 and j11 > 0.0:
                c1 = min(max(u1 + min(max((s1 - j12 * c2) / m11, -2.0), 2.0), low), high) - u1
            elif c1 != t1 and j22 > 0.0:
                c2 = min(max(u2 + min(max((s2 - j12 * c1) / m22, -2.0), 2.0), low), high) - u2
            t1, t2 = c1, c2
            expected = 2.0 * (s1 * t1 + s2 * t2) - (j11 * t1 * t1 + 2.0 * j12 * t1 * t2 + j22 * t2 * t2)
            if expected <= tolerance * max(size - gain, 1e-12 * size):
                if cut and damping < 1e8:
                    damping = max(damping * 10.0, 1e-2)
                    continue
                done = True
                break
            read(basis, slope, low, spacing, u1 + t1, b1, d1)
            if free2:
                read(basis, slope, low, spacing, u2 + t2, b2, d2)
            y0, y1, y2, new = _project(z, blood, second, b1, b2)
            if new > gain:
                damping = max(damping * 0.1, 1e-9) if new - gain > 0.25 * expected else damping * 2.0
                u1, u2, x0, x1, x2, gain = u1 + t1, u2 + t2, y0, y1, y2, new
                moved = True
                break
            damping = max(damping * 10.0, 1e-2)
            if damping > 1e8:
                done = True
                break
        if done or not moved:
            break
    out[U1], out[U2], out[X0], out[X1], out[X2] = u1, u2, x0, x1, x2
    out[COST] = size - gain
    out[STEPS] = steps


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _look_up(zs, count, atoms, lead, gram, kind, has_blood, scores, first, second, c):
    """Best coarse node or pair for each of `count` curves, scored off the blood axis with a penalty for negative blood."""
    nodes = atoms.shape[0]
    for i in range(nodes):
        for n in range(count):
            c[i, n] = 0.0
        for r in range(atoms.shape[1]):
            a = atoms[i, r]
            for n in range(count):
                c[i, n] += a * zs[r, n]
    for n in range(count):
        scores[n] = -1.0
        first[n] = 0
        second[n] = 0
    for i in range(nodes if kind == SINGLE else 0):
        gv = 1.0 / (1.0 + lead[i] * lead[i])
        for n in range(count):
            y = max(c[i, n], 0.0)
            v = min(zs[0, n] - lead[i] * y, 0.0) if has_blood else 0.0
            score = y * y - v * v * gv
            if score > scores[n]:
                scores[n] = score
                first[n] = i
    last = nodes if kind == PAIR else (1 if kind == TRAPPED else 0)
    for j in range(last):  # j: the slower atom (node 0 is the slowest)
        for i in range(j + 1, nodes):
            g = gram[i, j]
            inverse = 1.0 / np.sqrt(max(1.0 - g * g, 1e-12))
            tilt = g * inverse
            reach = lead[j] * inverse - lead[i] * tilt
            gv = 1.0 / (1.0 + lead[i] * lead[i] + reach * reach)
            for n in range(count):
                ci, cj = c[i, n], c[j, n]
                y2 = (cj - g * ci) * inverse
                y1 = ci
                # Outside the cone of positive amplitudes the better single atom is the answer.
                if y2 <= 0.0:
                    y2, y1 = 0.0, max(ci, 0.0)
                    v = zs[0, n] - lead[i] * y1
                elif y1 <= tilt * y2:
                    y1, y2 = max(cj, 0.0), 0.0
                    v = zs[0, n] - lead[j] * y1
                else:
                    v = zs[0, n] - lead[i] * y1 - reach * y2
                v = min(v, 0.0) if has_blood else 0.0
                score = y1 * y1 + y2 * y2 - v * v * gv
                if score > scores[n]:
                    scores[n] = score
                    first[n] = i
                    second[n] = j


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _residual_points(z, blood, kind, basis, slope, low, spacing, out, coarse, norms, work):
    """Largest (r . b / |b|)^2 over coarse nodes with r . b > 0, and its node (-1 if none)."""
    r, b1, d1 = work[4], work[0], work[1]
    for k in range(z.shape[0]):
        r[k] = z[k]
    r[0] -= out[X0] * blood
    if out[X1] > 0.0:
        read(basis, slope, low, spacing, out[U1], b1, d1)
        for k in range(z.shape[0]):
            r[k] -= out[X1] * b1[k]
    if kind != SINGLE and out[X2] > 0.0:
        read(basis, slope, low, spacing, out[U2], b1, d1)
        for k in range(z.shape[0]):
            r[k] -= out[X2] * b1[k]
    most, node = 0.0, -1
    for i in range(coarse.shape[0]):
        along = dot(r, basis[coarse[i]]) / norms[i]
        if along > most:
            most, node = along, i
    return most * most, node


@njit(cache=True, parallel=True, fastmath=_FAST, error_model="numpy")
def search(z, sizes, blood, kind, basis, slope, low, spacing, coarse, atoms, lead, gram, norms, tolerance, again):
    """Fit every column of z.

    Args:
        z: compressed curves (R, N), C order.
        sizes: |z|^2 of every curve (N,).
        blood: length of the blood atom along axis 0; 0 leaves blood out.
        kind: SINGLE, PAIR or TRAPPED.
        basis, slope, low, spacing: the compressed table.
        coarse, atoms, lead, gram, norms: see `voxelwise.coarse_grid`.
        tolerance: a polish ends when its expected relative gain falls below this.
        again: second start where (r . b)^2 exceeds this share of the cost; infinity for none.

    Returns:
        (N, 7): u1, u2, blood, x1, x2, cost (without the part of the curve outside the compressed space), steps of the
        polish that led there.
    """
    count, size = z.shape[1], z.shape[0]
    answer = np.empty((count, 7))
    blocks = (count + BLOCK - 1) // BLOCK
    for block in prange(blocks):
        start = block * BLOCK
        stop = min(start + BLOCK, count)
        zs = z[:, start:stop].copy()
        c = np.empty((coarse.shape[0], BLOCK))
        scores = np.empty(BLOCK)
        first = np.empty(BLOCK, np.int64)
        second = np.empty(BLOCK, np.int64)
        work = np.empty((5, size))
        mine = np.empty(size)
        trial = np.empty(7)
        _look_up(zs, stop - start, atoms, lead, gram, kind, blood > 0.0, scores, first, second, c)
        for n in range(stop - start):
            out = answer[start + n]
            for r in range(size):
                mine[r] = zs[r, n]
            u1 = low + spacing * coarse[first[n]]
            u2 = low + spacing * coarse[second[n]] if kind == PAIR else low
            whole = sizes[start + n]
            _polish(mine, whole, blood, kind, basis, slope, low, spacing, u1, u2, tolerance, work, out)
            for _ in range(4):
                along, node = _residual_points(
                    mine, blood, kind, basis, slope, low, spacing, out, coarse, norms, work
                )
                if node < 0 or along <= again * out[COST]:
                    break
                u3 = low + spacing * coarse[node]
                before = out[COST]
                partners = 2 if kind == PAIR else 1
                for partner in range(partners):
                    keep = out[U1] if partner == 0 else out[U2]
                    if kind == PAIR:
                        if (out[X1] if partner == 0 else out[X2]) <= 0.0:
                            continue
                        fast, slow = max(keep, u3), min(keep, u3)
                    else:
                        fast, slow = u3, low
                    _polish(mine, whole, blood, kind, basis, slope, low, spacing, fast, slow, tolerance, work, trial)
                    if trial[COST] < out[COST]:
                        for k in range(7):
                            out[k] = trial[k]
                if out[COST] > before * (1.0 - tolerance):
                    break
    return answer
