"""How far from the best fit of all a fit can be at most: a proof, curve by curve.

A fit of two exponentials is a combination v C_B + x_1 b(u_1) + x_2 b(u_2) with v, x >= 0, so for rates known to lie in
two intervals it belongs to the cone of all b(u) in them. Between two nodes the table is a cubic, and a cubic is a
combination, with amounts >= 0 that add up to one, of its four Bernstein control points. The cone of those control
points, finitely many, therefore holds every b(u) of the continuous interval, and no model is nearer to the curve than
that cone is (`cones` proves how near). *Branch and bound* (`branches`): pairs of intervals are halved, the least
proven first, until all bounds together are as near to the reached cost as was asked.

The proof is about the tabulated model, which is B(a) to 3e-8 of a curve's norm (160 nodes).

References: Land AH, Doig AG. Econometrica 1960;28:497-520. doi:10.2307/1910129 (branch and bound). Farouki RT.
The Bernstein polynomial basis: a centennial retrospective. Comput Aided Geom Des 2012;29:379-419.
doi:10.1016/j.cagd.2012.03.001 (convex hull)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.branches import COLUMNS, SPARE, branch_and_bound
from petkin.fitting.cones import room
from petkin.fitting.nonlinear import NonlinearSettings, alike, takes_blood
from petkin.fitting.parts import in_parts
from petkin.fitting.projection import project_curves
from petkin.fitting.results import Column, FitResult
from petkin.fitting.table import BasisTable, Compression, compress

Array = NDArray[np.float64]

#: Directions of the table below this singular value hold less than rounding.
_KEPT = 1e-9
_GAP = "proven: no parameters at all lower the weighted sum of squares by more than this share"


class Hulls(NamedTuple):
    """What proofs read of a compressed table.

    Args:
        rows: b and db/dx of every node (2 nodes, R).
        atoms: unit control points, three an interval and the last node (3 nodes - 2, R), then room for others, then
            the blood.
        raised: h with h . d >= 1 for every atom d (R,).
        blood: whether blood takes part.
    """

    rows: Array
    atoms: Array
    raised: Array
    blood: bool


def hulls(packed: Compression, *, blood: bool) -> Hulls:
    """Control points of a compressed table."""
    rows = np.ascontiguousarray(packed.products.rows.T)
    value, slope = rows[::2], rows[1::2]
    points = np.stack([value[:-1], value[:-1] + slope[:-1] / 3.0, value[1:] - slope[1:] / 3.0], axis=1)
    points = np.concatenate([points.reshape(-1, packed.size), value[-1:]])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    first = np.eye(1, packed.size)
    every = np.concatenate([points, first]) if blood else points
    middle = _middle(every)
    atoms = np.concatenate([points, np.zeros((SPARE, packed.size)), first])
    return Hulls(rows, atoms, middle / (every @ middle).min(), blood)


def _middle(atoms: Array) -> Array:
    """A direction that all atoms share, by steps towards the one that shares least (Frank & Wolfe)."""
    middle = atoms.mean(axis=0)
    for n in range(200):
        worst = atoms[np.argmin(atoms @ middle)]
        middle += (worst - middle) / (n + 3.0)
    return middle


def certify(
    curves: NDArray[np.floating],
    result: FitResult,
    table: BasisTable,
    settings: NonlinearSettings,
    *,
    within: float = 1e-3,
    most: int = 400,
) -> Column:
    """How many percent of the reached cost any other fit can save at most.

    Args:
        curves: the curves that were fitted (N, K).
        result: their fit.
        table: basis table over the rates that they may have.
        settings: as they were fitted with.
        within: a proof ends where it is this near, as a share of the cost.
        most: cones to look at before giving up.

    Returns:
        Column "gap" (N,), percent; NaN where there is no fit.
    """
    model, box = settings.model, settings.box
    gap = np.full(len(curves), np.nan)
    held = box["vB"].start if box["vB"].fixed else 0.0
    for rows, weights in alike(np.asarray(result.weights, np.float64), len(curves)):
        packed = compress(table, weights, tolerance=_KEPT)
        z, sizes, *_ = project_curves(packed, weights, np.asarray(curves)[rows].T, 0, len(rows))
        outside = np.maximum(sizes - (z * z).sum(axis=0), 0.0)
        z[0] -= held * packed.blood
        reached = np.asarray(result.chi2[rows], np.float64) * (np.count_nonzero(weights > 0) - len(box.free))
        hull = hulls(packed, blood=takes_blood(box) and not box["vB"].fixed)
        fitted = np.isfinite(reached)
        bounds, _ = prove(
            hull,
            model.free_rates == 2,
            model.trapping or model.wall,
            z[:, fitted],
            outside[fitted],
            reached[fitted],
            within=within,
            most=most,
        )
        gap[rows[fitted]] = 100.0 * np.maximum(1.0 - bounds / np.maximum(reached[fitted], 1e-300), 0.0)
    return Column("gap", gap, _GAP, "percent")


def prove(
    hull: Hulls, pair: bool, trapped: bool, z: Array, outside: Array, reached: Array, *, within: float, most: int
) -> tuple[Array, NDArray[np.int64]]:
    """Proven lower bounds of the cost of N curves.

    Args:
        hull: from `hulls`.
        pair: whether two rates are free.
        trapped: whether the table's first node, a = 0, takes part besides.
        z: compressed curves (R, N).
        outside: part of the cost that no model can take away (N,).
        reached: cost of the fits at hand (N,).
        within: a proof may end once the bound is within this share of `reached`.
        most: cones to look at before giving up.

    Returns:
        bounds (N,), never above the least cost there is, and cones looked at (N,).
    """
    bounds, looked = np.empty(len(reached)), np.zeros(len(reached), np.int64)
    columns = np.ascontiguousarray(z.T)

    def work(rows: slice) -> None:
        branch_and_bound(
            columns[rows],
            outside[rows],
            reached[rows],
            hull.rows,
            hull.atoms.copy(),
            hull.raised,
            hull.blood,
            pair,
            trapped,
            within,
            np.empty((most + 3, COLUMNS)),
            np.empty(len(hull.atoms), np.int64),
            room(len(z)),
            bounds[rows],
            looked[rows],
        )

    in_parts(work, len(reached))
    return bounds, looked
