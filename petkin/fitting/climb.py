"""The polish where one rate is free: Newton's steps to the top of what an exponential explains, from cell to cell.

What is climbed is c(u) = h / sqrt(g), h = z . b, g = b . b, b(u) off the shared columns at work; c^2 is the sum of
squares that b explains beside them. In a cell, the interval between two nodes, h and g are polynomials (`off_atoms`),
so a step costs a few dozen operations, whatever the length of a curve. Positions x count nodes: u = low + spacing x.
"""

from __future__ import annotations

import numpy as np

from petkin.fitting.blocks import BLOCK
from petkin.fitting.lanes import MAX_STEPS
from petkin.fitting.off_atoms import NUMBERS
from petkin.jit import njit

# Scratch is one flat array of rows of BLOCK numbers, so that the compiler sees that rows do not overlap. By slot, which
# only curves that still climb have: position, cell, coefficients of h and g there, steps, whether it is at the top.
_X, _CELL, _H, _G, _STEPS, _THERE = 0, 1, 2, 6, 13, 14
# By curve: where it starts; its top, h, g and leans there, components along the shared axes; the support that it is to
# try next; the best found so far.
START, STEPS, TOP, ALONG, SQUARE, LEAN, SHARED = 15, 16, 17, 18, 19, 20, 22
WANTED, BEST, GAIN, X0, X1, X2 = range(24, 30)
ROWS = 30

_REGISTER = 8
_B = np.uint64(BLOCK)
#: Sums are not reassociated over curves: a curve's result does not depend on its neighbours, to the bit.
_STRICT = {"contract", "nsz"}
#: No support.
DONE = -1.0
#: Step, in nodes, after which another would change nothing.
_SMALL = 1e-4


