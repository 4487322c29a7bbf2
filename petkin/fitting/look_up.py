"""The exhaustive first look: every pair of coarse nodes scored for many curves at once.

A pair's amplitudes have a closed form, so a score is some fourteen operations without a branch, and neighbouring curves
fill a vector register. The winner is only where the polish starts, so they are scored in single precision.
"""

from __future__ import annotations

import numpy as np

from petkin.jit import njit

#: Curves scored together.
GROUP = 128

#: Sums may be reassociated here; NaN and infinity keep their meaning.
_FAST = {"reassoc", "contract", "nsz", "arcp"}
#: Single precision, so that they do not widen arrays of single precision.
_ZERO, _ONE, _TINY = np.float32(0.0), np.float32(1.0), np.float32(1e-6)


@njit(fastmath=_FAST)
def look_up(z, atoms, lead, gram, has_blood, c, scores, chosen):
    """Best pair of GROUP curves; `chosen` gets first * nodes + second.

    Args:
        z: compressed curves, scaled to unit length (R, GROUP).
        atoms: unit atoms off the blood axis (nodes, R).
        lead: how far they lean on it (nodes,).
        gram: of the atoms (nodes, nodes).
        has_blood: whether blood takes part.
        c, scores: scratch (nodes, GROUP), (GROUP,).
        chosen: the answer (GROUP,), int32.
    """
    nodes = atoms.shape[0]
    for i in range(nodes):
        for n in range(GROUP):
            c[i, n] = _ZERO
        for r in range(atoms.shape[1]):
            a = atoms[i, r]
            for n in range(GROUP):
                c[i, n] += a * z[r, n]
    for n in range(GROUP):
        scores[n] = -_ONE
        chosen[n] = 0
    for i in range(nodes):
        li = lead[i]
        gv = _ONE / (_ONE + li * li) if has_blood else _ZERO * li
        # Of pairs with one atom at work, the one whose other atom is the slowest.
        code = np.int32(max(i, 1) * nodes)
        for n in range(GROUP):
            y = max(c[i, n], _ZERO)
            v = min(z[0, n] - li * y, _ZERO)
            score = y * y - v * v * gv
            better = score > scores[n]
            scores[n] = score if better else scores[n]
            chosen[n] = code if better else chosen[n]
    for j in range(nodes):  # the slower atom; node 0 is the slowest
        for i in range(j + 1, nodes):
            _score_pair(i, j, z, lead, gram, has_blood, c, scores, chosen)


@njit(fastmath=_FAST)
def _score_pair(i, j, z, lead, gram, has_blood, c, scores, chosen):
    """Pairs with both amplitudes positive; the rest are singles."""
    li, lj, g = lead[i], lead[j], gram[i, j]
    inverse = _ONE / max(_ONE - g * g, _TINY)
    lean_i, lean_j = li * inverse, lj * inverse
    # 1 / [Gram^-1] of the blood: what a negative amount of it, held at zero, costs
    gv = _ONE / (_ONE + lean_i * (li - g * lj) + lean_j * (lj - g * li)) if has_blood else _ZERO * li
    code = np.int32(i * lead.shape[0] + j)
    for n in range(GROUP):
        ci, cj = c[i, n], c[j, n]
        xi, xj = ci - g * cj, cj - g * ci  # amplitudes, times 1 - g^2
        v = min(z[0, n] - lean_i * xi - lean_j * xj, _ZERO)
        score = (ci * xi + cj * xj) * inverse - v * v * gv
        better = (score > scores[n]) & (xi > _ZERO) & (xj > _ZERO)
        scores[n] = score if better else scores[n]
        chosen[n] = code if better else chosen[n]
