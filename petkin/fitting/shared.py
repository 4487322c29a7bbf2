"""A parameter that all regions of a scan have in common: one number for all, everything else a region's own.

    minimise over theta   sum_r WRSS_r(theta) / s_r^2,   WRSS_r(theta) = min over the region's own parameters,

s_r^2 the noise of region r from its fit without the constraint. The profile's curvature gives the standard error of
theta (the least plus 1, one standard error away), and what theta's error adds to a region's own estimates x_r follows
from their slopes along the profile: var(x_r) = var(x_r | theta) + (dx_r / dtheta)^2 var(theta). Whether one number will
do is an F test of the rise above the unconstrained fits.

Reference: Seber GAF, Wild CJ. Nonlinear Regression. Wiley 1989, chapter 5, doi:10.1002/0471725315 (profiles, nested
models).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting.curves import finite_curves
from petkin.fitting.explicit import best_polish
from petkin.fitting.f_distribution import exceeded
from petkin.fitting.nonlinear import NonlinearSettings, fit_curves
from petkin.fitting.results import Estimate, FitResult, Plot, Status
from petkin.fitting.search import REGIONS
from petkin.fitting.sensitivity import model_jacobian, model_values
from petkin.fitting.table import Compression, build_table, compress
from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction

Array = NDArray[np.float64]

#: Values of the shared parameter tried first, evenly in its logarithm, between the regions' own.
_COARSE = 9
#: How often, and with how many values each time, the least is looked at more closely.
_ZOOMS, _AROUND = 3, 5
#: Probability below which the regions' own values are said to differ.
_CONTRADICTED = 0.01
#: Smallest value tried, as a share of the regions' median: those that ended at zero have no logarithm.
_LEAST = 1e-2


@dataclass(frozen=True)
class Profile:
    """Cost of a shared parameter.

    Args:
        tried: values ascending.
        costs: weighted sums of squares over the noise variance, summed over the regions.
        best: value of the least cost.
        se: its standard error; NaN where it ran into an end of its bounds.
    """

    tried: Array
    costs: Array
    best: float
    se: float


def fit_shared(
    symbol: str,
    curves: NDArray[np.floating],
    arterial: InputFunction,
    observation: FrameObservation,
    weights: Array,
    settings: NonlinearSettings,
) -> FitResult:
    """Fit curves with one value of `symbol` for all of them.

    Args:
        symbol: parameter of the model.
        curves: regions (N, K), kBq/mL.
        arterial: input function with its delay.
        observation: what frames report.
        weights: (K,), shared by all curves.
        settings: model and bounds.

    Returns:
        As `fit_curves`, with the shared value in `shared`, the profile as a plot, and percent standard errors that hold
        the uncertainty of the shared value too.

    Raises:
        InputError: fewer than two regions, weights of their own, or a parameter that is held.
    """
    curves, weights = np.asarray(curves), np.asarray(weights, np.float64)
    if weights.ndim != 1:
        raise InputError(f"{symbol} shared over regions needs frame weights that all regions share; give one row.")
    if settings.box[symbol].fixed:
        raise InputError(f"{symbol} is given to --share and to --fix; estimate it or hold it.")
    free = fit_curves(curves, arterial, observation, weights, settings)
    used = np.flatnonzero(~np.isin(free.status, (Status.NOT_FINITE, Status.NO_SIGNAL)))
    if len(used) < 2:
        raise InputError(f"{symbol} cannot be shared: {len(used)} curves can be fitted, and two regions are needed.")
    regions = _Regions.of(curves[used], free, used, arterial, observation, weights, settings)
    profile = _profile(symbol, regions)
    fitted = _at(symbol, profile.best, curves, arterial, observation, weights, settings)
    beside = profile.se if np.isfinite(profile.se) else 1e-3 * profile.best
    low, high = (max(profile.best + sign * beside, settings.box[symbol].lower) for sign in (-1.0, 1.0))
    below, above = (_at(symbol, v, curves, arterial, observation, weights, _quick(settings)) for v in (low, high))
    return _completed(symbol, profile, fitted, (high - low, below, above), regions, settings)


@dataclass(frozen=True)
class _Regions:
    """Compressed curves of the regions, their unconstrained optima, and their noise."""

    settings: NonlinearSettings
    packed: Compression
    z: Array
    sizes: Array
    theta: Array
    noise: Array
    freedom: int

    @classmethod
    def of(
        cls,
        curves: NDArray[np.floating],
        free: FitResult,
        used: NDArray[np.intp],
        arterial: InputFunction,
        observation: FrameObservation,
        weights: Array,
        settings: NonlinearSettings,
    ) -> _Regions:
        box = settings.box
        fastest = max(settings.rate_bounds[1], float(np.sum(box.upper[1:-1])))
        table = build_table(arterial, observation, rate_bounds=(0.0, fastest), nodes=REGIONS.nodes)
        packed = compress(table, weights, tolerance=1e-9)
        values = finite_curves(curves)[1]
        theta = np.column_stack([free[s][used] for s in box.symbols]).astype(np.float64)
        sizes = (weights * values**2).sum(axis=1)
        freedom = int(np.count_nonzero(weights)) - len(box.free)
        noise = np.maximum(free.chi2[used].astype(np.float64), 1e-12 * sizes)
        return cls(settings, packed, packed.project @ values.T, sizes, theta, noise, freedom)

    @property
    def _curves(self) -> tuple[Callable[[Array], Array], Callable[[Array], tuple[Array, Array]]]:
        """Model values of parameters, and with their derivatives."""
        model, packed = self.settings.model, self.packed
        return partial(model_values, model, packed), partial(model_jacobian, model, packed)

    def costs(self, place: int, values: Array, start: Array) -> tuple[Array, Array]:
        """With parameter `place` held at values (V,): best parameters (V, N, P), costs over the noise (V, N)."""
        box, count, regions = self.settings.box, len(values), len(self.noise)
        lower, upper = (np.tile(end, (count, regions, 1)) for end in (box.lower, box.upper))
        lower[:, :, place] = upper[:, :, place] = values[:, None]
        lower, upper, start = (v.reshape(count * regions, -1) for v in (lower, upper, np.clip(start, lower, upper)))
        z, sizes = np.tile(self.z, (1, count)), np.tile(self.sizes, count)
        theta, cost, _ = best_polish(*self._curves, z, sizes, [start], lower, upper, 1e-10)
        return theta.reshape(count, regions, -1), cost.reshape(count, regions) / self.noise


class _Search:
    """Values tried so far, ascending, with the regions' parameters and costs there."""

    def __init__(self, regions: _Regions, place: int, values: Array) -> None:
        self.regions, self.place, self.values = regions, place, values
        start = np.broadcast_to(regions.theta, (len(values), *regions.theta.shape))
        self.theta, self.costs = regions.costs(place, values, start)
        for neighbour in (1, -1):
            self._again(np.roll(self.theta, neighbour, axis=0))

    def _again(self, start: Array) -> None:
        theta, costs = self.regions.costs(self.place, self.values, start)
        better = costs < self.costs
        self.theta = np.where(better[:, :, None], theta, self.theta)
        self.costs = np.where(better, costs, self.costs)

    @property
    def totals(self) -> Array:
        return self.costs.sum(axis=1)

    @property
    def best(self) -> int:
        return int(np.argmin(self.totals))

    def add(self, values: Array) -> Array:
        """Try more values from the nearest ones tried; their totals."""
        nearest = np.abs(values[:, None] - self.values).argmin(axis=1)
        theta, costs = self.regions.costs(self.place, values, self.theta[nearest])
        order = np.argsort(np.concatenate([self.values, values]), kind="stable")
        self.values = np.concatenate([self.values, values])[order]
        self.theta, self.costs = (np.concatenate(v)[order] for v in ((self.theta, theta), (self.costs, costs)))
        return costs.sum(axis=1)


