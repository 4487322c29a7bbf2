"""How near a cone of atoms comes to a curve: compiled non-negative least squares with a bound that is proven.

    min |z - sum_k x_k d_k|^2,  x >= 0

is solved by adding the atom that the residual points along most and solving again among those in use. The answer is not
taken on trust: a residual r is turned by as much of a vector h with h . d_k >= 1 as makes r' . d_k <= 0 for every atom,
and then 2 z . r' - |r'|^2 is no larger than |z - m|^2 for any m in the cone, since (z - m - r')^2 >= 0 and m . r' <= 0.

References: Lawson CL, Hanson RJ. Solving least squares problems. SIAM 1995, chapter 23. doi:10.1137/1.9781611971217
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from petkin.jit import njit

Array = NDArray[np.float64]

#: Atoms in use at a time, and times that one is added.
MOST, _ROUNDS = 8, 60
#: Share of |z| that a residual may still point along an atom; a rounding error would be 1e-16.
_FLAT = 1e-11
#: Part of an atom that those in use must leave, squared, for it to be told from them.
_APART = 1e-13


class Room(NamedTuple):
    """Room to work in.

    Args:
        used: atoms in use (MOST,).
        amount: how much of them (MOST,).
        trial: the same before signs are looked at (MOST,).
        factor: Cholesky factor of their inner products (MOST, MOST).
        seen: their inner products with z (MOST,).
        residual: z less the combination (R,).
    """

    used: NDArray[np.int64]
    amount: Array
    trial: Array
    factor: Array
    seen: Array
    residual: Array


@njit()
def room(directions):
    """For curves of so many directions."""
    square = np.zeros((MOST, MOST))
    return Room(np.zeros(MOST, np.int64), np.zeros(MOST), np.zeros(MOST), square, np.zeros(MOST), np.zeros(directions))


@njit(nogil=True)
def nearest(z, atoms, chosen, count, raised, work):
    """Proven lower bound of the squared distance from z to the cone of some atoms, and how many are in use.

    Args:
        z: (R,).
        atoms: unit atoms (A, R).
        chosen: rows of `atoms` that make up the cone; the first `count` of them.
        raised: h with h . d >= 1 for every atom (R,).
        work: `Room`; `used` and `amount` tell the combination.
    """
    used, amount, residual = work.used, work.amount, work.residual
    n, size = 0, 0.0
    for r in range(len(z)):
        residual[r] = z[r]
        size += z[r] * z[r]
    flat = _FLAT * np.sqrt(size)
    steepest = 0.0
    for _ in range(_ROUNDS):
        steepest, best = _steepest(atoms, chosen, count, residual)
        if steepest <= flat or n == MOST or not _add(z, atoms, best, n, work):
            break
        n = _balance(z, atoms, n + 1, work)
        for r in range(len(z)):
            residual[r] = z[r]
            for i in range(n):
                residual[r] -= amount[i] * atoms[used[i], r]
    lift = max(steepest, 0.0)
    bound = 0.0
    for r in range(len(z)):
        turned = residual[r] - lift * raised[r]
        bound += (2.0 * z[r] - turned) * turned
    return max(bound, 0.0), n


@njit(fastmath={"reassoc", "contract", "nsz"})
def _steepest(atoms, chosen, count, residual):
    """The most that a residual points along an atom, and that atom."""
    steepest, best = -np.inf, -1
    for k in range(count):
        along = 0.0
        for r in range(len(residual)):
            along += atoms[chosen[k], r] * residual[r]
        if along > steepest:
            steepest, best = along, chosen[k]
    return steepest, best


@njit()
def _add(z, atoms, new, n, work):
    """Take an atom into use as the last; False where it cannot be told from those that are."""
    used, amount = work.used, work.amount
    for i in range(n):
        if used[i] == new:
            return False
    used[n], amount[n] = new, 0.0
    return _factorise(z, atoms, n, n + 1, work)


@njit()
def _factorise(z, atoms, first, n, work):
    """Rows first .. n of the Cholesky factor; False where an atom depends on those before it."""
    used, factor, seen = work.used, work.factor, work.seen
    for i in range(first, n):
        total = 0.0
        for r in range(len(z)):
            total += atoms[used[i], r] * z[r]
        seen[i] = total
        for j in range(i + 1):
            total = 0.0
            for r in range(len(z)):
                total += atoms[used[i], r] * atoms[used[j], r]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if j < i:
                factor[i, j] = total / factor[j, j]
            elif total < _APART:
                return False
            else:
                factor[i, i] = np.sqrt(total)
    return True


@njit()
def _balance(z, atoms, n, work):
    """Best amounts of the atoms in use, dropping those that would turn negative; how many are left."""
    used, amount, trial = work.used, work.amount, work.trial
    while n > 0:
        _solve(work.factor, work.seen, trial, n)
        step, out = 1.0, -1
        for i in range(n):
            if trial[i] <= 0.0:
                here = amount[i] / (amount[i] - trial[i]) if amount[i] > trial[i] else 0.0
                if here < step or out < 0:
                    step, out = here, i
        for i in range(n):
            amount[i] = trial[i] if out < 0 else amount[i] + step * (trial[i] - amount[i])
        if out < 0:
            break
        for i in range(out, n - 1):
            used[i], amount[i] = used[i + 1], amount[i + 1]
        n -= 1
        if not _factorise(z, atoms, out, n, work):
            return n
    return n


@njit()
def _solve(factor, seen, trial, n):
    for i in range(n):
        total = seen[i]
        for k in range(i):
            total -= factor[i, k] * trial[k]
        trial[i] = total / factor[i, i]
    for i in range(n - 1, -1, -1):
        total = trial[i]
        for k in range(i + 1, n):
            total -= factor[k, i] * trial[k]
        trial[i] = total / factor[i, i]
