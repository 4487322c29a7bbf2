"""The search beside vessel walls that trap tracer: one more column, vB Kb int C_P, of any amplitude x >= 0.

Seen at right angles to that column, a curve is exponentials and blood as ever, whatever x is: so the search runs there,
and x follows. Where it comes out negative, the best curve has none, and the search without a wall is the answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.search import Effort, Exponentials, search_exponentials
from petkin.fitting.sensitivity import read_basis
from petkin.fitting.table import Compression, project_rows
from petkin.kinetics import CompartmentModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WallTables:
    """A compressed table as it is and at right angles to the wall's column.

    Args:
        plain: coordinates of all, rates from the slowest that a fit may use.
        off: the same without the direction of the wall.
        turn: from the ones to the others (R - 1, R).
        wall: the wall's column, int C_P (R,).
        blood: whether blood, and with it the wall, may take part.
    """

    plain: Compression
    off: Compression
    turn: Array
    wall: Array
    blood: bool


def wall_tables(packed: Compression, slowest: float, *, blood: bool) -> WallTables:
    """Tables for `search_beside_wall`, from one that begins at the rate 0."""
    fast = packed.rates >= slowest
    plain = replace(packed, basis=packed.basis[fast], slope=packed.slope[fast], u=packed.u[fast])
    wall, first = packed.basis[0], np.eye(packed.size)[0]
    axes = np.linalg.qr(np.column_stack([wall, first, np.eye(packed.size)]))[0].T
    turn = axes[1:] * np.where(axes[1, 0] < 0, -1.0, 1.0)
    off = replace(
        plain,
        project=turn @ packed.project,
        basis=plain.basis @ turn.T,
        slope=plain.slope @ turn.T,
        blood=packed.blood * float(turn[0, 0]),
    )
    return WallTables(plain, off, turn, wall, blood)


def search_beside_wall(
    model: CompartmentModel, tables: WallTables, z: Array, sizes: Array, effort: Effort
) -> Exponentials:
    """Best exponentials of every curve, and Kb; arguments as for `search_exponentials`."""
    without = search_exponentials(model, tables.plain, z, sizes, effort, blood=tables.blood)
    if not tables.blood:
        return replace(without, Kb=np.zeros(len(sizes)))
    unit = tables.wall / np.linalg.norm(tables.wall)
    along = project_rows(unit[None], np.ascontiguousarray(z.T))[0]
    turned = project_rows(tables.turn, np.ascontiguousarray(z.T))
    found = search_exponentials(model, tables.off, turned, sizes - along**2, effort, blood=True)
    with np.errstate(all="ignore"):
        x = (along - _along(found, tables, unit)) / np.linalg.norm(tables.wall)
        Kb = np.where(x > 0, x / found.vB, 0.0)
    taken = (x > 0) & (found.cost < without.cost)
    return Exponentials(
        np.where(taken[:, None], found.phi, without.phi),
        np.where(taken[:, None], found.rate, without.rate),
        np.where(taken, found.vB, without.vB),
        np.where(taken, found.cost, without.cost),
        np.where(taken, found.converged, without.converged),
        np.where(taken, Kb, 0.0),
    )


def _along(found: Exponentials, tables: WallTables, unit: Array) -> Array:
    """What blood and exponentials hold of the wall's direction (N,)."""
    total = found.vB * tables.plain.blood * unit[0]
    for phi, rate in zip(found.phi.T, found.rate.T):
        total = total + (1.0 - found.vB) * phi * (read_basis(tables.plain, rate)[0] * unit).sum(axis=1)
    return total
