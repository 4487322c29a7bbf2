"""A region with two tissue compartments seen from a reference region: four numbers, two rates of washout.

The tissue's impulse response has two exponentials with shares p_1 + p_2 = 1 and rates a_1, a_2 (those of the 2TCM with
K1 = 1), and the plasma is what the reference region's one compartment, whose k2' is k2 / R1, makes of C_R. Hence

    C_T = R1 C_R + sum_i p_i (k2 - R1 a_i) e^{-a_i t} * C_R,   BPND = k3 / k4.

Reference: Lammertsma AA et al. J Cereb Blood Flow Metab 1996;16:42-52, doi:10.1097/00004647-199601000-00005
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import ParameterSet
from petkin.fitting.explicit import best_polish
from petkin.fitting.one_rate_fit import frame_values, frames_first
from petkin.fitting.projection import project_curves
from petkin.fitting.results import Estimate, FitResult, Status
from petkin.fitting.search import Effort
from petkin.fitting.sensitivity import derivatives, read_basis
from petkin.fitting.summary import akaike
from petkin.fitting.table import Compression, project_rows
from petkin.kinetics import TWO_TISSUE
from petkin.levenberg_marquardt import ON_BOUND

Array = NDArray[np.float64]

#: Curves handled together.
_CHUNK = 4096
#: Levels of k2, k3 and k4 on the grid of starts, 1/min.
_LEVELS = (
    np.geomspace(0.01, 1.0, 7),
    np.geomspace(0.003, 0.5, 6),
    np.geomspace(0.005, 0.5, 6),
)
#: Singular normal matrices are inverted as if they had this much of their diagonal more.
_RIDGE = 1e-13


def _mixture(R1, k2, k3, k4):
    (fast, a1), (slow, a2) = TWO_TISSUE.impulse(1.0, k2, k3, k4)
    return R1, fast * (k2 - R1 * a1), a1, slow * (k2 - R1 * a2), a2


def curve_values(packed: Compression, theta: Array) -> Array:
    """Compressed curves (N, R) of R1, k2, k3, k4 (N, 4)."""
    R1, phi_1, a1, phi_2, a2 = _mixture(*theta.T)
    curves = phi_1[:, None] * read_basis(packed, a1)[0] + phi_2[:, None] * read_basis(packed, a2)[0]
    curves[:, 0] += R1 * packed.blood
    return curves


def curve_jacobian(packed: Compression, theta: Array) -> tuple[Array, Array]:
    """Compressed curves (N, R) and their derivatives (N, R, 4)."""
    numbers, chain = derivatives(_mixture, theta)
    curves = np.zeros((len(theta), packed.size))
    curves[:, 0] = numbers[:, 0] * packed.blood
    jacobian = np.zeros((len(theta), packed.size, 4))
    jacobian[:, 0] = chain[:, 0] * packed.blood
    for i in (1, 3):
        basis, slope = read_basis(packed, numbers[:, i + 1])
        curves += numbers[:, i, None] * basis
        jacobian += basis[:, :, None] * chain[:, None, i]
        jacobian += (numbers[:, i, None] * slope)[:, :, None] * chain[:, None, i + 1]
    return curves, jacobian


@dataclass(frozen=True)
class _Ended:
    """Where N curves ended: parameters (N, 4), costs, flags."""

    theta: Array
    cost: Array
    converged: NDArray[np.bool_]
    finite: NDArray[np.bool_]
    signal: NDArray[np.bool_]


def fit_two_rates(
    curves: NDArray[np.floating],
    packed: Compression,
    weights: Array,
    box: ParameterSet,
    effort: Effort,
    *,
    settings: dict[str, Any],
    keep_predicted: bool,
) -> FitResult:
    """Weighted least squares of frame values inside a box, from the best points of a grid.

    Args:
        curves: (N, K), kBq/mL.
        packed: compressed table of e^{-at} * C_R whose axis is C_R; must reach the fastest rate that the box allows.
        weights: (K,), those that the table was compressed with.
        box: bounds of R1, k2, k3 and k4.
        effort: how hard to search.
        settings: what was chosen, for sidecars.
        keep_predicted: return fitted curves.
    """
    frames, used = frames_first(curves), int(np.count_nonzero(weights))
    starts = [slice(i, min(i + _CHUNK, len(curves))) for i in range(0, max(len(curves), 1), _CHUNK)]
    parts = [_fit_part(frames, rows, packed, weights, box, effort) for rows in starts]
    ended = _Ended(*(np.concatenate([getattr(p, name) for p in parts]) for name in _Ended.__annotations__))
    with np.errstate(all="ignore"):
        chi2 = ended.cost / (used - len(box.free))
        touching = _touching(ended.theta, box)
        R1, k2, k3, k4 = ended.theta.T
        BPND = np.where(k3 == 0.0, 0.0, k3 / k4)  # whatever k4 is, nothing binds
        values = np.stack([R1, k2, k3, k4, k2 / R1, np.where(np.isfinite(BPND), BPND, np.nan)])
        errors = np.concatenate([_errors(packed, ended.theta[rows], touching[rows], box) for rows in starts]).T
        percent = 100.0 * errors * np.sqrt(chi2) / np.abs(values)
    status = np.where(touching.any(axis=1), Status.AT_BOUND, Status.OK).astype(np.uint8)
    status[~(percent[-1] <= 100.0)] = Status.NOT_IDENTIFIABLE
    status[~ended.converged] = Status.NOT_CONVERGED
    status[~ended.signal] = Status.NO_SIGNAL
    status[~ended.finite] = Status.NOT_FINITE
    blank = np.where(ended.finite & ended.signal, 1.0, np.nan)
    names = [(p.symbol, p.unit, p.meaning) for p in box] + [
        ("k2prime", "min^-1", "rate of return of the reference region, k2 / R1"),
        ("BPND", "1", "binding potential relative to non-displaceable tracer, k3 / k4"),
    ]
    predicted = frame_values(packed, curve_values(packed, np.nan_to_num(ended.theta))) if keep_predicted else None
    return FitResult(
        model="FRTM",
        estimates=tuple(Estimate(s, u, v * blank, p * blank, m) for (s, u, m), v, p in zip(names, values, percent)),
        chi2=chi2 * blank,
        aicc=akaike(ended.cost, used, len(box.free) + 1) * blank,
        status=status,
        weights=weights,
        predicted=None if predicted is None else predicted * blank[:, None],
        settings={**settings, "bounds": {p.symbol: [p.lower, p.upper] for p in box if not p.fixed}},
    )


def _fit_part(
    frames: NDArray[np.floating], rows: slice, packed: Compression, weights: Array, box: ParameterSet, effort: Effort
) -> _Ended:
    z, sizes, finite, signal = project_curves(packed, weights, frames, rows.start, rows.stop)
    starts = _grid_starts(packed, z, box, effort.starts)
    tolerance = max(1e-2 * effort.tolerance, 1e-10)
    theta, cost, converged = best_polish(
        partial(curve_values, packed),
        partial(curve_jacobian, packed),
        z,
        sizes,
        starts,
        box.lower,
        box.upper,
        tolerance,
    )
    return _Ended(theta, np.maximum(cost, np.finfo(np.float64).eps * sizes), converged, finite, signal)


def _grid_starts(packed: Compression, z: Array, box: ParameterSet, count: int) -> list[Array]:
    """The best grid points of every curve, `count` times (N, 4); R1 by least squares, since curves are linear in it."""
    levels = [np.unique(np.clip(level, p.lower, p.upper)) for level, p in zip(_LEVELS, list(box)[1:])]
    rates = np.array(list(itertools.product(*levels)))
    without = curve_values(packed, np.column_stack([np.zeros(len(rates)), rates]))
    unit = curve_values(packed, np.column_stack([np.ones(len(rates)), rates])) - without
    square, both = (unit**2).sum(axis=1)[:, None], (unit * without).sum(axis=1)[:, None]
    rows = np.ascontiguousarray(z.T)
    along_unit, along_rest = project_rows(unit, rows), project_rows(without, rows)
    R1 = np.clip((along_unit - both) / square, box.lower[0], box.upper[0])
    # |z - v - R1 u|^2 without what all grid points have in common
    left = (without**2).sum(axis=1)[:, None] - 2.0 * along_rest + R1 * (2.0 * (both - along_unit) + R1 * square)
    order = np.argsort(left, axis=0, kind="stable")[:count]
    columns = np.arange(z.shape[1])
    return [np.column_stack([R1[row, columns], rates[row]]) for row in order]


def _touching(theta: Array, box: ParameterSet) -> NDArray[np.bool_]:
    """Free parameters on a bound (N, 4)."""
    slack = ON_BOUND * np.maximum(box.upper - box.lower, 1e-3)
    free = ~np.array([p.fixed for p in box])
    return free & ((theta <= box.lower + slack) | (theta >= box.upper - slack))


def _errors(packed: Compression, theta: Array, touching: NDArray[np.bool_], box: ParameterSet) -> Array:
    """Standard errors at unit weight of R1, k2, k3, k4, k2', BPND (N, 6); NaN on a bound, zero where fixed."""
    held = touching | np.array([p.fixed for p in box])
    _, jacobian = curve_jacobian(packed, theta)
    jacobian = np.where(held[:, None, :], 0.0, jacobian)
    scale = np.sqrt((jacobian**2).sum(axis=1))
    jacobian /= np.where(scale > 0, scale, 1.0)[:, None, :]
    normal = np.einsum("nrp,nrq->npq", jacobian, jacobian) + np.eye(4) * np.where(scale > 0, _RIDGE, 1.0)[:, None, :]
    unscaled = np.where(scale > 0, 1.0 / scale, np.where(held, 0.0, np.inf))
    covariance = np.nan_to_num(np.linalg.inv(normal) * unscaled[:, :, None] * unscaled[:, None, :], posinf=1e300)
    _, slopes = derivatives(lambda R1, k2, k3, k4: (R1, k2, k3, k4, k2 / R1, k3 / k4), theta)
    errors = np.sqrt(np.maximum(np.einsum("nqi,nij,nqj->nq", slopes, covariance, slopes), 0.0))
    errors[:, :4][touching] = np.nan
    return errors
