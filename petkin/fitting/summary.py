"""From best parameters to a `FitResult`: macro-parameters, errors, chi-square, AICc, and a status that says why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import ParameterSet
from petkin.fitting.bounded import ON_BOUND
from petkin.fitting.covariance import dense_variances, impulse_partials, variances
from petkin.fitting.dual import partials
from petkin.fitting.parts import in_parts
from petkin.fitting.results import Column, Estimate, FitResult, Status
from petkin.fitting.table import Compression
from petkin.kinetics import CompartmentModel

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_REACHED = "bounds that the fit ended on: their parameters have no standard error and count as known for the others"


@dataclass(frozen=True)
class Optimum:
    """Where the fits of N curves ended.

    Args:
        theta: parameters (P, N), NaN where there are none.
        cost: weighted sums of squared residuals (N,).
        converged: whether the tolerance was met (N,).
        finite: whether the curve was finite (N,).
        signal: whether it held anything above zero (N,).
    """

    theta: Array
    cost: Array
    converged: Flags
    finite: Flags
    signal: Flags

    @classmethod
    def of(cls, parameters: int, count: int) -> Optimum:
        """To be filled."""
        flags = [np.zeros(count, np.bool_) for _ in range(3)]
        return cls(np.full((parameters, count), np.nan), np.full(count, np.nan), *flags)


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
        """The result."""
        model, box = self.model, self.box
        frames, free = int(np.count_nonzero(self.weights > 0)), len(box.free)
        names = [(q.symbol, q.unit, q.meaning) for q in model.quantities]
        values, percent = (np.empty((len(names), len(best.cost))) for _ in range(2))
        reached = np.zeros(len(best.cost), np.int16)
        chi2 = best.cost / (frames - free)

        def look_at(rows: slice) -> None:
            values[:, rows], percent[:, rows], reached[rows] = self._look_at(best.theta[:, rows], chi2[rows])

        in_parts(look_at, len(chi2))
        status = self._status(best, percent, reached > 0)
        missing = (status == Status.NO_SIGNAL) | (status == Status.NOT_FINITE)
        values[:, missing], percent[:, missing], reached[missing] = np.nan, np.nan, 0
        return FitResult(
            model=model.label,
            estimates=tuple(Estimate(s, u, values[i], percent[i], m) for i, (s, u, m) in enumerate(names)),
            chi2=np.where(missing, np.nan, chi2),
            aicc=np.where(missing, np.nan, _aicc(best.cost, frames, free + 1)),
            status=status,
            weights=self.weights,
            predicted=predicted,
            settings={
                "bounds": {p.symbol: [p.lower, p.upper] for p in box if not p.fixed},
                "fixed": {p.symbol: p.start for p in box if p.fixed},
                "rate_bounds": list(self.rate_bounds),
            },
            columns=(Column("bound", reached, _REACHED, levels=self._limits(), bits=True),),
        )

    def _limits(self) -> dict[int, str]:
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

    def _look_at(self, theta: Array, chi2: Array) -> tuple[Array, Array, NDArray[np.int16]]:
        """Parameters and macro-parameters, their percent errors, and the bounds reached, a bit each."""
        model, rates = self.model, list(theta[: self.model.rates])
        low, high = self._touching(theta)
        with np.errstate(all="ignore"):
            exponentials, chain = impulse_partials(model, rates)
            reached = self._reached(low, high, exponentials)
            macros, macro_chain = partials(lambda *k: tuple(m.formula(*k) for m in model.macros), rates)
            values = np.concatenate([theta, macros])
            if not self.errors:
                return values, np.full_like(values, np.nan), reached
            errors = self._errors(theta, chi2, low | high, exponentials, chain, macro_chain)
            percent = 100.0 * errors / np.abs(values)
        percent[~np.isfinite(values)] = np.nan
        return values, percent, reached

    def _touching(self, theta: Array) -> tuple[Flags, Flags]:
        """Free parameters on their lower, and on their upper bound (P, N)."""
        lower, upper = self.box.lower, self.box.upper
        slack = ON_BOUND * np.where(np.isfinite(upper), np.maximum(upper - lower, 1e-3), 1.0)
        free = ~np.array([p.fixed for p in self.box])[:, None]
        return free & (theta <= (lower + slack)[:, None]), free & (theta >= (upper - slack)[:, None])

    def _reached(self, low: Flags, high: Flags, exponentials: Array) -> NDArray[np.int16]:
        """Two bits a parameter, lower and upper bound, then the slowest and the fastest rate of an exponential."""
        reached = np.zeros(low.shape[1], np.int16)
        for i in range(len(low)):
            reached |= low[i].astype(np.int16) << np.int16(2 * i)
            reached |= high[i].astype(np.int16) << np.int16(2 * i + 1)
        slowest, fastest = 0.0 if self.model.trapping else min(self.rate_bounds), self.rate_bounds[1]
        for phi, rate in zip(exponentials[::2], exponentials[1::2]):
            slow = (phi > 0) & (rate <= slowest * (1 + 1e-6)) & (slowest > 0)
            fast = (phi > 0) & (rate >= fastest * (1 - 1e-9))
            reached |= slow.astype(np.int16) << np.int16(2 * len(low))
            reached |= fast.astype(np.int16) << np.int16(2 * len(low) + 1)
        return reached

    def _errors(
        self, theta: Array, chi2: Array, touching: Flags, exponentials: Array, chain: Array, macro_chain: Array
    ) -> Array:
        """Standard errors (P + M, N); infinite for what the curve does not feel, NaN for parameters on a bound."""
        fixed = np.array([p.fixed for p in self.box])[:, None]
        # A rate that is no longer defined (k4 where k3 = 0) must not spoil macros that do not depend on it.
        macro_chain[~np.isfinite(macro_chain)] = 0.0
        held = touching | fixed
        if self.model.wall:
            variance = dense_variances(self.model, self.packed, theta, held, macro_chain)
        else:
            variance = variances(self.packed.products, theta, exponentials, chain, held, macro_chain)
        errors = np.sqrt(np.maximum(variance * chi2, 0.0))
        unfelt = (variance[: len(theta)] == 0.0) & ~held
        if unfelt.any():
            spoilt = ((macro_chain != 0.0) & unfelt[None, : self.model.rates]).any(axis=1)
            errors[np.concatenate([unfelt, spoilt])] = np.inf
        errors[: len(theta)][touching] = np.nan
        return errors


def _aicc(cost: Array, frames: int, p: int) -> Array:
    """n ln(WRSS / n) + 2 p + 2 p (p + 1) / (n - p - 1), p counting the variance; NaN where there are too few frames."""
    with np.errstate(all="ignore"):
        small_sample = 2 * p * (p + 1) / (frames - p - 1) if frames > p + 1 else np.nan
        return frames * np.log(cost / frames) + 2 * p + small_sample
