"""How sure the amplitudes and the rate of one exponential are: the inverse of J'J for every curve.

    curve = x0 axis + x1 b(u),   J = (axis, b, x1 db/da).

Reference: Seber GAF, Wild CJ. Nonlinear regression. Wiley 1989, section 5.1. doi:10.1002/0471725315
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.table import Compression
from petkin.jit import njit

Array = NDArray[np.float64]

#: Entries of the symmetric 3 x 3 covariance, in order: x0 x0, x0 x1, x0 a, x1 x1, x1 a, a a.
ENTRIES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
#: Share of a column's square outside the columns before it below which it counts as one of them.
_SAME = 1e-13


def one_rate_covariances(packed: Compression, u: Array, x1: Array, held: NDArray[np.bool_], *, axis: bool) -> Array:
    """Covariances of (x0, x1, a) at unit variance of weight one, `ENTRIES` by curve (6, N).

    Args:
        packed: compressed table.
        u, x1: log rate and amplitude of every curve (N,).
        held: whether the rate counts as known (N,).
        axis: whether the first coordinate has an amplitude of its own.

    Returns:
        Zero for what is held or absent; the variance of a rate that the curve does not feel is infinite, and the others
        are those at this rate.
    """
    products = packed.products
    answer = np.zeros((6, len(u)))
    scratch = np.empty((2, packed.size))
    length = packed.blood if axis else 0.0
    _covariances(products.rows, products.low, products.spacing, length, u, x1, held, scratch, answer)
    return answer


@njit(nogil=True)
def _covariances(rows, low, spacing, length, u, x1, held, scratch, answer):
    b, c = scratch
    axis = 1 if length > 0.0 else 0
    for n in range(len(u)):
        _read(rows, (u[n] - low) / spacing, b, c)
        bb = bc = cc = 0.0
        for r in range(axis, len(b)):  # off the axis, whose amplitude follows the others
            bb += b[r] * b[r]
            bc += b[r] * c[r]
            cc += c[r] * c[r]
        move = x1[n] / (spacing * np.exp(u[n]))  # db / da = c dx / da, for a = exp(u) - offset
        lean, rest = bc / bb * move, cc - bc * bc / bb
        felt = move != 0.0 and rest > _SAME * cc
        known = 1.0 / (rest * move * move) if felt and not held[n] else 0.0
        answer[5, n] = known if felt or held[n] else np.inf
        answer[4, n] = -lean * known
        answer[3, n] = 1.0 / bb + lean * lean * known
        if axis:
            first, second = -b[0] / length, -c[0] * move / length
            answer[2, n] = first * answer[4, n] + second * known
            answer[1, n] = first * answer[3, n] + second * answer[4, n]
            answer[0, n] = 1.0 / length**2 + first * answer[1, n] + second * answer[2, n]


@njit()
def _read(rows, position, value, slope):
    """b and db/dx between two nodes."""
    last = rows.shape[1] // 2 - 2
    position = min(max(position, 0.0), last + 1.0)
    i = min(int(position), last)
    s = position - i
    for r in range(rows.shape[0]):
        f0, d0, f1, d1 = rows[r, 2 * i], rows[r, 2 * i + 1], rows[r, 2 * i + 2], rows[r, 2 * i + 3]
        quadratic, cubic = 3.0 * (f1 - f0) - 2.0 * d0 - d1, 2.0 * (f0 - f1) + d0 + d1
        value[r] = f0 + s * (d0 + s * (quadratic + s * cubic))
        slope[r] = d0 + s * (2.0 * quadratic + 3.0 * s * cubic)