def _profile(symbol: str, regions: _Regions) -> Profile:
    """Values between the regions' own, then ever closer around the least cost."""
    place, parameter = regions.settings.box.symbols.index(symbol), regions.settings.box[symbol]
    own = regions.theta[:, place]
    low = max(parameter.lower, float(own.min()) / 1.5, _LEAST * float(np.median(own)), 1e-6)
    high = min(parameter.upper, max(float(own.max()) * 1.5, 2.0 * low))
    search = _Search(regions, place, np.geomspace(low, high, _COARSE))
    for _ in range(_ZOOMS):
        at, last = search.best, len(search.values) - 1
        around = np.geomspace(search.values[max(at - 1, 0)], search.values[min(at + 1, last)], _AROUND + 2)[1:-1]
        search.add(np.setdiff1d(around, search.values))
    best, se = float("nan"), float("nan")
    while search.values[search.best] != best:  # a look around for the error may come upon a lower cost
        search.add(np.array([_vertex(search.values, search.totals, search.best)]))
        best, least = float(search.values[search.best]), float(search.totals.min())
        se = _standard_error(search, best, least, (parameter.lower, parameter.upper))
    return Profile(search.values, search.totals, best, se)


def _vertex(values: Array, totals: Array, best: int) -> float:
    """Where a parabola through the least cost and its neighbours has its least."""
    if best in (0, len(values) - 1):
        return float(values[best])
    (left, right), (fall, rise) = np.diff(values[best - 1 : best + 2]), np.diff(totals[best - 1 : best + 2])
    bend = rise / right - fall / left
    step = -0.5 * (rise / right * left + fall / left * right) / bend if bend > 0 else 0.0
    return float(values[best] + np.clip(step, -left, right))


