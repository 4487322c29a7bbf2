"""The way along a profile likelihood: fits of one curve with one quantity held, from its estimate to both limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.f_distribution import quantile
from petkin.fitting.nonlinear import NonlinearSettings
from petkin.fitting.projection import project_curves
from petkin.fitting.results import FitResult
from petkin.fitting.sensitivity import derivatives, model_jacobian, model_values
from petkin.fitting.table import Compression
from petkin.levenberg_marquardt import polish

Array = NDArray[np.float64]

#: Confidence of the intervals.
LEVEL = 0.95
#: How firmly a fit is held at a value, and rates in their interval, in standard errors of the noise.
_HOLD = 100.0
#: Distances from the estimate that are tried in turn until the limit is passed, in standard errors.
_STEPS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 9.0, 14.0, 20.0, 40.0, 100.0, 300.0, 1000.0)
_REFINED = 8
_TOLERANCE = 1e-10
#: A point this near to the limit, in units of the noise variance, is taken for it.
_NEAR = 1e-3


@dataclass(frozen=True)
class Likelihood:
    """One curve with everything that its profiles need."""

    settings: NonlinearSettings
    packed: Compression
    z: Array
    size: float
    theta: Array
    least: float
    variance: float
    limit: float

    @classmethod
    def of(
        cls,
        curve: Array,
        result: FitResult,
        row: int,
        packed: Compression,
        settings: NonlinearSettings,
        weights: Array,
    ) -> Likelihood:
        z, size, *_ = project_curves(packed, weights, curve[:, None], 0, 1)
        freedom = int(np.count_nonzero(weights > 0)) - len(settings.box.free)
        theta = np.array([result[s][row] for s in settings.model.parameters.symbols], np.float64)
        variance = float(result.chi2[row])
        limit = quantile(LEVEL, 1, freedom)
        return cls(settings, packed, z[:, 0], float(size[0]), theta, variance * freedom, variance, limit)

    def walk(self, which: NDArray[np.intp], scale: list[float]) -> list[Array]:
        """Points (value, S, edge) on both sides of the estimates of some quantities, each (n, 3), by value."""
        here = self.quantities(self.theta[None])[0][0, which]
        lanes = [Way(int(q), side, float(g), s) for q, g, s in zip(which, here, scale) for side in (-1.0, 1.0)]
        for lane in lanes:
            lane.points.append((lane.start, self.least, self.theta))
        top = self.least + self.variance * self.limit
        for step in _STEPS:
            going = [lane for lane in lanes if lane.goes_on(top)]
            if not going:
                break
            self._visit(going, [lane.start + lane.side * step * lane.scale for lane in going])
        for _ in range(_REFINED):
            open_ = [lane for lane in lanes if lane.crossed(top) and not lane.settled(top, self.variance)]
            if open_:
                self._visit(open_, [lane.between(top, self.least) for lane in open_])
        joined = (lanes[i].points + lanes[i + 1].points[1:] for i in range(0, len(lanes), 2))
        return [self._table(points) for points in joined]

    def _table(self, points: list[tuple[float, float, Array]]) -> Array:
        """Value, S, and whether a rate has reached the end of its interval (n, 3), by value, each value once."""
        edge = np.asarray((self.outside(np.stack([theta for _, _, theta in points]))[0] > 0.0).any(axis=1))
        table = np.array(sorted((g, s, float(e)) for (g, s, _), e in zip(points, edge)))
        span = table[-1, 0] - table[0, 0]
        return table[np.concatenate([[True], np.diff(table[:, 0]) > 1e-7 * span])]

    def _visit(self, lanes: list[Way], targets: list[float]) -> None:
        """Fit with quantities held near the targets, from the nearest point that each lane has seen."""
        model, box, R = self.settings.model, self.settings.box, len(self.z)
        which = np.array([lane.which for lane in lanes])
        aim = np.array([max(t, 0.0) for t in targets])
        hold = _HOLD * np.sqrt(self.variance) / np.array([lane.scale for lane in lanes])
        start = np.array([lane.nearest(t) for lane, t in zip(lanes, aim)])
        z = np.zeros((R + 3, len(lanes)))
        z[:R] = self.z[:, None]

        def values(theta: Array, rows: NDArray[np.intp]) -> Array:
            with np.errstate(all="ignore"):
                held = hold[rows] * (self.quantities(theta)[0][np.arange(len(rows)), which[rows]] - aim[rows])
                return np.column_stack([model_values(model, self.packed, theta), held, self.outside(theta)[0]])

        def jacobian(theta: Array, rows: NDArray[np.intp]) -> tuple[Array, Array]:
            with np.errstate(all="ignore"):
                curve, slopes = model_jacobian(model, self.packed, theta)
                quantity, chain = self.quantities(theta)
                pick = np.arange(len(rows)), which[rows]
                held = hold[rows] * (quantity[pick] - aim[rows])
                beyond, edge = self.outside(theta)
                own = np.nan_to_num(hold[rows, None] * chain[pick], posinf=0.0, neginf=0.0)
                all_slopes = np.concatenate([slopes, own[:, None], edge], axis=1)
                return np.column_stack([curve, held, beyond]), all_slopes

        sizes = np.full(len(lanes), self.size)
        theta, _, _ = polish(values, jacobian, z, sizes, start, box.lower, box.upper, _TOLERANCE, walls=2)
        outside = self.size - float(self.z @ self.z)
        cost = ((self.z - model_values(model, self.packed, theta)) ** 2).sum(axis=1) + outside
        reached = self.quantities(theta)[0][np.arange(len(lanes)), which]
        for lane, g, s, end in zip(lanes, reached, cost, theta):
            if np.isfinite(g) and lane.side * (g - lane.start) > 0:
                lane.points.append((float(g), float(s), end))

    def quantities(self, theta: Array) -> tuple[Array, Array]:
        """Parameters and macro-parameters (N, P + M), and their derivatives by the parameters (N, P + M, P)."""
        model = self.settings.model
        P = theta.shape[1]
        with np.errstate(all="ignore"):
            macros, chain = derivatives(lambda *k: tuple(m.formula(*k) for m in model.macros), theta[:, : model.rates])
        wide = np.concatenate([chain, np.zeros((*chain.shape[:2], P - model.rates))], axis=2)
        own = np.broadcast_to(np.eye(P), (len(theta), P, P))
        return np.concatenate([theta, macros], axis=1), np.concatenate([own, wide], axis=1)

    def outside(self, theta: Array) -> tuple[Array, Array]:
        """How far the fastest and the slowest rate lie beyond their ends, held there like g (N, 2); slopes."""
        model, (slow, fast) = self.settings.model, self.settings.rate_bounds
        firm = _HOLD * np.sqrt(self.variance)
        rates, chain = derivatives(lambda *k: tuple(a for _, a in model.impulse(*k)), theta[:, : model.rates])
        first, last = (np.maximum(rates[:, i], 1e-12) for i in (0, model.free_rates - 1))
        slopes = np.zeros((len(theta), 2, theta.shape[1]))
        slopes[:, 0, : model.rates] = (firm / first)[:, None] * chain[:, 0]
        over, under = np.log(first / fast), np.full(len(theta), -1.0)
        if slow > 0 and not model.trapping:
            under = np.log(slow / last)
            slopes[:, 1, : model.rates] = -(firm / last)[:, None] * chain[:, model.free_rates - 1]
        return firm * np.column_stack([over, under]), np.nan_to_num(slopes, posinf=0.0, neginf=0.0)


class Way:
    """The way from an estimate to one end of its interval."""

    def __init__(self, which: int, side: float, start: float, scale: float) -> None:
        self.which, self.side, self.start, self.scale = which, side, start, scale
        self.points: list[tuple[float, float, Array]] = []

    def goes_on(self, top: float) -> bool:
        """Whether the limit is not reached, and there is somewhere to go."""
        return self.points[-1][1] < top and (self.side > 0 or self.points[-1][0] > 1e-9 * self.scale)

    def crossed(self, top: float) -> bool:
        return max(s for _, s, _ in self.points) >= top

    def settled(self, top: float, variance: float) -> bool:
        """Whether a point is as near to the limit as matters."""
        return min(abs(s - top) for _, s, _ in self.points) < _NEAR * variance

    def between(self, top: float, least: float) -> float:
        """Where the limit lies, on a straight line in sqrt(S - S_min) between the points on both sides of it."""
        inside, outside = self.bracket(top)
        low, high = (np.sqrt(max(s - least, 0.0)) for s in (inside[1], outside[1]))
        share = (np.sqrt(top - least) - low) / max(high - low, 1e-300)
        return inside[0] + min(max(share, 0.02), 0.98) * (outside[0] - inside[0])

    def bracket(self, top: float) -> tuple[tuple[float, float, Array], tuple[float, float, Array]]:
        """The nearest point above the limit and the last one below it that is nearer to the estimate."""
        outside = min((p for p in self.points if p[1] >= top), key=lambda p: self.side * p[0])
        nearer = [p for p in self.points if p[1] < top and self.side * p[0] <= self.side * outside[0]]
        return max(nearer, key=lambda p: self.side * p[0]), outside

    def nearest(self, target: float) -> Array:
        return min(self.points, key=lambda p: abs(p[0] - target))[2]
