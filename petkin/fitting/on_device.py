"""The search of `kernel` as tensor operations, for an accelerator: the same look-up, steps and second starts.

Curves are moved to the device in chunks and their answers back. The polish takes the steps of `lanes`, so that both end
in the same place but for rounding. Models of one free rate take these steps too, with the second exponential at rate
zero (trapping) or left out, and to a finer tolerance. All in double precision: in single precision the look-up confuses
neighbouring pairs of one curve in a hundred.

Reference: Golub GH, Pereyra V. SIAM J Numer Anal 1973;10:413-432, doi:10.1137/0710036 (variable projection).
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, where

from petkin.fitting import lanes
from petkin.fitting.device_tables import CHUNK, DeviceTables, read_atoms
from petkin.fitting.kernel import COST, MOST_ROUNDS, REACH, U1, U2, X0, X1, X2

Array = NDArray[np.float64]

#: Gauss-Newton steps of one rate go on to where Newton's steps of `one_rate` end.
_ONE_RATE_TOLERANCE = 1e-9
#: Which of blood and two exponentials are at work.
_SUPPORTS = [(i & 1 > 0, i & 2 > 0, i & 4 > 0) for i in range(1, 8)]


def search_on_device(z: Array, sizes: Array, tables: DeviceTables, tolerance: float, again: float) -> Array:
    """Fit every column of z (R, N); arguments and answer (7, N) are those of `kernel.search`."""
    answer = np.empty((7, z.shape[1]))
    for start in range(0, z.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        curves = torch.as_tensor(np.ascontiguousarray(z[:, part].T)).to(tables.cells.device)
        whole = torch.as_tensor(np.ascontiguousarray(sizes[part])).to(tables.cells.device)
        answer[:, part] = _search(tables, curves, whole, tolerance, again).cpu().numpy()
    return answer


def _search(t: DeviceTables, z: Tensor, sizes: Tensor, tolerance: float, again: float) -> Tensor:
    """Look up, polish, look again, as `kernel` does it."""
    trial = _look_up(t, z, sizes)
    if not t.slow_free:
        return _in_order(t, _polish(t, z, sizes, trial, min(tolerance, _ONE_RATE_TOLERANCE)))
    out = _polish(t, z, sizes, trial, tolerance)
    rows, stage, rounds = (torch.arange(len(sizes), device=z.device), *torch.zeros(2, len(sizes), device=z.device))
    third, before = torch.zeros_like(sizes), torch.full_like(sizes, torch.inf)
    while len(rows):
        best = out[:, rows]
        beside = (stage == 1) & (best[X2] > 0)  # the third exponential has been tried with the first; now the second
        residual = z[rows] - _model(t, best[U1 : U2 + 1], best[X0 : X2 + 1])
        steepest, node = (residual @ t.units.T).max(dim=1)
        fresh = ~beside & (best[COST] <= before * (1 - tolerance)) & (rounds < MOST_ROUNDS)
        fresh &= steepest > (again * best[COST]).sqrt()
        third = where(fresh, t.coarse[node], third)
        before, rounds = where(fresh, best[COST], before), rounds + fresh
        first = fresh & (best[X1] > 0)
        stage, keep = where(first, 1.0, 2.0), where(first, best[U1], best[U2])
        going = beside | fresh
        rows, stage, rounds, third, before, keep = (each[going] for each in (rows, stage, rounds, third, before, keep))
        trial = torch.stack([torch.maximum(keep, third), torch.minimum(keep, third)])
        ended, best = _polish(t, z[rows], sizes[rows], trial, tolerance), out[:, rows]
        out[:, rows] = where(ended[COST] < best[COST], ended, best)
    return _in_order(t, out)


def _in_order(t: DeviceTables, found: Tensor) -> Tensor:
    """Answers, the faster exponential first and u instead of positions."""
    turned = found[[U2, U1, X0, X2, X1, 5, 6]]
    found = where(found[U2] > found[U1], turned, found)
    found[: U2 + 1] = t.low + t.spacing * found[: U2 + 1]
    return found


def _look_up(t: DeviceTables, z: Tensor, sizes: Tensor) -> Tensor:
    """Positions (2, n) of the best node or pair of nodes; see `look_up`."""
    scaled = z / sizes.clamp(min=1e-300).sqrt()[:, None]
    c, z0, bled = scaled @ t.atoms.T, scaled[:, :1], float(t.blood > 0)
    y = c.clamp(min=0)
    alone = y * y - (z0 - t.lead * y).clamp(max=0) ** 2 * bled / (1 + t.lead**2)
    (i, j), near = t.pairs, t.atoms @ t.atoms.T
    g, li, lj = near[i, j], t.lead[i], t.lead[j]
    inverse = 1 / (1 - g * g).clamp(min=1e-6)
    lean_i, lean_j = li * inverse, lj * inverse
    held = bled / (1 + lean_i * (li - g * lj) + lean_j * (lj - g * li))
    ci, cj = c[:, i], c[:, j]
    xi, xj = ci - g * cj, cj - g * ci
    score = (ci * xi + cj * xj) * inverse - (z0 - lean_i * xi - lean_j * xj).clamp(max=0) ** 2 * held
    both = where((xi > 0) & (xj > 0), score, -1.0)
    return t.starts[:, torch.cat([alone, both], dim=1).argmax(dim=1)]


def _model(t: DeviceTables, at: Tensor, x: Tensor) -> Tensor:
    """The curves (n, R) at positions (2, n) with amplitudes (3, n)."""
    curves = x[1][:, None] * read_atoms(t, at[0])[0] + x[2][:, None] * read_atoms(t, at[1])[0]
    curves[:, 0] += t.blood * x[0]
    return curves


def _amplitudes(g: list[list[Tensor]], h: Tensor) -> tuple[Tensor, Tensor]:
    """argmin over x >= 0 of three atoms with Gram g and projections h (3, n), and the explained sum of squares."""
    best, x, one, zero = torch.zeros_like(h[0]), torch.zeros_like(h), torch.ones_like(h[0]), torch.zeros_like(h[0])
    for blood, fast, slow in _SUPPORTS:
        f, e = (g[0][1] / g[0][0], g[0][2] / g[0][0]) if blood else (zero, zero)
        a11, r1 = (g[1][1] - f * g[0][1], h[1] - f * h[0]) if fast else (one, zero)
        a22, r2 = (g[2][2] - e * g[0][2], h[2] - e * h[0]) if slow else (one, zero)
        a12 = g[1][2] - f * g[0][2] if fast and slow else zero
        det = a11 * a22 - a12 * a12
        y1, y2 = (r1 * a22 - r2 * a12) / det, (r2 * a11 - r1 * a12) / det
        y0 = h[0] / g[0][0] - f * y1 - e * y2 if blood else zero
        y = torch.stack([y0, y1, y2])
        scale = (g[1][1] if fast else one) * (g[2][2] if slow else one)
        gain = where((det > 1e-14 * scale) & (y >= 0).all(dim=0), (h * y).sum(0), -1.0)
        better = gain > best
        x, best = where(better, y, x), where(better, gain, best)
    return x, best


def _evaluate(t: DeviceTables, z: Tensor, at: Tensor) -> Tensor:
    """Positions (2, n), amplitudes, gain, its slopes and curvatures there (11, n); see `lanes.evaluate`."""
    (b1, d1), (b2, d2) = read_atoms(t, at[0]), read_atoms(t, at[1])
    if not t.slow_there:
        b2 = torch.zeros_like(b2)
    g11, g12, g22 = (b1 * b1).sum(1), (b1 * b2).sum(1), (b2 * b2).sum(1)
    g01, g02, h0 = t.blood * b1[:, 0], t.blood * b2[:, 0], t.blood * z[:, 0]
    g00 = torch.full_like(g11, t.blood * t.blood)
    h = torch.stack([h0, (b1 * z).sum(1), (b2 * z).sum(1)])
    x, gain = _amplitudes([[g00, g01, g02], [g01, g11, g12], [g02, g12, g22]], h)
    on0, on1, on2 = x > 0
    residual = z - x[1][:, None] * b1 - x[2][:, None] * b2
    residual[:, 0] -= t.blood * x[0]
    s1, s2 = x[1] * (d1 * residual).sum(1), x[2] * (d2 * residual).sum(1)
    # off the blood axis where blood takes part
    for atom in (b1, b2, d1, d2):
        atom[:, 0] = where(on0, 0.0, atom[:, 0])
    g11, g12, g22 = (b1 * b1).sum(1), (b1 * b2).sum(1), (b2 * b2).sum(1)
    det = g11 * g22 - g12 * g12
    both = on1 & on2 & (det > 1e-14 * g11 * g22)
    i11 = where(both, g22 / det, where(on1 & ~on2, 1 / g11, 0.0))
    i22 = where(both, g11 / det, where(on2 & ~on1, 1 / g22, 0.0))
    i12 = where(both, -g12 / det, 0.0)

    def across(d: Tensor, e: Tensor) -> Tensor:
        """d . P e, P off the exponentials at work."""
        c1, c2, k1, k2 = (d * b1).sum(1), (d * b2).sum(1), (e * b1).sum(1), (e * b2).sum(1)
        return (d * e).sum(1) - (c1 * i11 + c2 * i12) * k1 - (c1 * i12 + c2 * i22) * k2

    curvatures = x[1] ** 2 * across(d1, d1), x[1] * x[2] * across(d1, d2), x[2] ** 2 * across(d2, d2)
    return torch.stack([*at, *x, gain, s1, s2, *curvatures])


def _polish(t: DeviceTables, z: Tensor, sizes: Tensor, trial: Tensor, tolerance: float) -> Tensor:
    """Levenberg-Marquardt steps from positions (2, n) to the end: positions, amplitudes, cost, steps (7, n)."""
    answer = torch.empty((7, len(sizes)), dtype=z.dtype, device=z.device)
    left = torch.arange(len(sizes), device=z.device)
    point = torch.zeros((11, len(sizes)), dtype=z.dtype, device=z.device)
    point[5] = -1.0
    damping, expected = torch.full_like(sizes, 1e-2), torch.zeros_like(sizes)
    for steps in range(lanes.MAX_STEPS + 1):
        reached = _evaluate(t, z, trial)
        rise = reached[5] - point[5]
        better = rise > 0
        eased = where(rise > 0.25 * expected, (damping * 0.1).clamp(min=1e-9), damping * 2)
        damping = where(better, eased, (damping * 10).clamp(min=1e-2))
        point = where(better, reached, point)
        trial, expected, stuck, cut = _propose(t, point, damping)
        least = tolerance * torch.maximum(sizes - point[5], 1e-12 * sizes)
        # A step that was cut says little of what is to be gained: shorter ones come first.
        done = ((expected <= least) & ~cut) | (damping > 1e8) | stuck | (steps == lanes.MAX_STEPS)
        ended = left[done]
        answer[: X2 + 1, ended] = point[:5, done]
        answer[COST, ended], answer[COST + 1, ended] = (sizes - point[5])[done], float(steps)
        going = ~done
        left, z, sizes, damping, expected = (each[going] for each in (left, z, sizes, damping, expected))
        point, trial = point[:, going], trial[:, going]
        if len(left) == 0:
            break
    return answer


def _propose(t: DeviceTables, point: Tensor, damping: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The next trial, its expected gain, which curves cannot move, and whose step was cut; see `lanes.propose`."""
    x, y, (s1, s2, j11, j12, j22) = point[0], point[1], point[6:]
    move1 = (j11 > 0) & ((s1 > 0) | (x > t.first)) & ((s1 < 0) | (x < t.last))
    move2 = (j22 > 0) & ((s2 > 0) | (y > t.first)) & ((s2 < 0) | (y < t.last)) & t.slow_free
    s1, j11, s2, j22 = where(move1, s1, 0.0), where(move1, j11, 0.0), where(move2, s2, 0.0), where(move2, j22, 0.0)
    j12 = where(move1 & move2, j12, 0.0)
    m11, m22 = j11 * (1 + damping), j22 * (1 + damping)
    det = m11 * m22 - j12 * j12
    both = move1 & move2 & (det > 1e-14 * m11 * m22)
    t1 = where(both, (s1 * m22 - s2 * j12) / det, where(move1, s1 / m11, 0.0))
    t2 = where(both, (s2 * m11 - s1 * j12) / det, where(move2 & ~move1, s2 / m22, 0.0))
    reach = REACH / t.spacing
    largest = torch.maximum(t1.abs(), t2.abs())
    shrink = where(largest > reach, reach / largest, 1.0)
    p, q = x + t1 * shrink, y + t2 * shrink
    cut1, cut2 = (p < t.first) | (p > t.last), (q < t.first) | (q > t.last)
    p, q = p.clamp(t.first, t.last), q.clamp(t.first, t.last)
    # At an end of the interval one rate stops there and the other takes its best step beside it.
    beside1 = ((s1 - j12 * (q - y)) / m11).clamp(-reach, reach)
    beside2 = ((s2 - j12 * (p - x)) / m22).clamp(-reach, reach)
    alone1, alone2 = cut2 & move1, cut1 & move2 & ~(cut2 & move1)
    p = where(alone1, (x + beside1).clamp(t.first, t.last), p)
    q = where(alone2, (y + beside2).clamp(t.first, t.last), q)
    t1, t2 = p - x, q - y
    expected = 2 * (s1 * t1 + s2 * t2) - (j11 * t1 * t1 + 2 * j12 * t1 * t2 + j22 * t2 * t2)
    return torch.stack([p, q]), expected, ~(move1 | move2), cut1 | cut2
