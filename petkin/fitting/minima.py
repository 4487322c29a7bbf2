"""Other sets of parameters that fit a curve as well: local minima of the cost over all rates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.bounded import fit_in_box
from petkin.fitting.cones import nearest, room
from petkin.fitting.f_distribution import quantile
from petkin.fitting.nonlinear import NonlinearSettings, alike, squeeze
from petkin.fitting.projection import project_curves
from petkin.fitting.results import Column, FitResult, Status
from petkin.fitting.table import BasisTable, Compression
from petkin.jit import njit

Array = NDArray[np.float64]

#: Rates that are tried, evenly spaced in log(a + c).
_TRIED = 40
#: Two minima are different if what the model is used for lies more standard errors apart than this.
_APART = 2.0
#: Minima are looked for this far from the ends of the interval of rates, where a fit can stop without being at one.
_OFF = 1.0 + 1e-4
_OTHER = "in another minimum of the cost, which fits the curve as well within its noise (F test, 5 percent)"


def with_second_minimum(
    result: FitResult,
    curves: NDArray[np.floating],
    table: BasisTable,
    settings: NonlinearSettings,
) -> FitResult:
    """The result with status SECOND_MINIMUM where another minimum of the cost cannot be told from the best.

    That is one whose cost lies below S_min (1 + F_0.95(1, n - p) / (n - p)) and whose outcome (the model's first
    macro-parameter) differs by more than two standard errors; the column `<outcome>-second` holds it.

    Args:
        result: fit of the curves.
        curves: (N, K), a few hundred at most: every pair of rates is tried.
        table: basis table that they were fitted with.
        settings: as they were fitted with. Models with vessel walls are left as they are.
    """
    if settings.model.wall:
        return result
    outcome = settings.model.macros[0].symbol
    best, error = result[outcome], result.percent_se(outcome) * np.abs(result[outcome]) / 100.0
    other = np.full(len(curves), np.nan)
    judged = np.isin(result.status, (Status.OK, Status.AT_BOUND)) & np.isfinite(error)
    for rows, weights in alike(np.asarray(result.weights, np.float64), len(curves)):
        rows = rows[judged[rows]]
        if rows.size == 0:
            continue
        packed = squeeze(table, weights, settings)
        freedom = int(np.count_nonzero(weights > 0)) - len(settings.box.free)
        limit = result.chi2[rows] * freedom * (1.0 + quantile(0.95, 1, freedom) / freedom)
        z, sizes, *_ = project_curves(packed, weights, np.asarray(curves)[rows].T, 0, len(rows))
        curve, values, cost = _minima(packed, z, sizes, settings)
        far = np.abs(values - best[rows][curve]) > _APART * error[rows][curve]
        rival = far & (cost <= limit[curve])
        for n in np.unique(curve[rival]):
            mine = np.flatnonzero(rival & (curve == n))
            other[rows[n]] = values[mine[np.argmin(cost[mine])]]
    found = np.isfinite(other)
    status = np.where(found, np.uint8(Status.SECOND_MINIMUM), result.status)
    column = Column(f"{outcome}-second", other, f"{outcome} {_OTHER}", _unit(result, outcome), mapped=False)
    return replace(result, status=status, columns=(*result.columns, column))


def _unit(result: FitResult, symbol: str) -> str:
    return next(e.unit for e in result.estimates if e.symbol == symbol)


def _minima(packed: Compression, z: Array, sizes: Array, settings: NonlinearSettings) -> tuple[NDArray, Array, Array]:
    """Every local minimum's curve, outcome and cost."""
    model, box = settings.model, settings.box
    curve, starts = _starts(packed, z, settings)
    theta, cost, converged = fit_in_box(
        model, packed, z[:, curve], sizes[curve], starts, box, (0.0, np.inf), starts=0, tolerance=1e-10, explicit=True
    )
    with np.errstate(all="ignore"):
        values = np.asarray(model.macros[0].formula(*theta[:, : model.rates].T))
        rates = np.stack([a for _, a in model.impulse(*theta[:, : model.rates].T)][: model.free_rates])
    slow, fast = settings.rate_bounds
    kept = converged & np.isfinite(values) & ((rates > slow * _OFF) & (rates * _OFF < fast)).all(axis=0)
    return curve[kept], values[kept], cost[kept]


def _starts(packed: Compression, z: Array, settings: NonlinearSettings) -> tuple[NDArray[np.intp], Array]:
    """Parameters at the lowest nodes and pairs of nodes among their neighbours, and whose curve they are for."""
    model = settings.model
    nodes = np.unique(np.linspace(0, len(packed.u) - 1, _TRIED).round().astype(np.int64))
    rates = packed.rates[nodes]
    lengths = np.linalg.norm(packed.basis[nodes], axis=1)
    atoms = np.concatenate([packed.basis[nodes] / lengths[:, None], np.eye(1, packed.size)])
    curves, starts = [], []
    for n in range(z.shape[1]):
        score, amounts = _scan(np.ascontiguousarray(z[:, n]), atoms, model.free_rates == 2, model.trapping)
        for i, j in _lowest(score):
            blood, fast, slow = amounts[i, j] / np.array([max(packed.blood, 1e-300), lengths[i], lengths[j]])
            vB = min(blood, 0.99)
            slowest = rates[j] if model.free_rates == 2 else 0.0
            pairs = [(fast / (1.0 - vB), rates[i]), (slow / (1.0 - vB), slowest)][: model.free_rates + model.trapping]
            if all(phi > 0.0 for phi, _ in pairs):
                curves.append(n)
                starts.append([*model.invert(*pairs), vB])
    return np.array(curves, np.intp), np.array(starts, np.float64).reshape(len(curves), len(model.parameters))


@njit()
def _scan(z, atoms, pair, trapped):
    """Cost of every node or pair of nodes (first faster), and amounts of blood and both atoms."""
    nodes = len(atoms) - 1
    cost, amounts = np.full((nodes, nodes), np.inf), np.zeros((nodes, nodes, 3))
    chosen, work, none = np.array([nodes, 0, 0]), room(len(z)), np.zeros(len(z))
    for i in range(nodes):
        for j in range(i if pair else 1):
            chosen[1], chosen[2] = i, j
            bound, used = nearest(z, atoms, chosen, 3 if pair or trapped else 2, none, work)
            cost[i, j] = bound
            for k in range(used):
                place = 0 if work.used[k] == nodes else (1 if work.used[k] == i else 2)
                amounts[i, j, place] = work.amount[k]
    return cost, amounts


def _lowest(score: Array) -> list[tuple[int, int]]:
    """Entries that no neighbour undercuts."""
    padded = np.pad(score, 1, constant_values=np.inf)
    rows, columns = score.shape
    around = [padded[1 + a : 1 + a + rows, 1 + b : 1 + b + columns] for a in (-1, 0, 1) for b in (-1, 0, 1)]
    return [(int(i), int(j)) for i, j in np.argwhere(np.isfinite(score) & (score <= np.min(around, axis=0)))]
