"""Compartment models fitted to curves, voxels and regions alike: weighted least squares of frame values."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import ParameterSet
from petkin.errors import InputError
from petkin.fitting.bounded import ON_BOUND, fit_in_box
from petkin.fitting.covariance import covariances
from petkin.fitting.results import Estimate, FitResult, Status
from petkin.fitting.search import REGIONS, Effort, search_exponentials
from petkin.fitting.sensitivity import derivatives, model_values
from petkin.fitting.table import RATE_OFFSET, Compression, build_table, compress, project_rows
from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction
from petkin.kinetics import CompartmentModel

Array = NDArray[np.float64]

#: Slowest rate that a fit may use, 1/min: a half-life of 11.5 h, beyond what any scan can tell from none.
SLOWEST_RATE = 1e-3
#: Fastest rate, 1/min: a half-life of 8 s.
FASTEST_RATE = 5.0
#: Activity (kBq/mL) from which on a value counts as infinite: its square must stay a number.
_LARGEST = 1e30
#: Curves handled together where arrays of curves x directions x parameters are needed.
_CHUNK = 16384


@dataclass(frozen=True)
class NonlinearSettings:
    """What to fit and how hard.

    Args:
        model: compartment model.
        parameters: bounds and fixed values; None takes the model's.
        rate_bounds: interval of the exponentials' rates, 1/min. It regularises noisy voxels.
        effort: `REGIONS` (to rounding) or `VOXELS` (a microsecond each).
        keep_predicted: return fitted curves.
    """

    model: CompartmentModel
    parameters: ParameterSet | None = None
    rate_bounds: tuple[float, float] = (SLOWEST_RATE, FASTEST_RATE)
    effort: Effort = REGIONS
    keep_predicted: bool = True

    @property
    def box(self) -> ParameterSet:
        return self.parameters or self.model.parameters


def fit_curves(
    curves: NDArray[np.floating],
    arterial: InputFunction,
    observation: FrameObservation,
    weights: Array,
    settings: NonlinearSettings,
) -> FitResult:
    """Weighted non-linear least squares of frame values, sum_k w_k (y_k - model_k)^2, for every curve.

    Args:
        curves: (N, K), kBq/mL; non-finite curves are not fitted and say so in their status.
        arterial: input function with its delay.
        observation: what frames report.
        weights: (K,) shared by all curves, or (N, K); relative inverse variances >= 0.
        settings: model and bounds.

    Returns:
        Estimates of the rate constants, vB and macro-parameters with percent standard errors (Gauss-Newton covariance
        scaled by WRSS / (n - p); parameters on a bound count as known), chi-square, AICc and status of every curve.

    Raises:
        InputError: weights or frames do not match the curves, or there are too few frames.
    """
    curves = np.asarray(curves)
    weights = np.asarray(weights, np.float64)
    _check(curves, weights, observation, settings)
    rates = _table_rates(settings)
    table = build_table(arterial, observation, rate_bounds=rates, nodes=settings.effort.nodes)
    tolerance = 0.0 if settings.effort.size is None else 1e-9
    if weights.ndim == 1:
        return _fit_shared(
            curves, compress(table, weights, tolerance=tolerance, size=settings.effort.size), weights, settings
        )
    if len(curves) == 0:
        packed = compress(table, np.ones(curves.shape[1]), tolerance=tolerance, size=settings.effort.size)
        return replace(_fit_shared(curves, packed, np.ones(curves.shape[1]), settings), weights=weights)
    distinct, which = np.unique(weights, axis=0, return_inverse=True)
    parts = [
        (np.flatnonzero(which == g), compress(table, w, tolerance=tolerance, size=settings.effort.size))
        for g, w in enumerate(distinct)
    ]
    results = [(rows, _fit_shared(curves[rows], packed, weights[rows[0]], settings)) for rows, packed in parts]
    return replace(_merge(results, len(curves)), weights=weights)


def _check(
    curves: NDArray[np.floating], weights: Array, observation: FrameObservation, settings: NonlinearSettings
) -> None:
    frames = len(observation.frames)
    if curves.ndim != 2 or curves.shape[1] != frames:
        raise InputError(f"Curves of shape {curves.shape} do not match {frames} frames; give one row a curve.")
    if weights.shape not in ((frames,), curves.shape):
        raise InputError(
            f"Weights of shape {weights.shape} match neither the {frames} frames nor the curves {curves.shape}."
        )
    if not np.isfinite(weights).all() or (weights < 0).any():
        raise InputError("Frame weights must be finite and not negative.")
    free = len(settings.box.free)
    counted = int((np.atleast_2d(weights) > 0).sum(axis=1).min(initial=frames))
    if counted <= free + 1:
        raise InputError(
            f"{settings.model.label} has {free} free parameters but only {counted} frames have weight; "
            "use more frames or a simpler model."
        )


def _table_rates(settings: NonlinearSettings) -> tuple[float, float]:
    """Rates that any fit inside the box can reach; a trapping model needs the node a = 0."""
    box, (slow, fast) = settings.box, settings.rate_bounds
    if settings.model.trapping:
        slow = 0.0
    if _box_is_free(settings):
        return slow, fast
    return 0.0, max(fast, float(np.sum(box.upper[1:-1])))


def _box_is_free(settings: NonlinearSettings) -> bool:
    """Whether the box holds every model with rates in their interval: then the exponentials need no second fit."""
    box, default = settings.box, settings.model.parameters
    wide = (box.lower <= default.lower).all() and (box.upper >= default.upper).all()
    return bool(wide) and settings.rate_bounds[1] <= FASTEST_RATE and not any(p.fixed for p in box)


def _fit_shared(
    curves: NDArray[np.floating], packed: Compression, weights: Array, settings: NonlinearSettings
) -> FitResult:
    finite = np.asarray((np.abs(curves) < _LARGEST).all(axis=1))
    usable = np.ascontiguousarray(np.where(finite[:, None], curves, 0.0), np.float64)
    z = project_rows(packed.project, usable)
    sizes = np.einsum("nk,k,nk->n", usable, weights, usable)
    signal = finite & ((packed.basis.sum(axis=0)[:, None] * z).sum(axis=0) > 0)
    theta, cost, converged = _estimate(z, sizes, signal, packed, settings)
    theta[~signal] = np.nan
    return _summarise(theta, cost, converged, finite, signal, packed, weights, settings)


def _estimate(
    z: Array, sizes: Array, signal: NDArray[np.bool_], packed: Compression, settings: NonlinearSettings
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Parameters, costs and convergence: the free optimum, and a bounded fit for curves whose optimum leaves the box."""
    model, box = settings.model, settings.box
    vB = box["vB"]
    found = search_exponentials(
        model, packed, z, sizes, settings.effort, blood=vB.upper > 0 and not (vB.fixed and vB.start == 0)
    )
    with np.errstate(all="ignore"):
        rates = model.invert(*[(found.phi[:, m], found.rate[:, m]) for m in range(found.phi.shape[1])])
    theta = np.column_stack([*rates, found.vB])
    theta[(found.phi == 0.0).all(axis=1), :-1] = [0.0, *box.start[1:-1]]  # blood alone: without K1 any rates will do
    cost, converged = found.cost.copy(), found.converged.copy()
    slack = ON_BOUND * (1.0 + np.abs(box.upper))
    leaves = signal & ~((theta >= box.lower - slack) & (theta <= box.upper + slack)).all(axis=1)
    theta = np.clip(theta, box.lower, box.upper)
    tolerance = max(1e-2 * settings.effort.tolerance, 1e-10)
    for rows in _chunks(np.flatnonzero(leaves)):
        theta[rows], cost[rows], converged[rows] = fit_in_box(
            model, packed, z[:, rows], sizes[rows], theta[rows], box, starts=settings.effort.starts, tolerance=tolerance
        )
    if settings.effort.refine:
        rows = np.flatnonzero(signal & ~leaves)
        finer = fit_in_box(model, packed, z[:, rows], sizes[rows], theta[rows], box, starts=0, tolerance=tolerance)
        kept = _inside_table(finer[0], packed, settings)
        for whole, part in zip((theta, cost, converged), finer):
            whole[rows[kept]] = part[kept]
    return theta, np.maximum(cost, np.finfo(np.float64).eps * sizes), converged


