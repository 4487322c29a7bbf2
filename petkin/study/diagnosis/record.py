"""How far the blood record of a scan is known: errors of C_P relative to itself, a, b standard normal.

As its samples scatter, where curves were fitted to them,

    s_p sum_i a_i h_i(t) + s_f (1 - f(t)) sum_j b_j h_j(t)

with h hats in ln(t + 1) over the samples of plasma and of the parent fraction f, whose logarithmic odds err alike; s_p
from plasma about a cubic in ln t after the first minutes, s_f from the fraction about its fitted curve. Or, where they
are joined by straight lines, as a smooth curve through the same samples departs from those,

    a (p(t) / p_line(t) - 1) + b (f(t) / f_line(t) - 1)

with ln p (from its peak on) and ln f (from 1 at injection) monotone cubics of time, as `petkin.inputs` interpolates;
after their last samples, with an a and b of their own, exponentials. A dense record without noise has neither.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.inputs import InputFunction, fit_parent_fraction
from petkin.inputs.blood_table import Samples
from petkin.inputs.curves import tail_rate, through

Array = NDArray[np.float64]

_TIME, _PLASMA, _AIF, _FRACTION = "time", "plasma_radioactivity", "AIF", "metabolite_parent_fraction"
#: From this time on (min) plasma falls smoothly; powers of ln t that describe it.
_SMOOTH, _POWERS = 4.0, 3
#: Samples that errors are given at, at most, and samples beyond a curve's parameters without which it tells no scatter.
_MOST, _SPARE = 10, 3
#: Scatter where too few samples tell it; shares nearer to 0 or 1 tell no odds.
_USUAL, _NEAREST = 0.05, 0.01


@dataclass(frozen=True)
class Scattered:
    """Samples that scatter.

    Args:
        times: min, > 0 (n,).
        size: standard deviation of one, relative or of logarithmic odds.
    """

    times: Array
    size: float

    def errors(self, nodes: Array) -> Array:
        """Hats over samples, fewer than those where they are many, each as sure as the samples that it stands for."""
        if not self.times.size or not self.size > 0:
            return np.zeros((0, nodes.size))
        count = min(self.times.size, _MOST)
        kept = np.log(self.times[np.unique(np.linspace(0, self.times.size - 1, count).round().astype(int))] + 1.0)
        hats = np.stack([np.interp(np.log(nodes + 1.0), kept, row) for row in np.eye(kept.size)])
        return np.asarray(self.size * np.sqrt(kept.size / self.times.size) * hats, np.float64)


def record_errors(arterial: InputFunction, nodes: Array) -> Array:
    """Standard deviations of C_P relative to itself at some times, one independent error after another (m, T).

    Args:
        arterial: with its samples, and the fit of its parent fraction.
        nodes: min (T,).
    """
    fit, fraction = arterial.parent_fraction_fit, fraction_samples(arterial)
    metabolised = np.zeros_like(nodes) if fit is None else 1.0 - fit(nodes)
    return np.concatenate([plasma_samples(arterial).errors(nodes), metabolised * fraction.errors(nodes)])


def between_errors(arterial: InputFunction, nodes: Array) -> Array:
    """How smooth curves through the samples of a record depart from the lines that it is read as, relative (m, T).

    Args:
        arterial: read as lines, with its samples.
        nodes: min (T,).
    """
    found, (times, plasma) = [np.zeros((0, nodes.size))], _activity(arterial)
    if times.size > 1:
        smooth, lines = through(Samples(times, plasma))(nodes), np.interp(nodes, times, plasma)
        found.append(_apart(nodes, smooth, lines, nodes > times[0], times[-1]))
    if arterial.parent_fraction is not None:
        times, shares = arterial.samples[[_TIME, _FRACTION]].dropna().to_numpy(np.float64).T
        falling = np.exp(-tail_rate(Samples(times, shares)) * np.maximum(nodes - times[-1], 0.0))
        smooth = fit_parent_fraction(times, shares, model="interpolated")(nodes) * falling
        lines = np.interp(nodes, times, shares)
        found.append(_apart(nodes, smooth, lines, lines > _NEAREST, times[-1]))
    return np.concatenate(found)


def _apart(nodes: Array, smooth: Array, lines: Array, there: NDArray[np.bool_], last: float) -> Array:
    """Relative to the lines, where there are any: between samples, and after the last of them (m, T)."""
    share = np.where(there, smooth / np.where(there, lines, 1.0) - 1.0, 0.0)
    rows = np.stack([np.where(nodes <= last, share, 0.0), np.where(nodes > last, share, 0.0)])
    return rows[np.abs(rows).max(axis=1) > 0]


def remark(arterial: InputFunction) -> str:
    """What is allowed for, in a sentence."""
    plasma, fraction = plasma_samples(arterial), fraction_samples(arterial)
    odds = f", the odds of its parent fraction by {fraction.size:.0%}" if fraction.times.size else ""
    return f"The diagnosis allows for errors of the blood record: samples of plasma scatter by {plasma.size:.0%}{odds}."


def plasma_samples(arterial: InputFunction) -> Scattered:
    """Samples of total plasma, or of C_P where the record holds that, and their relative scatter."""
    times, values = _activity(arterial)
    if not times.size:
        return Scattered(times, 0.0)
    late = times > _SMOOTH
    if late.sum() <= _POWERS + 1:
        return Scattered(times, _USUAL)
    x, y = np.log(times[late]), np.log(values[late])
    left = np.asarray(y - np.polyval(np.polyfit(x, y, _POWERS), x), np.float64)
    return Scattered(times, _size(left, _POWERS + 1))


def _activity(arterial: InputFunction) -> tuple[Array, Array]:
    """Times and values of plasma, or of C_P where the record holds that, where both are above 0."""
    table = arterial.samples
    column = _AIF if _AIF in table else _PLASMA
    if column not in table:
        return np.zeros(0), np.zeros(0)
    known = table[[_TIME, column]].dropna().to_numpy(np.float64)
    times, values = known[(known > 0).all(axis=1)].T
    return times, values


def fraction_samples(arterial: InputFunction) -> Scattered:
    """Samples of the parent fraction, and the scatter of their logarithmic odds about the fitted curve."""
    fit = arterial.parent_fraction_fit
    if fit is None:
        return Scattered(np.zeros(0), 0.0)
    later = fit.times > 0
    if not fit.parameters:
        return Scattered(fit.times[later], _USUAL)
    left = (_log_odds(fit.values) - _log_odds(fit.fitted))[later]
    return Scattered(fit.times[later], _size(left, len(fit.parameters) - 1))


def _log_odds(share: Array) -> Array:
    inside = np.clip(share, _NEAREST, 1.0 - _NEAREST)
    return np.asarray(np.log(inside / (1.0 - inside)), np.float64)


def _size(left: Array, parameters: int) -> float:
    """Robust standard deviation of what a fit of so many parameters left.

    The median absolute deviation over 0.6745: Rousseeuw PJ, Croux C. J Am Stat Assoc 1993;88:1273-1283.
    """
    if left.size < parameters + _SPARE:
        return _USUAL
    return float(np.median(np.abs(left)) / 0.6745 * np.sqrt(left.size / (left.size - parameters)))
