"""Methods whose curve is a column that all curves share and one exponential: from curves to a result.

    curve = x0 axis + x1 B(a)   or   curve = x1 B(a),   a within its interval, x0 and x1 of either sign.

What the three numbers mean is the method's; see `one_rate` for the search and `one_rate_errors` for the errors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting.curves import check_shapes
from petkin.fitting.dual import partials
from petkin.fitting.lanes import MAX_STEPS
from petkin.fitting.one_rate import COST, STEPS, U1, X0, X1, one_rate_tables, search_in_frames
from petkin.fitting.one_rate_errors import ENTRIES, one_rate_covariances
from petkin.fitting.parts import in_parts
from petkin.fitting.results import Column, Estimate, FitResult, Status
from petkin.fitting.scan import SIGNED, SINGLE
from petkin.fitting.search import Effort
from petkin.fitting.sensitivity import read_basis
from petkin.fitting.summary import akaike
from petkin.fitting.table import RATE_OFFSET, Compression, project_rows

Array = NDArray[np.float64]

#: A rate this close to an end of the table, in u, sits on it.
_AT_END = 1e-9
_REACHED = "bounds that the fit ended on: the rate has no standard error and counts as known for the others"


@dataclass(frozen=True)
class OneRateModel:
    """What the numbers of a curve mean.

    Args:
        label: of the method.
        quantities: symbol, unit and meaning of what is reported; the last is what the method is used for.
        read: (x0, x1, a) to the quantities, in plain arithmetic.
        positive: how many of the quantities, from the first, are not physical unless positive.
        axis: whether the shared column has an amplitude of its own.
    """

    label: str
    quantities: tuple[tuple[str, str, str], ...]
    read: Callable[..., tuple[Any, ...]]
    positive: int
    axis: bool = True

    @property
    def free(self) -> int:
        """Numbers fitted to a curve."""
        return 3 if self.axis else 2


@dataclass(frozen=True)
class _Found:
    """Answers of N curves: values and variances of M quantities, u, x0, x1, cost, and flags."""

    values: Array
    percent_se: Array
    numbers: Array
    cost: Array
    status: NDArray[np.uint8]
    reached: NDArray[np.uint8]


def fit_one_rate(
    curves: NDArray[np.floating],
    packed: Compression,
    weights: Array,
    model: OneRateModel,
    effort: Effort,
    *,
    settings: dict[str, Any],
    keep_predicted: bool,
) -> FitResult:
    """Weighted least squares of frame values.

    Args:
        curves: (N, K), kBq/mL.
        packed: compressed table of B; its axis is the shared column.
        weights: (K,), those that the table was compressed with.
        model: what the numbers mean.
        effort: how hard to search.
        settings: what was chosen, for sidecars.
        keep_predicted: return fitted curves.
    """
    frames, count = frames_first(curves), len(curves)
    used = int(np.count_nonzero(weights))
    tables = one_rate_tables(packed, SIGNED if model.axis else SINGLE, axis=model.axis)
    found = _Found(
        np.empty((len(model.quantities), count)),
        np.empty((len(model.quantities), count)),
        np.empty((3, count)),
        np.empty(count),
        np.empty(count, np.uint8),
        np.zeros(count, np.uint8),
    )

    def fit(rows: slice) -> None:
        best, sizes, finite, signal = search_in_frames(tables, packed, weights, frames, rows)
        _look_at(found, rows, best, packed, model, used)
        found.cost[rows] = np.maximum(best[COST], np.finfo(np.float64).eps * sizes)
        status = found.status[rows]
        status[best[STEPS] >= MAX_STEPS] = Status.NOT_CONVERGED
        status[~signal] = Status.NO_SIGNAL
        status[~finite] = Status.NOT_FINITE

    with np.errstate(all="ignore"):
        in_parts(fit, count)
        chi2 = found.cost / (used - model.free)
        found.percent_se[:] *= 100.0 * np.sqrt(chi2) / np.abs(found.values)
        told = found.percent_se[-1] <= 100.0
        found.status[(found.status <= Status.AT_BOUND) & ~told] = Status.NOT_IDENTIFIABLE
        missing = (found.status == Status.NO_SIGNAL) | (found.status == Status.NOT_FINITE)
        blank = np.where(missing, np.nan, 1.0)
        found.reached[missing] = 0
    low, high = packed.rates[[0, -1]]
    limits = {1: f"slowest rate at {low:g} per min", 2: f"fastest rate at {high:g} per min"}
    return FitResult(
        model=model.label,
        estimates=tuple(
            Estimate(symbol, unit, value * blank, error * blank, meaning)
            for (symbol, unit, meaning), value, error in zip(model.quantities, found.values, found.percent_se)
        ),
        chi2=chi2 * blank,
        aicc=akaike(found.cost, used, model.free + 1) * blank,
        status=found.status,
        weights=weights,
        predicted=_predict(packed, found.numbers * blank) if keep_predicted else None,
        settings={**settings, "rate_bounds": [float(low), float(high)]},
        columns=(Column("bound", found.reached, _REACHED, levels=limits, bits=True),),
    )


def _look_at(found: _Found, rows: slice, best: Array, packed: Compression, model: OneRateModel, used: int) -> None:
    """Quantities of some curves, their standard errors at unit weight (still to be scaled), status and bounds."""
    u, x0, x1 = best[U1], best[X0], best[X1]
    low, high = u <= packed.u[0] + _AT_END, u >= packed.u[-1] - _AT_END
    held = (low | high) & (x1 != 0.0)
    values, slopes = partials(model.read, [x0, x1, np.exp(u) - RATE_OFFSET])
    covariance = one_rate_covariances(packed, u, x1, held, axis=model.axis)
    found.numbers[:, rows] = u, x0, x1
    found.values[:, rows] = values
    for q in range(len(values)):
        variance = np.zeros(len(u))
        for (i, j), entry in zip(ENTRIES, covariance):
            slope = slopes[q, i] * slopes[q, j]
            variance += (1.0 if i == j else 2.0) * np.where(slope == 0.0, 0.0, slope * entry)
        found.percent_se[q, rows] = np.sqrt(np.maximum(variance, 0.0))
    found.reached[rows] = (low & held) + 2 * (high & held)
    unphysical = ~(values[: model.positive] > 0).all(axis=0)
    status = np.where(held, Status.AT_BOUND, Status.OK)
    found.status[rows] = np.where(unphysical, Status.NOT_IDENTIFIABLE, status)


def frames_first(curves: NDArray[np.floating]) -> NDArray[np.floating]:
    """Curves (K, N) in a type and an order that the compiled pass reads, converted where they are not."""
    native = curves.dtype in (np.float32, np.float64) and curves.dtype.isnative
    curves = curves if native else curves.astype(np.float64)
    return (curves if curves.flags.c_contiguous or curves.flags.f_contiguous else np.ascontiguousarray(curves)).T


def require_shared(curves: NDArray[np.floating], weights: Array, frames: int, free: int, label: str) -> None:
    """Shapes that match, one weight a frame, and frames enough.

    Raises:
        InputError: they do not, or are not.
    """
    check_shapes(curves, weights, frames)
    if weights.ndim != 1:
        raise InputError(f"{label} takes one weight a frame, shared by all curves; give one row of weights.")
    used = int(np.count_nonzero(weights))
    if used <= free + 1:
        raise InputError(f"{label} fits {free} numbers but only {used} frames have weight; use more frames.")


def _predict(packed: Compression, numbers: Array) -> Array:
    """Fitted frame values (N, K), back from compressed coordinates; NaN in frames without weight."""
    u, x0, x1 = numbers
    coordinates = x1[:, None] * read_basis(packed, np.nan_to_num(np.exp(u) - RATE_OFFSET))[0]
    coordinates[:, 0] += x0 * packed.blood
    return frame_values(packed, coordinates)


def frame_values(packed: Compression, coordinates: Array) -> Array:
    """Frame values (N, K) of compressed curves (N, R); NaN in frames without weight."""
    with np.errstate(all="ignore"):
        back = np.where(packed.root_weights > 0, packed.project / packed.root_weights**2, np.nan)
    return project_rows(np.ascontiguousarray(back.T), coordinates).T