def _inside_table(theta: Array, packed: Compression, settings: NonlinearSettings) -> NDArray[np.bool_]:
    """Whether all rates lie in the table: the box alone lets one slip below the slowest, where nothing is tabulated."""
    rates = np.stack([rate for _, rate in settings.model.impulse(*theta[:, :-1].T)], axis=1)
    slowest, fastest = np.exp(packed.u[[0, -1]]) - RATE_OFFSET
    return ((rates >= slowest - 1e-12) & (rates <= fastest + 1e-9)).all(axis=1)


def _chunks(rows: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    return [rows[i : i + _CHUNK] for i in range(0, len(rows), _CHUNK)]


def _summarise(
    theta: Array,
    cost: Array,
    converged: NDArray[np.bool_],
    finite: NDArray[np.bool_],
    signal: NDArray[np.bool_],
    packed: Compression,
    weights: Array,
    settings: NonlinearSettings,
) -> FitResult:
    model, box = settings.model, settings.box
    frames = int(np.count_nonzero(weights > 0))
    free = len(box.free)
    chi2 = cost / (frames - free)
    names = [*[(p.symbol, p.unit) for p in model.parameters], *[(m.symbol, m.unit) for m in model.macros]]
    values = np.full((len(theta), len(names)), np.nan)
    errors = np.full_like(values, np.nan)
    on_bound = np.zeros(len(theta), bool)
    for rows in _chunks(np.flatnonzero(np.isfinite(theta).all(axis=1))):
        values[rows], errors[rows], on_bound[rows] = _with_errors(theta[rows], chi2[rows], packed, settings)
    with np.errstate(all="ignore"):
        percent = np.where(np.isfinite(values), 100.0 * errors / np.abs(values), np.nan)
    outcome = len(model.parameters)  # the first macro-parameter
    status = np.full(len(theta), Status.OK, np.uint8)
    status[on_bound] = Status.AT_BOUND
    status[~(percent[:, outcome] <= 100.0)] = Status.NOT_IDENTIFIABLE
    status[~converged] = Status.NOT_CONVERGED
    status[~np.isfinite(theta).all(axis=1)] = Status.NO_SIGNAL
    status[~signal] = Status.NO_SIGNAL
    status[~finite] = Status.NOT_FINITE
    missing = status == Status.NO_SIGNAL
    missing |= status == Status.NOT_FINITE
    values[missing], percent[missing] = np.nan, np.nan
    p = free + 1
    with np.errstate(all="ignore"):
        aicc = (
            frames * np.log(cost / frames) + 2 * p + (2 * p * (p + 1) / (frames - p - 1) if frames > p + 1 else np.nan)
        )
    predicted = _predict(theta, packed, weights, settings) if settings.keep_predicted else None
    return FitResult(
        model=model.label,
        estimates=tuple(Estimate(s, u, values[:, i], percent[:, i]) for i, (s, u) in enumerate(names)),
        chi2=np.where(missing, np.nan, chi2),
        aicc=np.where(missing, np.nan, aicc),
        status=status,
        weights=weights,
        predicted=predicted,
        settings={
            "bounds": {p.symbol: [p.lower, p.upper] for p in box if not p.fixed},
            "fixed": {p.symbol: p.start for p in box if p.fixed},
            "rate_bounds": list(settings.rate_bounds),
        },
    )


def _with_errors(
    theta: Array, chi2: Array, packed: Compression, settings: NonlinearSettings
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Parameters and macros, their standard errors, and whether a free parameter sits on a bound."""
    model, box = settings.model, settings.box
    fixed = np.array([p.fixed for p in box])
    slack = ON_BOUND * np.where(np.isfinite(box.upper), np.maximum(box.upper - box.lower, 1e-3), 1.0)
    touching = ((theta <= box.lower + slack) | (theta >= box.upper - slack)) & ~fixed
    with np.errstate(all="ignore"):
        slowest = min(settings.rate_bounds) if not model.trapping else 0.0
        on_bound = np.asarray(touching.any(axis=1))
        for phi, rate in model.impulse(*theta[:, :-1].T):
            on_bound |= (phi > 0) & (rate <= slowest * (1 + 1e-6)) & (slowest > 0)
            on_bound |= (phi > 0) & (rate >= settings.rate_bounds[1] * (1 - 1e-9))
        covariance = covariances(model, packed, theta, touching | fixed)
        macros, chain = derivatives(lambda *k: tuple(m.formula(*k) for m in model.macros), theta[:, :-1])
    # A rate that is no longer defined (k4 where k3 = 0) must not spoil macros that do not depend on it.
    chain = np.where(np.isfinite(chain), chain, 0.0)
    variance = ((chain @ covariance[:, :-1, :-1]) * chain).sum(axis=-1)
    own = np.einsum("npp->np", covariance)
    errors = np.sqrt(np.maximum(np.hstack([own, variance]) * chi2[:, None], 0.0))
    # What the curve does not feel at all has no variance there, which is to say an infinite one.
    unfelt = (own == 0.0) & ~touching & ~fixed
    spoilt = ((chain != 0.0) & unfelt[:, None, :-1]).any(axis=-1)
    errors[np.hstack([unfelt, spoilt])] = np.inf
    errors[:, : len(box)][touching] = np.nan
    return np.hstack([theta, macros]), errors, on_bound


def _predict(theta: Array, packed: Compression, weights: Array, settings: NonlinearSettings) -> Array:
    """Fitted frame values (N, K): back from compressed coordinates; frames without weight cannot be told and are NaN."""
    curves = model_values(settings.model, packed, np.where(np.isfinite(theta), theta, 0.0))
    with np.errstate(all="ignore"):
        back = np.where(packed.root_weights > 0, packed.project / packed.root_weights**2, np.nan)
    fitted = project_rows(np.ascontiguousarray(back.T), curves).T
    return np.where(np.isfinite(theta).all(axis=1, keepdims=True), fitted, np.nan)


def _merge(parts: list[tuple[NDArray[np.intp], FitResult]], count: int) -> FitResult:
    first = parts[0][1]

    def scatter(pick) -> NDArray:
        sample = pick(first)
        whole = np.full((count, *sample.shape[1:]), np.nan if sample.dtype.kind == "f" else 0, sample.dtype)
        for rows, result in parts:
            whole[rows] = pick(result)
        return whole

    estimates = tuple(
        Estimate(
            e.symbol,
            e.unit,
            scatter(lambda r, i=i: r.estimates[i].value),
            scatter(lambda r, i=i: r.estimates[i].percent_se),
        )
        for i, e in enumerate(first.estimates)
    )
    predicted = scatter(lambda r: r.predicted) if first.predicted is not None else None
    return replace(
        first,
        estimates=estimates,
        chi2=scatter(lambda r: r.chi2),
        aicc=scatter(lambda r: r.aicc),
        status=scatter(lambda r: r.status),
        predicted=predicted,
    )
