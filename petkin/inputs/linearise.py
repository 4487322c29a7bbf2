"""Reading a smooth curve as straight pieces: knots where they are needed, none where they are not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import PiecewiseLinear

#: Departures are judged relative to the curve, but never finer than to this share of its largest value.
_FLOOR = 1e-3
_MAXIMAL_KNOTS = 20_000
_INSIDE = np.array([0.25, 0.5, 0.75])


def piecewise_linear(
    curve: Callable[[NDArray[np.float64]], NDArray[np.float64]], knots: NDArray[np.float64], *, tolerance: float = 2e-4
) -> PiecewiseLinear:
    """A continuous curve as straight pieces that depart from it by less than `tolerance`, by halving pieces.

    Args:
        curve: function of time (min).
        knots: times that must be kept, at least the two ends and every kink (min), any order.
        tolerance: largest departure at the quarter points of a piece, relative to the curve there.

    Returns:
        The forcing, arrays of float64, from the first to the last knot.
    """
    times = np.unique(knots)
    values = curve(times)
    while times.size < _MAXIMAL_KNOTS:
        bent = _bent(curve, times, values, tolerance)
        if not bent.any():
            break
        middles = (times[:-1] + times[1:])[bent] / 2
        order = np.argsort(np.concatenate([times, middles]), kind="stable")
        values = np.concatenate([values, curve(middles)])[order]
        times = np.concatenate([times, middles])[order]
    return PiecewiseLinear(times, values)


def _bent(
    curve: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    times: NDArray[np.float64],
    values: NDArray[np.float64],
    tolerance: float,
) -> NDArray[np.bool_]:
    inside = times[:-1, None] + np.diff(times)[:, None] * _INSIDE
    chord = values[:-1, None] + np.diff(values)[:, None] * _INSIDE
    true = curve(inside.ravel()).reshape(inside.shape)
    allowed = tolerance * np.maximum(np.abs(true), _FLOOR * np.abs(values).max())
    wide = np.diff(times) > 1e-9 * max(1.0, float(np.abs(times).max()))
    return (np.abs(true - chord) > allowed).any(axis=1) & wide


def needed_knots(times: NDArray[np.float64], values: NDArray[np.float64], *, tolerance: float) -> NDArray[np.bool_]:
    """Which samples to keep so that straight lines between those pass every sample within `tolerance`.

    The split of Ramer (1972) and Douglas & Peucker (1973), with the departure measured along the value.

    Args:
        times: ascending, (samples,).
        values: (samples,), in any unit.
        tolerance: largest departure, as a share of the largest |value|.

    Returns:
        Mask, True where the sample stays, (samples,). The two ends always do.
    """
    allowed = tolerance * float(np.abs(values).max(initial=0.0))
    keep = np.zeros(times.size, dtype=bool)
    keep[[0, -1]] = True
    spans = [(0, times.size - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        inner = slice(first + 1, last)
        share = (times[inner] - times[first]) / max(times[last] - times[first], np.finfo(float).tiny)
        departure = np.abs(values[inner] - values[first] - share * (values[last] - values[first]))
        worst = int(departure.argmax())
        if departure[worst] > allowed:
            middle = first + 1 + worst
            keep[middle] = True
            spans += [(first, middle), (middle, last)]
    return keep
