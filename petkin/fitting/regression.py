"""A method that is a linear regression of every curve: from its equation to estimates, errors, status, fitted curves.

design = LinearDesign(shared, own, response, *weights_and_noise(weights, label), offset, scale)
result = fit_linear(curves, design, Regression(label, quantities, read), settings={...}, keep_predicted=True)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting.curves import check_shapes
from petkin.fitting.linear import LinearDesign, LinearSolutions, LinearSolver
from petkin.fitting.parts import PART, in_parts
from petkin.fitting.results import Estimate, FitResult
from petkin.fitting.shared_columns import Answer
from petkin.fitting.summary import akaike
from petkin.fitting.verdict import conclude, delta_variances

Array = NDArray[np.float64]

#: Curves whose intermediate results stay in the cache together.
_BLOCK = 4096


@dataclass(frozen=True)
class Quantity:
    """What a regression tells: symbol, unit, what it is in words."""

    symbol: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Regression:
    """What the unknowns mean.

    Args:
        label: of the method.
        quantities: M of them.
        read: unknowns (p, n) to values (M, n) and their derivatives (M, p, n); None where quantities are the first
            unknowns themselves.
        outcome: which quantity the method is used for.
    """

    label: str
    quantities: tuple[Quantity, ...]
    read: Callable[[Array], tuple[Array, Array]] | None = None
    outcome: int = 0


def fit_linear(
    curves: NDArray[np.floating],
    design: LinearDesign,
    regression: Regression,
    *,
    settings: dict[str, Any],
    keep_predicted: bool,
) -> FitResult:
    """Every curve's regression.

    Args:
        curves: (N, K), kBq/mL, float32 or float64; memory with frames first is read without a copy.
        design: the equation; its weights are those of the equation's frames, zero where one is left out.
        regression: what the unknowns mean.
        settings: what was chosen, for sidecars; `frames_used` is added.
        keep_predicted: return fitted curves; NaN in frames that are left out.

    Returns:
        Estimates; percent errors by the delta method from the covariance of the unknowns, which counts noise wherever
        the curve enters the equation; chi-square (WRSS / (n - p)) and AICc of the regression; status.

    Raises:
        InputError: shapes do not match, frames are too few, or columns in common depend on each other.
    """
    curves = np.asarray(curves)
    check_shapes(curves, design.weights, len(design.offset))
    solver = LinearSolver.prepare(design, regression.label)
    frames = _frames_first(curves)
    alike = solver.in_common and regression.read is None
    kind = frames.dtype if alike else np.dtype(np.float64)
    answer = _Answer.of(len(regression.quantities), len(curves), len(design.used), design.unknowns, kind)

    def fit(part: slice) -> None:
        if alike:
            solver.regress(frames, part, regression.outcome, answer.all)
        else:
            for start in range(part.start, part.stop, _BLOCK):
                rows = slice(start, min(start + _BLOCK, part.stop))
                answer.fill(rows, solver.solve(frames, rows), regression)
        answer.compare(part)

    with np.errstate(all="ignore"):
        in_parts(fit, len(curves), 2 * PART if alike else PART)
        predicted = _predict(frames, design, solver, answer) if keep_predicted else None
    return FitResult(
        model=regression.label,
        estimates=tuple(
            Estimate(q.symbol, q.unit, value, percent_se, q.meaning)
            for q, value, percent_se in zip(regression.quantities, answer.values, answer.percent_se)
        ),
        chi2=answer.chi2,
        aicc=answer.aicc,
        status=answer.status,
        weights=design.weights,
        predicted=predicted,
        settings={**settings, "frames_used": len(design.used)},
    )


def weights_and_noise(weights: Array, label: str) -> tuple[Array, Array]:
    """One weight a frame (K,), and the variances that they stand for; a frame without weight counts as free of noise.

    Raises:
        InputError: every curve has its own weights.
    """
    weights = np.asarray(weights, np.float64)
    if weights.ndim != 1:
        raise InputError(f"{label} takes one weight a frame, shared by all curves; give one row of weights.")
    return weights, np.divide(1.0, weights, out=np.zeros_like(weights), where=weights > 0)


def _frames_first(curves: NDArray[np.floating]) -> NDArray[np.floating]:
    """Curves (K, N), a frame's values side by side, in a type that the compiled pass reads."""
    native = curves.dtype in (np.float32, np.float64) and curves.dtype.isnative
    return np.ascontiguousarray(curves.T, None if native else np.float64)


@dataclass(frozen=True)
class _Answer:
    """Arrays that are filled block by block."""

    values: NDArray[np.floating]
    percent_se: NDArray[np.floating]
    chi2: NDArray[np.floating]
    aicc: NDArray[np.floating]
    status: NDArray[np.uint8]
    used: int
    unknowns: int

    @classmethod
    def of(cls, quantities: int, curves: int, used: int, unknowns: int, kind: np.dtype) -> _Answer:
        values, percent_se = np.empty((2, quantities, curves), kind)
        chi2, aicc = np.empty((2, curves), kind)
        return cls(values, percent_se, chi2, aicc, np.empty(curves, np.uint8), used, unknowns)

    @property
    def all(self) -> Answer:
        """Room for the answers of all curves."""
        return self.values, self.percent_se, self.chi2, self.status

    def fill(self, rows: slice, solved: LinearSolutions, regression: Regression) -> None:
        """Estimates, errors and status of some curves; what must not be used is NaN."""
        values, deviations = _read(solved, regression)
        found = values, deviations, solved.wrss, solved.freedom, solved.total, solved.finite
        degrees = float(self.used - self.unknowns)
        conclude(found, regression.outcome, degrees, self.all, rows.start, rows.stop)

    def compare(self, rows: slice) -> None:
        """AICc of some curves."""
        freedom, p = self.used - self.unknowns, self.unknowns + 1
        into = self.aicc[rows]
        akaike(np.multiply(self.chi2[rows], freedom, out=into), self.used, p, into)


def _read(solved: LinearSolutions, regression: Regression) -> tuple[Array, Array]:
    """Values (M, n) of the quantities and their standard deviations (M, n) at unit noise."""
    if regression.read is None:
        return solved.theta, np.sqrt(np.stack([solved.covariance[i, i] for i in range(len(solved.theta))]))
    values, slopes = regression.read(solved.theta)
    variances = np.empty_like(values)
    delta_variances(slopes, np.ascontiguousarray(solved.covariance), variances)
    return values, np.sqrt(variances)


def _predict(frames: NDArray[np.floating], design: LinearDesign, solver: LinearSolver, answer: _Answer) -> Array:
    """Fitted frame values (N, K): the equation solved for the curve itself, where it stands outside all integrals."""
    curves = np.asarray(frames, np.float64).T
    tissue = (curves - design.offset) * design.scale
    theta = solver.solve(frames, slice(0, len(curves))).theta
    left = tissue @ design.response.T - theta[: len(design.shared)].T @ design.shared
    share = np.full(len(curves), 1.0 if _is_curve(design.response) else 0.0)
    for operator, unknown in zip(design.own, theta[len(design.shared) :]):
        left -= unknown[:, None] * (tissue @ operator.T)
        share -= unknown if _is_curve(operator) else 0.0
    fitted = (tissue - left / share[:, None]) / design.scale + design.offset
    kept = (design.weights > 0) & np.isfinite(answer.chi2)[:, None]
    return np.where(kept, fitted, np.nan)


def _is_curve(operator: Array) -> bool:
    return bool((operator == np.eye(len(operator))).all())
