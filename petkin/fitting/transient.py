"""A passing change of binding, as a released neurotransmitter makes it: when it began, and whether it was there.

    C_T = R1 C_R + k2 int C_R - k2a int C_T - gamma int C_T h,   frames of weight > 0
    h(t) = ((t - tD)/(tP - tD))^alpha exp(alpha (1 - (t - tD)/(tP - tD))),  t > tD;  0 before

For every (tD, tP, alpha) of a grid this is a linear regression; the best with gamma > 0 is taken. Whether it was there
is an F test against the same equation without the last term, its four unknowns counted in full. How sure the times are
is told by all points of the grid that fit nearly as well.

References: Normandin MD, Schiffer WK, Morris ED. NeuroImage 2012;59:2689-2699, doi:10.1016/j.neuroimage.2011.07.002;
Ichise M et al. J Cereb Blood Flow Metab 2003;23:1096-1112, doi:10.1097/01.WCB.0000085441.37552.CA.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.f_distribution import exceeded, quantile
from petkin.fitting.given import Given
from petkin.fitting.integrals import curve_integrals
from petkin.fitting.linear import LinearDesign, LinearSolutions, LinearSolver
from petkin.fitting.one_rate_fit import frames_first
from petkin.fitting.parts import in_parts
from petkin.fitting.regression import weights_and_noise
from petkin.fitting.results import Column, Estimate, FitResult, Status

Array = NDArray[np.float64]

_LABEL = "lpntPET"
#: Starts of the response, even between these shares of the scan; minutes from start to peak; sharpness.
_STARTS, _FIRST, _LAST = 20, 0.1, 0.85
_RISES = (2.5, 5.0, 10.0, 15.0, 20.0, 30.0)
_SHARPNESS = (0.25, 1.0, 4.0)
#: Unknowns without a response, and those that it adds.
_PLAIN, _ADDED = 3, 4
#: A response is there if chance would gain as much with a smaller probability than this.
_SURE = 0.05
#: Share of the distribution that one standard error of a time stands for.
_ONE_ERROR = 0.6827
#: Points a frame that the mean of h is taken over, and curves whose costs at all points of the grid are kept together.
_POINTS, _BLOCK = 24, 2048

_QUANTITIES = (
    ("gamma", "min^-1", "size of the response: the largest addition to k2a"),
    ("R1", "1", "delivery relative to the reference region, K1 / K1'"),
    ("k2", "min^-1", "rate of return from tissue to plasma"),
    ("k2a", "min^-1", "apparent rate of return without the response, k2 / (1 + BPND)"),
    ("BPND", "1", "binding potential before the response, k2 / k2a - 1"),
    ("tD", "min", "start of the response"),
    ("tP", "min", "peak of the response"),
    ("alpha", "1", "sharpness of the response"),
)


@dataclass(frozen=True)
class Responses:
    """Shapes that are tried.

    Args:
        times: tD, tP and alpha of every shape (3, M).
        shapes: frame means of h (M, K).
    """

    times: Array
    shapes: Array

    @property
    def step(self) -> float:
        """Between starts, min: times are not known better than half of it."""
        return float(np.diff(np.unique(self.times[0]))[0])

    @classmethod
    def over(cls, given: Given) -> Responses:
        """All shapes whose peak comes before the end of the scan."""
        frames = given.observation.frames
        end = float(frames.end[-1])
        starts = np.linspace(_FIRST * end, _LAST * end, _STARTS)
        grid = np.array([(s, s + r, a) for s in starts for r in _RISES for a in _SHARPNESS if s + r <= end]).T
        points = frames.start[:, None] + frames.duration[:, None] * (np.arange(_POINTS) + 0.5) / _POINTS
        return cls(grid, np.stack([response(points, *row).mean(axis=1) for row in grid.T]))


def response(t: Array, start: float, peak: float, sharpness: float) -> Array:
    """h(t), 1 at its peak."""
    x = np.maximum(t - start, 0.0) / (peak - start)
    return x**sharpness * np.exp(sharpness * (1.0 - x))


def fit_transient(curves: NDArray[np.floating], given: Given, *, keep_predicted: bool) -> FitResult:
    """The best response of every curve (N, K), what it rests on, and whether it was there.

    Raises:
        InputError: no reference region, weights that differ between curves, too few frames.
    """
    given.reference_input(_LABEL)
    reference = given.reference_curve(_LABEL)
    integral, _ = curve_integrals(given.observation)
    tried = Responses.over(given)
    weights, noise = weights_and_noise(given.weights, _LABEL)
    count = len(weights)
    shared = np.stack([reference.values, integral @ reference.values])
    plain = LinearDesign(shared, integral[None], np.eye(count), weights, noise, np.zeros(count))
    solvers = [
        LinearSolver.prepare(replace(plain, own=np.stack([integral, integral * shape])), _LABEL)
        for shape in tried.shapes
    ]
    without = LinearSolver.prepare(plain, _LABEL)
    frames, used = frames_first(np.asarray(curves)), len(plain.used)
    values, percent = (np.full((len(_QUANTITIES), len(curves)), np.nan) for _ in range(2))
    chi2, chance = (np.full(len(curves), np.nan) for _ in range(2))
    status = np.empty(len(curves), np.uint8)

    def fit(part: slice) -> None:
        for start in range(part.start, part.stop, _BLOCK):
            rows = slice(start, min(start + _BLOCK, part.stop))
            best = _Best.among(solvers, frames, rows)
            baseline = without.solve(frames, rows)
            freedom = used - _PLAIN - _ADDED
            with np.errstate(all="ignore"):
                values[:, rows], percent[:, rows] = best.quantities(tried, freedom)
                chi2[rows] = best.wrss / freedom
                gain = (baseline.wrss - best.wrss) / _ADDED / chi2[rows]
            chance[rows] = np.where(best.found, exceeded(gain, _ADDED, freedom), 1.0)
            status[rows] = _status(baseline, best, chance[rows], percent[0, rows])

    in_parts(fit, len(curves))
    missing = np.isin(status, (Status.NO_SIGNAL, Status.NOT_FINITE))
    for array in (values.T, percent.T, chi2, chance):
        array[missing] = np.nan
    return FitResult(
        model=_LABEL,
        estimates=tuple(Estimate(s, u, v, p, m) for (s, u, m), v, p in zip(_QUANTITIES, values, percent)),
        chi2=chi2,
        aicc=_aicc(chi2 * (used - _PLAIN - _ADDED), used),
        status=status,
        weights=weights,
        predicted=_predicted(frames, shared, integral, tried, values, plain.used) if keep_predicted else None,
        settings={"reference": reference.name, "shapes": len(tried.shapes), "frames_used": used},
        columns=(Column("p", chance, "probability of such a gain in fit without a response (F test, 4 unknowns)"),),
    )


@dataclass(frozen=True)
class _Best:
    """The best shape of every curve: its number, unknowns, their variances at unit noise, costs of all shapes."""

    which: NDArray[np.intp]
    theta: Array
    variance: Array
    wrss: Array
    costs: Array

    @classmethod
    def among(cls, solvers: list[LinearSolver], frames: NDArray[np.floating], rows: slice) -> _Best:
        n = rows.stop - rows.start
        which, wrss = np.full(n, -1), np.full(n, np.inf)
        theta, variance = np.full((4, n), np.nan), np.full((4, n), np.nan)
        costs = np.full((len(solvers), n), np.inf)
        for m, solver in enumerate(solvers):
            solved = solver.solve(frames, rows)
            allowed = np.isfinite(solved.theta).all(axis=0) & (solved.theta[3] < 0.0)
            costs[m, allowed] = solved.wrss[allowed]
            better = costs[m] < wrss
            which[better], wrss[better] = m, costs[m, better]
            theta[:, better] = solved.theta[:, better]
            variance[:, better] = np.einsum("iin->in", solved.covariance)[:, better]
        return cls(which, theta, variance, wrss, costs)

    @property
    def found(self) -> NDArray[np.bool_]:
        return self.which >= 0

    def quantities(self, tried: Responses, freedom: int) -> tuple[Array, Array]:
        """Values and percent standard errors (Q, n); linear ones as if the times were known."""
        R1, k2, minus_k2a, minus_gamma = self.theta
        errors = np.sqrt(self.variance * (self.wrss / freedom))
        times = np.where(self.found, tried.times[:, self.which], np.nan)
        binding = -k2 / minus_k2a - 1.0
        spread = np.hypot(errors[1] / k2, errors[2] / minus_k2a) * (binding + 1.0)
        near = self.costs <= self.wrss * (1.0 + quantile(_ONE_ERROR, 1, freedom) / freedom)
        ranges = [0.5 * (_largest(near, row) + _largest(near, -row)) for row in tried.times]
        ranges[:2] = [np.maximum(one, 0.5 * tried.step) for one in ranges[:2]]
        values = np.stack([-minus_gamma, R1, k2, -minus_k2a, binding, *times])
        return values, 100.0 * np.abs(np.stack([errors[3], errors[0], errors[1], errors[2], spread, *ranges]) / values)


def _largest(near: NDArray[np.bool_], row: Array) -> Array:
    return np.where(near, row[:, None], -np.inf).max(axis=0)


def _status(baseline: LinearSolutions, best: _Best, chance: Array, percent: Array) -> NDArray[np.uint8]:
    status = np.full(len(chance), Status.OK, np.uint8)
    status[~((chance < _SURE) & (percent <= 100.0))] = Status.NOT_IDENTIFIABLE
    status[baseline.total <= 0.0] = Status.NO_SIGNAL
    status[~baseline.finite] = Status.NOT_FINITE
    return status


def _aicc(wrss: Array, frames: int) -> Array:
    p = _PLAIN + _ADDED + 1
    with np.errstate(all="ignore"):
        return (
            frames * np.log(wrss / frames) + 2 * p + (2 * p * (p + 1) / (frames - p - 1) if frames > p + 1 else np.nan)
        )


def _predicted(
    frames: NDArray[np.floating],
    shared: Array,
    integral: Array,
    tried: Responses,
    values: Array,
    used: NDArray[np.intp],
) -> Array:
    """The right side of the equation (N, K); NaN in frames without weight, or without a response that fits."""
    curves = np.asarray(frames, np.float64).T
    gamma, R1, k2, k2a = values[:4, :, None]
    shapes = {tuple(times): shape for times, shape in zip(tried.times.T, tried.shapes)}
    none = np.full(len(integral), np.nan)
    h = np.stack([shapes.get(tuple(times), none) for times in values[5:].T]) if len(curves) else curves
    fitted = R1 * shared[0] + k2 * shared[1] - k2a * (curves @ integral.T) - gamma * ((curves * h) @ integral.T)
    answer = np.full_like(fitted, np.nan)
    answer[:, used] = fitted[:, used]
    return answer
