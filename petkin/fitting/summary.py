"""From best parameters to a `FitResult`: macro-parameters, errors, chi-square, AICc, and a status that says why."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import ParameterSet
from petkin.fitting.covariance import Limits, model_errors
from petkin.fitting.dense import dense_errors
from petkin.fitting.parts import in_parts
from petkin.fitting.results import Column, Estimate, FitResult, Status
from petkin.fitting.table import Compression
from petkin.kinetics import CompartmentModel
from petkin.levenberg_marquardt import ON_BOUND

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_REACHED = "bounds that the fit ended on: their parameters have no standard error and count as known for the others"


@dataclass(frozen=True)
class Optimum:
    """Where the fits of N curves ended.

    Args:
        values: parameters, NaN where there are none, then room for macro-parameters (P + M, N).
        theta: the parameters among them (P, N).
        cost: weighted sums of squared residuals (N,).
        converged: whether the tolerance was met (N,).
        finite: whether the curve was finite (N,).
        signal: whether it held anything above zero (N,).
    """

    values: Array
    theta: Array
    cost: Array
    converged: Flags
    finite: Flags
    signal: Flags

    @classmethod
    def of(cls, parameters: int, macros: int, count: int) -> Optimum:
        """To be filled."""
        values = np.empty((parameters + macros, count))
        return cls(values, values[:parameters], np.empty(count), *(np.empty(count, np.bool_) for _ in range(3)))


@dataclass(frozen=True)
class Judge:
    """What a summary needs besides the optimum.

    Args:
        model: compartment model.
        box: bounds and fixed values.
        rate_bounds: interval of the exponentials' rates, 1/min.
        packed: compressed table.
        weights: frame weights (K,).
        errors: whether standard errors are wanted.
    """

    model: CompartmentModel
    box: ParameterSet
    rate_bounds: tuple[float, float]
    packed: Compression
    weights: Array
    errors: bool

    def summarise(self, best: Optimum, predicted: Array | None) -> FitResult:
        """The result; fills in the macro-parameters of `best`."""
        model, box = self.model, self.box
        frames, free = int(np.count_nonzero(self.weights > 0)), len(box.free)
        names = [(q.symbol, q.unit, q.meaning) for q in model.quantities]
        values, chi2 = best.values, best.cost / (frames - free)
        percent, reached = np.empty_like(values), np.empty(len(chi2), np.int16)

        def look_at(rows: slice) -> None:
            numbers = values[:, rows], percent[:, rows], chi2[rows]
            reached[rows] = fill_in(model, self.packed, self._limits, *numbers, wanted=self.errors)

        fill_in = dense_errors if model.wall else model_errors
        in_parts(look_at, len(chi2))
        status = self._status(best, percent, reached > 0)
        missing = (status == Status.NO_SIGNAL) | (status == Status.NOT_FINITE)
        aicc = akaike(best.cost, frames, free + 1)
        reached[missing] = 0
        for numbers in (values, percent, chi2, aicc):
            numbers[..., missing] = np.nan
        return FitResult(
            model=model.label,
            estimates=tuple(Estimate(s, u, values[i], percent[i], m) for i, (s, u, m) in enumerate(names)),
            chi2=chi2,
            aicc=aicc,
            status=status,
            weights=self.weights,
            predicted=predicted,
            settings={
                "bounds": {p.symbol: [p.lower, p.upper] for p in box if not p.fixed},
                "fixed": {p.symbol: p.start for p in box if p.fixed},
                "rate_bounds": list(self.rate_bounds),
            },
            columns=(Column("bound", reached, _REACHED, levels=self._words(), bits=True),),
        )

    def _words(self) -> dict[int, str]:
        """What every bit of the bounds reached stands for."""
        slowest, fastest = self.rate_bounds
        ends = [f"{p.symbol} at {end:g}" for p in self.box for end in (p.lower, p.upper)]
        ends += [f"slowest rate at {slowest:g} per min", f"fastest rate at {fastest:g} per min"]
        fixed = [p.fixed for p in self.box for _ in range(2)] + [self.model.trapping, False]
        return {1 << bit: text for bit, (text, held) in enumerate(zip(ends, fixed)) if not held}

    def _status(self, best: Optimum, percent: Array, on_bound: Flags) -> NDArray[np.uint8]:
        status = np.full(len(best.cost), Status.OK, np.uint8)
        status[on_bound] = Status.AT_BOUND
        if self.errors:
            outcome = len(self.model.parameters)  # the first macro-parameter
            status[~(percent[outcome] <= 100.0)] = Status.NOT_IDENTIFIABLE
        status[~best.converged] = Status.NOT_CONVERGED
        status[~(np.isfinite(best.theta).all(axis=0) & best.signal)] = Status.NO_SIGNAL
        status[~best.finite] = Status.NOT_FINITE
        return status

    @cached_property
    def _limits(self) -> Limits:
        lower, upper = self.box.lower, self.box.upper
        slack = ON_BOUND * np.where(np.isfinite(upper), np.maximum(upper - lower, 1e-3), 1.0)
        slowest = 0.0 if self.model.trapping else min(self.rate_bounds)
        return Limits(
            fixed=np.array([p.fixed for p in self.box]),
            lowest=lower + slack,
            highest=upper - slack,
            slowest=slowest * (1 + 1e-6) if slowest > 0 else -np.inf,
            fastest=self.rate_bounds[1] * (1 - 1e-9),
        )


def akaike(
    cost: NDArray[np.floating], frames: int, p: int, into: NDArray[np.floating] | None = None
) -> NDArray[np.floating]:
    """n ln(WRSS / n) + 2 p + 2 p (p + 1) / (n - p - 1), p counting the variance; NaN where there are too few frames.

    The answer goes into an array that is given, which may be that of the cost.
    """
    with np.errstate(all="ignore"):
        small_sample = 2 * p * (p + 1) / (frames - p - 1) if frames > p + 1 else np.nan
        answer = np.divide(cost, frames, out=into)
        np.log(answer, out=answer)
        answer *= frames
        answer += 2 * p + small_sample
        return answer
