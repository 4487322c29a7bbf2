"""Branch and bound over pairs of intervals of rates, compiled: what `certificate` proves its bounds with."""

from __future__ import annotations

import numpy as np

from petkin.fitting.cones import nearest
from petkin.jit import njit

#: Columns of a branch: bound, fast interval, slow interval (positions between nodes), where it is best split
#: (-1 for nowhere), and which of the two.
COLUMNS = 7
_BOUND, _LOW_1, _HIGH_1, _LOW_2, _HIGH_2, _CUT, _WHICH = range(COLUMNS)
#: Narrowest interval that is still halved, in nodes.
_NARROWEST = 1e-3
#: Control points made for intervals inside one node's: four each.
SPARE = 8


@njit(nogil=True)
def branch_and_bound(
    columns,
    outside,
    reached,
    rows,
    atoms,
    raised,
    blood,
    pair,
    trapped,
    within,
    branches,
    chosen,
    work,
    bounds,
    looked,
):
    """Lower bounds of the cost of N curves; see `certificate.prove`.

    Args:
        columns: compressed curves (N, R).
        outside, reached: part of the cost that no model takes away, and cost of the fits at hand (N,).
        rows, atoms, raised, blood: see `certificate.Hulls`.
        pair, trapped, within: see `certificate.prove`.
        branches, chosen, work: scratch (cones, COLUMNS), (atoms,), `cones.Room`.
        bounds, looked: the answers (N,).
    """
    last = len(rows) // 2 - 1.0
    for n in range(len(columns)):
        z = columns[n]
        goal = reached[n] * (1.0 - within) - outside[n]
        _branch(branches, 0, 0.0, last, 0.0, last if pair else 0.0)
        _bound(branches, 0, z, rows, atoms, raised, blood, pair, trapped, chosen, work)
        count, seen = 1, 1
        least = 0
        while branches[least, _BOUND] < goal and seen + 3 <= len(branches) and branches[least, _CUT] >= 0.0:
            first = count
            count = _split(branches, least, count, pair)
            _bound(branches, least, z, rows, atoms, raised, blood, pair, trapped, chosen, work)
            for b in range(first, count):
                _bound(branches, b, z, rows, atoms, raised, blood, pair, trapped, chosen, work)
            seen += 1 + count - first
            least = 0
            for b in range(1, count):
                least = b if branches[b, _BOUND] < branches[least, _BOUND] else least
        bounds[n] = max(branches[least, _BOUND] + outside[n], 0.0)
        looked[n] = seen


@njit()
def _branch(branches, b, low_1, high_1, low_2, high_2):
    branches[b, _BOUND] = 0.0
    branches[b, _LOW_1], branches[b, _HIGH_1] = low_1, high_1
    branches[b, _LOW_2], branches[b, _HIGH_2] = low_2, high_2


@njit()
def _split(branches, b, count, pair):
    """Halve one of a branch's intervals: one half takes its place, others come after the `count` that there are."""
    low_1, high_1, low_2, high_2 = branches[b, _LOW_1], branches[b, _HIGH_1], branches[b, _LOW_2], branches[b, _HIGH_2]
    cut = branches[b, _CUT]
    if pair and low_1 == low_2 and high_1 == high_2:
        _branch(branches, b, low_1, cut, low_1, cut)
        _branch(branches, count, cut, high_1, low_1, cut)
        _branch(branches, count + 1, cut, high_1, cut, high_1)
        return count + 2
    if branches[b, _WHICH] == 1.0:
        _branch(branches, b, low_1, cut, low_2, high_2)
        _branch(branches, count, cut, high_1, low_2, high_2)
    else:
        _branch(branches, b, low_1, high_1, low_2, cut)
        _branch(branches, count, low_1, high_1, cut, high_2)
    return count + 1


