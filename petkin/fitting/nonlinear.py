"""Compartment models fitted to curves, voxels and regions alike: weighted least squares of frame values."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import ParameterSet
from petkin.errors import InputError
from petkin.fitting.bounded import fit_in_box
from petkin.fitting.curves import check_shapes
from petkin.fitting.device_tables import CHUNK, DeviceTables
from petkin.fitting.inversion import fill_parameters
from petkin.fitting.kernel import Tables
from petkin.fitting.one_rate import OneRateTables, search_in_frames
from petkin.fitting.parts import PART, in_parts
from petkin.fitting.projection import project_curves
from petkin.fitting.results import Estimate, FitResult
from petkin.fitting.search import REGIONS, Effort, exponentials, search_among, search_tables
from petkin.fitting.sensitivity import model_values
from petkin.fitting.summary import Judge, Optimum
from petkin.fitting.table import BasisTable, Compression, build_table, compress, project_rows
from petkin.fitting.wall import WallTables, search_beside_wall, wall_tables
from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction
from petkin.kinetics import CompartmentModel
from petkin.levenberg_marquardt import ON_BOUND

Array = NDArray[np.float64]

SearchTables = Tables | OneRateTables | DeviceTables | WallTables

#: Slowest rate that a fit may use, 1/min: a half-life of 11.5 h, beyond what any scan can tell from none.
SLOWEST_RATE = 1e-3
#: Fastest rate, 1/min: a half-life of 8 s.
FASTEST_RATE = 5.0
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
        standard_errors: work out standard errors; without them no curve is called not identifiable.
        device: where torch searches for the free optimum, e.g. "cuda"; None for compiled code on the CPU. Models with a
            wall are always searched there.
    """

    model: CompartmentModel
    parameters: ParameterSet | None = None
    rate_bounds: tuple[float, float] = (SLOWEST_RATE, FASTEST_RATE)
    effort: Effort = REGIONS
    keep_predicted: bool = True
    standard_errors: bool = True
    device: str | None = None

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
    table = tabulate(arterial, observation, settings)
    if weights.ndim == 1 or len(curves) == 0:
        shared = weights if weights.ndim == 1 else np.ones(curves.shape[1])
        result = _fit_shared(curves, squeeze(table, shared, settings), shared, settings)
        return replace(result, weights=weights)
    parts = [(rows, squeeze(table, own, settings)) for rows, own in alike(weights, len(curves))]
    results = [(rows, _fit_shared(curves[rows], packed, weights[rows[0]], settings)) for rows, packed in parts]
    return replace(_merge(results, len(curves)), weights=weights)


def tabulate(arterial: InputFunction, observation: FrameObservation, settings: NonlinearSettings) -> BasisTable:
    """The basis table over all rates that a fit with these settings can reach."""
    return build_table(arterial, observation, rate_bounds=_table_rates(settings), nodes=settings.effort.nodes)


def squeeze(table: BasisTable, weights: Array, settings: NonlinearSettings) -> Compression:
    """The table compressed as a fit with these settings sees it; weights (K,)."""
    tolerance = 0.0 if settings.effort.size is None else 1e-9
    return compress(table, weights, tolerance=tolerance, size=settings.effort.size)


def alike(weights: Array, count: int) -> list[tuple[NDArray[np.intp], Array]]:
    """Curves that share their frame weights, and those weights (K,)."""
    if weights.ndim == 1:
        return [(np.arange(count), weights)]
    distinct, which = np.unique(weights, axis=0, return_inverse=True)
    return [(np.flatnonzero(which == g), own) for g, own in enumerate(distinct)]


def _check(
    curves: NDArray[np.floating], weights: Array, observation: FrameObservation, settings: NonlinearSettings
) -> None:
    frames = len(observation.frames)
    check_shapes(curves, weights, frames)
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
    if settings.model.trapping or settings.model.wall:
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
    """Curves that share their weights: the free optimum of all, bounded fits of those that leave the box, a summary."""
    frames = _readable(curves).T
    best = Optimum.of(len(settings.model.parameters), len(settings.model.macros), len(curves))
    tables = _tables(packed, settings)

    def fit(rows: slice) -> NDArray[np.bool_]:
        return _free_optimum(packed, weights, frames, rows, best, tables, settings)

    part = CHUNK if isinstance(tables, DeviceTables) else PART
    outside = np.concatenate([np.empty(0, np.bool_), *in_parts(fit, len(curves), part)])
    _fit_again(packed, weights, frames, outside, best, settings)
    best.theta[:, ~best.signal] = np.nan
    judge = Judge(settings.model, settings.box, settings.rate_bounds, packed, weights, settings.standard_errors)
    predicted = _predict(best.theta.T, packed, weights, settings) if settings.keep_predicted else None
    return judge.summarise(best, predicted)