@njit()
def climb(support, cubics, numbers, here, size, first, last, signed, slots, w):
    """Every curve that wants this support to the top nearest to its start; false where none does.

    Args:
        support: its number.
        cubics, numbers: see `off_atoms`, flat.
        here: curves, flat rows.
        size: how many of them.
        first, last: positions to keep between.
        signed: whether the size of c counts, not c.
        slots: scratch (BLOCK,).
        w: scratch, ROWS * BLOCK.
    """
    used = 0
    for n in range(size):
        if w[WANTED * BLOCK + n] == support:
            slots[used] = n
            w[_X * BLOCK + used] = min(max(w[START * BLOCK + n], first), last)
            w[_STEPS * BLOCK + used] = 0.0
            used += 1
    if used == 0:
        return False
    while used > 0:
        _see(cubics, numbers, here, slots, used, w)
        _step((used + _REGISTER - 1) // _REGISTER, first, last, signed, w)
        left = 0
        for k in range(used):
            if w[_THERE * BLOCK + k] > 0.0:
                _arrive(numbers, k, slots[k], w)
            else:
                slots[left] = slots[k]
                w[_X * BLOCK + left] = w[_X * BLOCK + k]
                w[_STEPS * BLOCK + left] = w[_STEPS * BLOCK + k]
                left += 1
        used = left
    return True


@njit(fastmath={"reassoc", "contract", "nsz"})
def _see(cubics, numbers, here, slots, used, w):
    """The polynomials of every climbing curve in the cell where it stands."""
    cells = len(numbers) // NUMBERS
    last, directions = np.uint64(cells - 1), np.uint64(len(cubics) // (4 * cells))
    for k in range(np.uint64(used)):
        n = np.uint64(slots[k])
        cell = min(np.uint64(w[np.uint64(_X * BLOCK) + k]), last)
        w[np.uint64(_CELL * BLOCK) + k] = float(cell)
        h0 = h1 = h2 = h3 = 0.0
        m = cell * directions * np.uint64(4)
        for r in range(directions):
            z = here[r * _B + n]
            h0 += cubics[m] * z
            h1 += cubics[m + np.uint64(1)] * z
            h2 += cubics[m + np.uint64(2)] * z
            h3 += cubics[m + np.uint64(3)] * z
            m += np.uint64(4)
        i = np.uint64(_H * BLOCK) + k
        w[i], w[i + _B], w[i + np.uint64(2) * _B], w[i + np.uint64(3) * _B] = h0, h1, h2, h3
        i, m = np.uint64(_G * BLOCK) + k, cell * np.uint64(NUMBERS)
        for power in range(np.uint64(7)):
            w[i + power * _B] = numbers[m + power]


@njit(fastmath=_STRICT, forceinline=True)
def _newton(s, low, high, h, g):
    """The next s: to where c' vanishes if c bends down there, else a node uphill."""
    h0, h1, h2, h3 = h
    g0, g1, g2, g3, g4, g5, g6 = g
    value = h0 + s * (h1 + s * (h2 + s * h3))
    slope = h1 + s * (2.0 * h2 + 3.0 * s * h3)
    bend = 2.0 * h2 + 6.0 * s * h3
    square = g0 + s * (g1 + s * (g2 + s * (g3 + s * (g4 + s * (g5 + s * g6)))))
    first = g1 + s * (2.0 * g2 + s * (3.0 * g3 + s * (4.0 * g4 + s * (5.0 * g5 + s * 6.0 * g6))))
    second = 2.0 * g2 + s * (6.0 * g3 + s * (12.0 * g4 + s * (20.0 * g5 + s * 30.0 * g6)))
    inverse = 0.5 / square
    p = first * inverse
    q = second * inverse - 2.0 * p * p
    rise = slope - value * p  # c' sqrt(g), and below c'' sqrt(g)
    turn = bend - slope * p - value * q - rise * p
    move = -rise / turn if turn < 0.0 else (1.0 if rise > 0.0 else -1.0)
    move = min(max(move, -1.0), 1.0) if rise != 0.0 else 0.0
    return min(max(s + move, low), high)


@njit(fastmath=_STRICT)
def _step(registers, first, last, signed, w):
    """Three steps on the polynomials of a cell, which reach a little beyond it; done if they end inside, and small."""
    for k in range(registers * _REGISTER):
        i, j = _H * BLOCK + k, _G * BLOCK + k
        h0, h1, h2, h3 = w[i], w[i + BLOCK], w[i + 2 * BLOCK], w[i + 3 * BLOCK]
        g = (
            w[j],
            w[j + BLOCK],
            w[j + 2 * BLOCK],
            w[j + 3 * BLOCK],
            w[j + 4 * BLOCK],
            w[j + 5 * BLOCK],
            w[j + 6 * BLOCK],
        )
        cell = w[_CELL * BLOCK + k]
        t = w[_X * BLOCK + k] - cell
        below = h0 + t * (h1 + t * (h2 + t * h3)) < 0.0
        down = signed & below
        h = ((-h0 if down else h0), (-h1 if down else h1), (-h2 if down else h2), (-h3 if down else h3))
        low, high = max(first - cell, -1.0), min(last - cell, 2.0)
        s2 = _newton(_newton(t, low, high, h, g), low, high, h, g)
        s3 = _newton(s2, low, high, h, g)
        steps = w[_STEPS * BLOCK + k] + 1.0
        settled = (abs(s3 - s2) <= _SMALL) & (s3 >= 0.0) & (s3 <= 1.0)
        # What would need a negative amplitude is no top to look for.
        negative = below & (not signed)
        there = settled | negative | (steps >= MAX_STEPS)
        w[_X * BLOCK + k] = cell + (t if negative else s3)
        w[_STEPS * BLOCK + k] = steps
        w[_THERE * BLOCK + k] = 1.0 if there else 0.0


@njit(fastmath=_STRICT, forceinline=True)
def _arrive(numbers, k, n, w):
    """What a curve has at its top, from its slot to its own place."""
    cell, i, j = np.uint64(w[_CELL * BLOCK + k]), _H * BLOCK + k, _G * BLOCK + k
    x = w[_X * BLOCK + k]
    s = x - w[_CELL * BLOCK + k]
    w[TOP * BLOCK + n], w[STEPS * BLOCK + n] = x, w[_STEPS * BLOCK + k]
    w[ALONG * BLOCK + n] = w[i] + s * (w[i + BLOCK] + s * (w[i + 2 * BLOCK] + s * w[i + 3 * BLOCK]))
    high = w[j + 4 * BLOCK] + s * (w[j + 5 * BLOCK] + s * w[j + 6 * BLOCK])
    w[SQUARE * BLOCK + n] = w[j] + s * (w[j + BLOCK] + s * (w[j + 2 * BLOCK] + s * (w[j + 3 * BLOCK] + s * high)))
    m = cell * np.uint64(NUMBERS) + np.uint64(7)
    for d in range(2):
        a, b, c = numbers[m], numbers[m + np.uint64(1)], numbers[m + np.uint64(2)]
        w[(LEAN + d) * BLOCK + n] = a + s * (b + s * (c + s * numbers[m + np.uint64(3)]))
        m += np.uint64(4)


@njit(fastmath=_STRICT)
def project_shared(axes, here, w):
    """Components of every curve along the shared axes (2, R)."""
    for d in range(2):
        for n in range(BLOCK):
            w[(SHARED + d) * BLOCK + n] = 0.0
        for r in range(axes.shape[1]):
            along = axes[d, r]
            if along != 0.0:
                for n in range(BLOCK):
                    w[(SHARED + d) * BLOCK + n] += along * here[r * BLOCK + n]


@njit(fastmath=_STRICT)
def settle(mix, support, without, signed, w):
    """Amplitudes with this support: kept where they are allowed and explain more, else the column to leave out next.

    Args:
        mix: amplitudes of the shared columns from components along the axes (2, 2).
        support: its number.
        without: numbers of the supports without the one and the other column (2,); `DONE` where it is not at work.
        signed: whether amplitudes may have either sign.
        w: scratch.
    """
    m00, m01, m10, m11 = mix[0, 0], mix[0, 1], mix[1, 0], mix[1, 1]
    this, less_0, less_1 = float(support), float(without[0]), float(without[1])
    for n in range(BLOCK):
        e0, e1 = w[SHARED * BLOCK + n], w[(SHARED + 1) * BLOCK + n]
        h, g = w[ALONG * BLOCK + n], w[SQUARE * BLOCK + n]
        x1 = h / g if g > 0.0 else 0.0
        # Without the exponential where it would be negative.
        x1 = x1 if signed | (x1 > 0.0) else 0.0
        r0, r1 = e0 - x1 * w[LEAN * BLOCK + n], e1 - x1 * w[(LEAN + 1) * BLOCK + n]
        x0, x2 = m00 * r0 + m01 * r1, m10 * r0 + m11 * r1
        gain, before = e0 * e0 + e1 * e1 + h * x1, w[GAIN * BLOCK + n]
        wanted = w[WANTED * BLOCK + n]
        less = less_0 if x0 < 0.0 else less_1
        allowed = signed | ((x0 >= 0.0) & (x2 >= 0.0))
        better = (wanted == this) & allowed & (gain > before)
        w[GAIN * BLOCK + n] = gain if better else before
        w[BEST * BLOCK + n] = w[TOP * BLOCK + n] if better else w[BEST * BLOCK + n]
        w[X0 * BLOCK + n] = x0 if better else w[X0 * BLOCK + n]
        w[X1 * BLOCK + n] = x1 if better else w[X1 * BLOCK + n]
        w[X2 * BLOCK + n] = x2 if better else w[X2 * BLOCK + n]
        w[WANTED * BLOCK + n] = (DONE if allowed else less) if wanted == this else wanted