@njit()
def _bound(branches, b, z, rows, atoms, raised, blood, pair, trapped, chosen, work):
    """Bound of a branch, and where it is best split: at the middle of what its cone uses, -1 for nowhere."""
    low_1, high_1, low_2, high_2 = branches[b, _LOW_1], branches[b, _HIGH_1], branches[b, _LOW_2], branches[b, _HIGH_2]
    spare = len(atoms) - 1 - SPARE
    count = _take(low_1, high_1, rows, atoms, spare, chosen, 0)
    same = low_1 == low_2 and high_1 == high_2
    if pair and not same:
        count = _take(low_2, high_2, rows, atoms, spare + 4, chosen, count)
    if trapped:
        chosen[count], count = 0, count + 1
    if blood:
        chosen[count], count = len(atoms) - 1, count + 1
    branches[b, _BOUND], used = nearest(z, atoms, chosen, count, raised, work)
    middle_1, spread_1 = _spread(work, used, low_1, high_1, spare, spare)
    middle_2, spread_2 = _spread(work, used, low_2, high_2, spare, spare + 4)
    if not pair or same:
        spread_2 = -1.0
    branches[b, _WHICH] = 1.0 if spread_1 >= spread_2 else 2.0
    branches[b, _CUT] = _cut(middle_1, low_1, high_1) if spread_1 >= spread_2 else _cut(middle_2, low_2, high_2)


@njit()
def _take(low, high, rows, atoms, spare, chosen, count):
    """Control points of an interval: those of the table between nodes, four of its own inside one of the table's."""
    if low == np.floor(low) and high == np.floor(high):
        for k in range(3 * int(low), 3 * int(high) + 1):
            chosen[count], count = k, count + 1
        return count
    node = min(int(np.floor(low)), len(rows) // 2 - 2)
    _end(rows, node, low - node, (high - low) / 3.0, atoms, spare, spare + 1)
    _end(rows, node, high - node, (low - high) / 3.0, atoms, spare + 3, spare + 2)
    for k in range(spare, spare + 4):
        chosen[count], count = k, count + 1
    return count


@njit()
def _end(rows, node, s, reach, atoms, at, beside):
    """b at a place inside an interval, and the control point beside it, at unit length."""
    a0, a1 = (1.0 + 2.0 * s) * (1.0 - s) ** 2, s * (1.0 - s) ** 2
    a2, a3 = s * s * (3.0 - 2.0 * s), s * s * (s - 1.0)
    e0, e1 = 6.0 * s * (s - 1.0), (1.0 - s) * (1.0 - 3.0 * s)
    e2, e3 = -e0, s * (3.0 * s - 2.0)
    one = two = 0.0
    for r in range(rows.shape[1]):
        p0, p1, p2, p3 = rows[2 * node, r], rows[2 * node + 1, r], rows[2 * node + 2, r], rows[2 * node + 3, r]
        value = a0 * p0 + a1 * p1 + a2 * p2 + a3 * p3
        moved = value + reach * (e0 * p0 + e1 * p1 + e2 * p2 + e3 * p3)
        atoms[at, r], atoms[beside, r] = value, moved
        one, two = one + value * value, two + moved * moved
    one, two = 1.0 / np.sqrt(one), 1.0 / np.sqrt(two)
    for r in range(rows.shape[1]):
        atoms[at, r] *= one
        atoms[beside, r] *= two


@njit()
def _spread(work, used, low, high, spare, own):
    """Middle of the atoms in use inside an interval and how far apart they lie, both by amount."""
    total = first = second = 0.0
    for i in range(used):
        k, x = work.used[i], work.amount[i]
        if k < spare:
            place = k / 3.0
            if not (low <= place <= high):
                continue
        elif own <= k < own + 4:
            place = low + (high - low) * (k - own) / 3.0
        else:
            continue
        total, first, second = total + x, first + x * place, second + x * place * place
    if total == 0.0:
        return 0.5 * (low + high), 0.0
    return first / total, max(second - first * first / total, 0.0)


@njit()
def _cut(middle, low, high):
    """Where an interval is split: at a node as long as there is one inside, then in the middle; -1 for nowhere."""
    if high - low > 1.0:
        return min(max(np.round(middle), low + 1.0), high - 1.0)
    return 0.5 * (low + high) if high - low > _NARROWEST else -1.0