def _readable(curves: NDArray[np.floating]) -> NDArray[np.floating]:
    """Curves in a type and an order that the compiled pass reads without a copy, converted where they are not."""
    native = curves.dtype in (np.float32, np.float64) and curves.dtype.isnative
    curves = curves if native else curves.astype(np.float64)
    return curves if curves.flags.c_contiguous or curves.flags.f_contiguous else np.ascontiguousarray(curves)


def takes_blood(box: ParameterSet) -> bool:
    """Whether blood may take part in a fit."""
    vB = box["vB"]
    return vB.upper > 0 and not (vB.fixed and vB.start == 0)


def _tables(packed: Compression, settings: NonlinearSettings) -> SearchTables:
    vB = settings.box["vB"]
    if settings.model.wall:
        return wall_tables(packed, settings.rate_bounds[0], blood=takes_blood(settings.box))
    # A blood volume that is fixed is taken off beforehand.
    blood = vB.upper > 0 and not vB.fixed
    return search_tables(
        settings.model, packed, settings.effort, blood=blood, rates=settings.rate_bounds, device=settings.device
    )


def _without_blood(z: Array, sizes: Array, blood: float) -> tuple[Array, Array]:
    """Curves and their sums of squares without the blood that is known, which lies along the first axis."""
    if blood == 0.0:
        return z, sizes
    off = z.copy()
    off[0] -= blood
    return off, sizes - blood * (z[0] + off[0])


def _free_optimum(
    packed: Compression,
    weights: Array,
    frames: NDArray[np.floating],
    rows: slice,
    best: Optimum,
    tables: SearchTables,
    settings: NonlinearSettings,
) -> NDArray[np.bool_]:
    """Fill in the free optimum of some curves; which of them lies outside the box."""
    model, box, vB = settings.model, settings.box, settings.box["vB"]
    held = vB.start if vB.fixed and not isinstance(tables, WallTables) else 0.0
    if isinstance(tables, OneRateTables):
        off = held * packed.blood
        numbers, sizes, *seen = search_in_frames(tables, packed, weights, frames, rows, off=off)
        found = exponentials(model, numbers)
    else:
        z, sizes, *seen = project_curves(packed, weights, frames, rows.start, rows.stop)
        if isinstance(tables, WallTables):
            found = search_beside_wall(model, tables, z, sizes, settings.effort)
        else:
            found = search_among(model, tables, *_without_blood(z, sizes, held * packed.blood), settings.effort)
    best.finite[rows], best.signal[rows] = seen
    if vB.fixed and not isinstance(tables, WallTables):
        found = replace(found, phi=found.phi / (1.0 - held), vB=np.full_like(found.vB, held))
    inside = fill_parameters(model, found, box, ON_BOUND, best.theta[:, rows])
    best.cost[rows] = np.maximum(found.cost, np.finfo(np.float64).eps * sizes)
    best.converged[rows] = found.converged
    # Where the best amplitude of a wall is negative, another optimum with a positive one may lie elsewhere.
    doubtful = False if found.Kb is None else found.Kb == 0.0
    return best.signal[rows] & (~inside | doubtful)


def _fit_again(
    packed: Compression,
    weights: Array,
    frames: NDArray[np.floating],
    outside: NDArray[np.bool_],
    best: Optimum,
    settings: NonlinearSettings,
) -> None:
    """Bounded fits where the free optimum left the box; elsewhere, if asked for, a finish on explicit residuals."""
    inside = best.signal & ~outside & settings.effort.refine
    tolerance = max(1e-2 * settings.effort.tolerance, 1e-10)
    for chosen, starts in ((outside, settings.effort.starts), (inside, 0)):
        for here in _chunks(np.flatnonzero(chosen)):
            z, sizes, *_ = project_curves(packed, weights, np.ascontiguousarray(frames[:, here]), 0, len(here))
            theta, cost, converged = fit_in_box(
                settings.model,
                packed,
                z,
                sizes,
                best.theta[:, here].T,
                settings.box,
                settings.rate_bounds,
                starts=starts,
                tolerance=tolerance,
                explicit=settings.effort.refine,
            )
            best.theta[:, here], best.converged[here] = theta.T, converged
            best.cost[here] = np.maximum(cost, np.finfo(np.float64).eps * sizes)


def _chunks(rows: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    return [rows[i : i + _CHUNK] for i in range(0, len(rows), _CHUNK)]


def _predict(theta: Array, packed: Compression, weights: Array, settings: NonlinearSettings) -> Array:
    """Fitted frame values (N, K), back from compressed coordinates; NaN in frames without weight."""
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
            e.meaning,
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
        columns=tuple(
            replace(c, values=scatter(lambda r, i=i: r.columns[i].values)) for i, c in enumerate(first.columns)
        ),
    )