def _standard_error(search: _Search, best: float, least: float, bounds: tuple[float, float]) -> float:
    """How far the value must move for the cost to rise by 1: the mean of both sides; NaN next to a bound."""
    rise = search.totals - least
    known = (np.abs(search.values - best) > 1e-3 * best) & (rise > 0)
    step = float((np.abs(search.values - best)[known] / np.sqrt(rise[known])).min(initial=0.1 * best))
    widths = np.full(2, step)
    for _ in range(2):
        values = best + np.array([-1.0, 1.0]) * widths
        if values[0] <= bounds[0] or values[1] >= bounds[1]:
            return float("nan")
        widths = widths / np.sqrt(np.maximum(search.add(values) - least, 1e-4))
    return float(widths.mean())


def _at(
    symbol: str,
    value: float,
    curves: NDArray[np.floating],
    arterial: InputFunction,
    observation: FrameObservation,
    weights: Array,
    settings: NonlinearSettings,
) -> FitResult:
    held = replace(settings, parameters=settings.box.with_fixed({symbol: value}))
    return fit_curves(curves, arterial, observation, weights, held)


def _quick(settings: NonlinearSettings) -> NonlinearSettings:
    return replace(settings, keep_predicted=False, standard_errors=False)


def _completed(
    symbol: str,
    profile: Profile,
    fitted: FitResult,
    moved: tuple[float, FitResult, FitResult],
    regions: _Regions,
    settings: NonlinearSettings,
) -> FitResult:
    """The fit at the shared value, with errors that hold its own, its profile, and what the regions say of it."""
    width, low, high = moved
    percent = 100.0 * profile.se / profile.best
    estimates = []
    for estimate in fitted.estimates:
        if estimate.symbol == symbol:
            estimates.append(replace(estimate, percent_se=np.where(np.isfinite(estimate.value), percent, np.nan)))
            continue
        slope = (high[estimate.symbol] - low[estimate.symbol]) / width
        with np.errstate(all="ignore"):
            added = 100.0 * np.abs(slope * profile.se / estimate.value)
        estimates.append(_wider(estimate, added))
    bounds = {p.symbol: [p.lower, p.upper] for p in settings.box if not p.fixed}
    fixed = {s: v for s, v in fitted.settings["fixed"].items() if s != symbol}
    return replace(
        fitted,
        estimates=tuple(estimates),
        settings={**fitted.settings, "bounds": bounds, "fixed": fixed, "shared": [symbol]},
        shared={symbol: (profile.best, percent)},
        plots=(_plot(symbol, profile, settings.box[symbol].unit),),
        remarks=_remarks(fitted.model, symbol, profile, regions),
    )


def _wider(estimate: Estimate, added: Array) -> Estimate:
    finite = np.where(np.isfinite(added), added, 0.0)
    return replace(estimate, percent_se=np.hypot(estimate.percent_se, finite))


def _remarks(model: str, symbol: str, profile: Profile, regions: _Regions) -> tuple[str, ...]:
    """What the regions say against one value, and whether it ran into a bound."""
    count = len(regions.noise)
    rise = (float(profile.costs.min()) - count * regions.freedom) / (count - 1)
    chance = float(exceeded(rise, count - 1, count * regions.freedom))
    remarks = []
    if chance < _CONTRADICTED:
        remarks.append(
            f"{model}: the regions contradict one {symbol} for all (F = {rise:.3g}, p = {chance:.1g}): with their own "
            f"they fit better; what follows from the shared {symbol} is biased."
        )
    if not np.isfinite(profile.se):
        remarks.append(f"{model}: the shared {symbol} ended next to a bound ({profile.best:.3g}) and has no error.")
    return tuple(remarks)


def _plot(symbol: str, profile: Profile, unit: str) -> Plot:
    rise = profile.costs - profile.costs.min()
    return Plot(
        title=f"{symbol} shared by all regions",
        x_label=f"{symbol} ({unit})",
        y_label="rise of the summed WRSS / noise variance",
        points=(("tried", profile.tried, rise),),
        lines=(("profile", profile.tried, rise),),
        mark=profile.best,
        text=f"{symbol} = {profile.best:.4g}, standard error {profile.se:.2g}: there the cost has risen by 1.",
    )
