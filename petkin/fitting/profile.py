"""Profile likelihood: intervals of one curve's parameters and of what follows from them, however curved the model is.

With only relative weights known, the noise scale is estimated, and the interval of a quantity g is

    { c : S(c) <= S_min (1 + F / (n - p)) },   S(c) = min { S(theta) : g(theta) = c },   F = F_0.95(1, n - p).

S(c) comes from fits with one more observation, "g is c", of great weight: the minimum of S(theta) + w (g(theta) - c)^2
lies at some g, and is the least S of all parameters with that very g. So rate constants and macro-parameters are
profiled alike, without rewriting the model for each.

References: Bates DM, Watts DG. Nonlinear regression analysis and its applications. Wiley 1988, section 6.1.
doi:10.1002/9780470316757. Venzon DJ, Moolgavkar SH. Appl Stat 1988;37:87-94. doi:10.2307/2347496
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.likelihood import Likelihood
from petkin.fitting.nonlinear import NonlinearSettings, alike, squeeze
from petkin.fitting.results import Column, FitResult, Plot
from petkin.fitting.table import BasisTable

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Profile:
    """Profile likelihood of one quantity of one curve.

    Args:
        symbol, unit: the quantity.
        estimate: where S is least.
        low, high: ends of the interval; NaN where it has none on that side.
        value: values of the quantity, rising (n,).
        ratio: (S - S_min) / (S_min / (n - p)) there (n,).
        limit: the F that bounds the interval.
    """

    symbol: str
    unit: str
    estimate: float
    low: float
    high: float
    value: Array
    ratio: Array
    limit: float

    @property
    def words(self) -> str:
        """What is special about the interval; "" for nothing."""
        parts = [
            f"no {side} limit: {self.symbol} {reached} cannot be excluded"
            for side, end, reached in (
                ("lower", self.low, f"down to {self._inside[0]:.3g}"),
                ("upper", self.high, f"up to {self._inside[-1]:.3g}"),
            )
            if np.isnan(end)
        ]
        return "; ".join(parts)

    @property
    def _inside(self) -> Array:
        return self.value[self.ratio <= self.limit]


def profile(
    curve: NDArray[np.floating],
    result: FitResult,
    row: int,
    table: BasisTable,
    settings: NonlinearSettings,
    symbols: Sequence[str] = (),
) -> tuple[Profile, ...]:
    """Profile likelihoods of one curve, 95 percent intervals.

    Args:
        curve: (K,), kBq/mL.
        result: a fit that holds it.
        row: its place there.
        table: basis table that it was fitted with.
        settings: as it was fitted with.
        symbols: which quantities; all that are not fixed if none is named.

    Returns:
        One profile a quantity that has an estimate.
    """
    model = settings.model
    known = {q.symbol: i for i, q in enumerate(model.quantities)}
    free = [s for s in known if s not in settings.box.symbols or not settings.box[s].fixed]
    chosen = [s for s in symbols or free if s in free and np.isfinite(result[s][row])]
    if not chosen:
        return ()
    weights = alike(np.asarray(result.weights, np.float64)[..., :], len(result.status))
    own = next(w for rows, w in weights if row in rows)
    problem = Likelihood.of(np.asarray(curve, np.float64), result, row, squeeze(table, own, settings), settings, own)
    walks = problem.walk(np.array([known[s] for s in chosen]), [_scale(result, s, row) for s in chosen])
    unit = {e.symbol: e.unit for e in result.estimates}
    return tuple(
        _interval(s, unit[s], float(result[s][row]), points, problem) for s, points in zip(chosen, walks, strict=True)
    )


def _scale(result: FitResult, symbol: str, row: int) -> float:
    """A first step: the standard error, or a third of the value where there is none."""
    value, error = abs(float(result[symbol][row])), float(result.percent_se(symbol)[row]) / 100.0
    share = error if np.isfinite(error) and 1e-6 < error < 1.0 else 0.3
    return share * value if value > 0 else 1e-3


def _interval(symbol: str, unit: str, estimate: float, points: Array, problem: Likelihood) -> Profile:
    least = min(problem.least, points[:, 1].min())
    ratio = np.maximum(points[:, 1] - least, 0.0) / problem.variance
    value, root = points[:, 0], np.sqrt(ratio)
    at = int(np.argmin(np.abs(value - estimate)))
    edge = np.sqrt(problem.limit)

    def crossing(side: slice) -> float:
        g, r, stopped = value[side], root[side], points[side, 2] > 0
        beyond = np.flatnonzero(r >= edge)
        if beyond.size == 0:
            return float("nan")
        k = int(beyond[0])
        if stopped[k - 1]:
            return float("nan")  # the data go on, only the interval of rates ends
        return float(g[k - 1] + (edge - r[k - 1]) / (r[k] - r[k - 1]) * (g[k] - g[k - 1])) if k else float(g[0])

    return Profile(
        symbol,
        unit,
        estimate,
        crossing(slice(at, None, -1)),
        crossing(slice(at, None)),
        value,
        ratio,
        problem.limit,
    )


def with_profiles(result: FitResult, names: Sequence[str], found: dict[int, tuple[Profile, ...]]) -> FitResult:
    """The result with profile intervals: columns `<symbol>-low` and `<symbol>-high`, pictures, and words.

    Args:
        result: fit of the curves.
        names: of the curves (N,).
        found: profiles by curve.
    """
    count, units = len(result.status), {e.symbol: e.unit for e in result.estimates}
    columns, plots, words = [], [], []
    for symbol in dict.fromkeys(p.symbol for profiles in found.values() for p in profiles):
        ends = np.full((2, count), np.nan)
        for row, one in ((row, p) for row, profiles in found.items() for p in profiles if p.symbol == symbol):
            ends[:, row] = one.low, one.high
        for side, values in zip(("low", "high"), ends):
            meaning = f"{symbol}: {side}er end of its 95 percent interval by profile likelihood, n/a for none"
            columns.append(
                Column(f"{symbol}-{side}", values, meaning.replace("higher", "upper"), units[symbol], mapped=False)
            )
    for row, profiles in found.items():
        for one in profiles:
            plots.append(_plot(f"{names[row]}: {one.symbol}", one))
            if one.words:
                words.append(f"{result.model}, {names[row]}: {one.symbol} has {one.words}.")
    return replace(
        result,
        columns=(*result.columns, *columns),
        plots=(*result.plots, *plots),
        remarks=(*result.remarks, *words),
    )


def _plot(title: str, one: Profile) -> Plot:
    ends = one.value[[0, -1]]
    shown = one.ratio <= 4.0 * one.limit
    low, high = ("none" if np.isnan(end) else f"{end:.4g}" for end in (one.low, one.high))
    return Plot(
        title=f"Profile likelihood, {title}",
        x_label=f"{one.symbol} ({one.unit})" if one.unit not in ("", "1") else one.symbol,
        y_label="(S - S_min) / (S_min / (n - p))",
        points=(),
        lines=(
            ("profile", one.value[shown], one.ratio[shown]),
            ("95 % limit", ends, np.full(2, one.limit)),
        ),
        mark=one.estimate,
        text=f"95 % interval: {low} to {high}.",
    )
