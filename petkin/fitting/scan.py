"""The exhaustive first look where one rate is free: what each scanned node explains of many curves at once.

Amplitudes have a closed form at every node, so a score is a dozen operations without a branch, and neighbouring curves
fill a vector register. The winner is only where the polish starts, so they are scored in single precision.
"""

from __future__ import annotations

import numpy as np

from petkin.fitting.blocks import BLOCK
from petkin.jit import njit

#: What the shared columns are: the axis alone; the axis and b(0); the axis alone, with amplitudes of either sign.
SINGLE, TRAPPED, SIGNED = 1, 2, 3

#: Sums may be reassociated here, in loops without a remainder; NaN and infinity keep their meaning.
_FAST = {"reassoc", "contract", "nsz", "arcp"}
#: Single precision, so that they do not widen arrays of single precision.
_ZERO, _ONE, _TINY = np.float32(0.0), np.float32(1.0), np.float32(1e-6)


@njit(fastmath={"contract", "nsz"})
def shrink(here, sizes, lengths, scaled):
    """A block of curves brought to unit length for the scan; flat rows, `sizes` of those that there are."""
    for n in range(BLOCK):
        lengths[n] = 0.0
    for n in range(len(sizes)):
        lengths[n] = 1.0 / np.sqrt(max(sizes[n], 1e-300))
    for r in range(len(scaled) // BLOCK):
        for n in range(BLOCK):
            scaled[r * BLOCK + n] = here[r * BLOCK + n] * lengths[n]


@njit(fastmath=_FAST)
def score(z, along, lead, near, kind, has_axis, scores, top, best):
    """What every scanned node explains of every curve, and the node that explains most; amplitudes in closed form."""
    for i in range(len(lead)):
        if kind == SIGNED:
            for n in range(BLOCK):
                scores[i, n] = along[i, n] * along[i, n]
        else:
            li = lead[i]
            weight = _ONE / (_ONE + li * li)
            for n in range(BLOCK):
                c = along[i, n]
                z0 = z[n] if has_axis else _ZERO
                off = max(c + li * z0, _ZERO)  # without the axis
                scores[i, n] = z0 * z0 + c * c if (c > _ZERO) & (z0 >= li * c) else off * off * weight
        if kind == TRAPPED and i > 0:
            _score_trapped(i, z, along, lead, near, has_axis, scores)
    for n in range(BLOCK):
        top[n], best[n] = scores[0, n], np.int32(0)
    for i in range(1, len(lead)):
        node = np.int32(i)
        for n in range(BLOCK):
            better = scores[i, n] > top[n]
            top[n] = scores[i, n] if better else top[n]
            best[n] = node if better else best[n]


@njit(fastmath=_FAST)
def _score_trapped(i, z, along, lead, near, has_axis, scores):
    """The same with what is trapped, where both amplitudes are positive."""
    li, lj, g = lead[i], lead[0], near[i]
    inverse = _ONE / max(_ONE - g * g, _TINY)
    lean_i, lean_j = li * inverse, lj * inverse
    # 1 / [Gram^-1] of the axis: what a negative amount of it, held at zero, costs
    weight = _ONE / (_ONE + lean_i * (li - g * lj) + lean_j * (lj - g * li))
    for n in range(BLOCK):
        ci, cj = along[i, n], along[0, n]
        xi, xj = ci - g * cj, cj - g * ci  # amplitudes, times 1 - g^2
        z0 = z[n] if has_axis else _ZERO
        v = min(z0 - lean_i * xi - lean_j * xj, _ZERO)
        score = z0 * z0 + (ci * xi + cj * xj) * inverse - v * v * weight
        better = (score > scores[i, n]) & (xi > _ZERO) & (xj > _ZERO)
        scores[i, n] = score if better else scores[i, n]
