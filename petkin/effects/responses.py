"""What frames report of the pieces that every tissue curve is made of: exactly, or from a table for many curves.

    plasma(a):  e^{-a t} * C_P        blood:  C_B        trapped(a):  e^{-a t} * C_B

The table is for a diagnosis, which asks for thousands of curves under many inputs: everything is marched once along
the nodes of the input, for 48 rates; a delay then only moves the frame edges, and any rate is read by a spline.
With u the decayed input and y its response, y' = u - (a + lambda) y, so a frame's integral is (dU - dy) / (a + lambda).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from petkin.dynamics import Forcing, Shifted
from petkin.dynamics.recurrence import step
from petkin.imaging import FrameObservation
from petkin.inputs import InputFunction
from petkin.jit import njit

Array = NDArray[np.float64]

#: Rates of the table, 1/min, even in log(a + offset), in which a spline of the seventh degree reads between them to
#: 3e-6 of a curve's highest value.
_OFFSET, _DEGREE = 0.008, 7
_KNOTS = np.linspace(math.log(_OFFSET), math.log(15.0 + _OFFSET), 48)
_RATES = np.exp(_KNOTS) - _OFFSET
_RATES[0] = 0.0
#: Added to a + lambda where it divides, 1/min.
_LEAST = 1e-7
#: Digits of a minute to which steps are told apart; y is kept at every so many nodes, which a core holds at hand.
_DIGITS, _EVERY = 12, 8


class Responses(Protocol):
    """Frame values (..., K) of the pieces of a curve; arrays or tensors, as the rates are."""

    def plasma(self, rates: Any) -> Any:
        """Of e^{-a t} * C_P for rates (...)."""
        ...

    def metabolites(self, rates: Any) -> Any:
        """Of e^{-a t} * (total plasma - C_P), zero where no parent fraction is known."""
        ...

    @property
    def blood(self) -> Any:
        """Of C_B, (K,)."""
        ...

    def trapped(self, rates: Any) -> Any:
        """Of e^{-a t} * C_B, min kBq/mL: what vessel walls keep; at a = 0 the area under the blood."""
        ...


def alike(values: Any, like: Any) -> Any:
    """Numbers as the kind that `like` is, tensor or array."""
    return torch.as_tensor(values) if isinstance(like, torch.Tensor) else np.asarray(values)


@dataclass(frozen=True)
class Exact:
    """Closed forms of the input function itself, differentiable."""

    input: InputFunction
    clock: FrameObservation

    def plasma(self, rates: torch.Tensor) -> torch.Tensor:
        return self.clock.of_response(self.input.plasma, rates)

    def metabolites(self, rates: torch.Tensor) -> torch.Tensor:
        total = self.input.total_plasma
        if total is None or self.input.parent_fraction is None:
            return torch.zeros(*rates.shape, len(self.clock.frames), dtype=rates.dtype)
        return self.clock.of_response(total, rates) - self.plasma(rates)

    @property
    def blood(self) -> torch.Tensor:
        return torch.as_tensor(self.clock.of_forcing(self.input.whole_blood))

    def trapped(self, rates: Any) -> torch.Tensor:
        return self.clock.of_response(self.input.whole_blood, torch.as_tensor(rates, dtype=torch.float64))


class Tabulated:
    """The same from a table; inputs are read as straight lines between `nodes`."""

    def __init__(self, input: InputFunction, clock: FrameObservation, nodes: Array) -> None:
        self._input, self._clock, self._nodes = input, clock, nodes.tobytes()
        self._plasma = self._frames(input.plasma, _RATES)

    def _frames(self, forcing: Forcing, rates: Array) -> Array:
        found = _march(*_unshifted(forcing), self._clock.decay, self._nodes).frames(self._clock, rates)
        return np.ascontiguousarray(found)

    def plasma(self, rates: Array) -> Array:
        return _between(rates, self._plasma)

    @cached_property
    def blood(self) -> Array:
        return _march(*_unshifted(self._input.whole_blood), self._clock.decay, self._nodes).frames(self._clock, None)

    @cached_property
    def _blood_area(self) -> Array:
        return self._frames(self._input.whole_blood, _RATES[:1])[0]

    @cached_property
    def _kept(self) -> Array:
        return self._frames(self._input.whole_blood, _RATES)

    def trapped(self, rates: Any) -> Array:
        return _between(rates, self._kept) if np.any(rates) else self._blood_area

    @cached_property
    def _total(self) -> Array | None:
        total = self._input.total_plasma
        return None if total is None or self._input.parent_fraction is None else self._frames(total, _RATES)

    def metabolites(self, rates: Array) -> Array:
        if self._total is None:
            return np.zeros((*np.shape(rates), len(self._clock.frames)))
        return _between(rates, self._total) - self.plasma(rates)


def _pieces() -> tuple[Array, Array]:
    """Where the pieces of a spline through a table begin and end, and their coefficients as weights of its rows (degree
    + 1, pieces, rates)."""
    spline = make_interp_spline(_KNOTS, np.eye(_RATES.size), _DEGREE)
    breaks = np.unique(spline.t)
    orders = range(_DEGREE, -1, -1)
    return breaks, np.stack([spline.derivative(n)(breaks[:-1]) / math.factorial(n) for n in orders])


_BREAKS, _SPLINE = _pieces()


def _between(rates: Array, table: Array) -> Array:
    """Rows of a table at any rates: (...) to (..., K)."""
    return _read(np.ravel(rates), _BREAKS, _SPLINE, table).reshape(*np.shape(rates), table.shape[1])


def _unshifted(forcing: Forcing) -> tuple[Forcing, float]:
    delay = 0.0
    while isinstance(forcing, Shifted):
        delay, forcing = delay + float(forcing.delay), forcing.forcing
    return forcing, delay


class _Walked(NamedTuple):
    """An input that was walked along: nodes, u there, y of every rate at some of them, U = int u, and the weights of
    every step, few of which differ, with which is whose."""

    times: Array
    u: Array
    y: Array
    area: Array
    weights: Array
    which: NDArray[np.intp]


@dataclass(frozen=True)
class _March:
    """A decayed input that is read `delay` minutes late."""

    walked: _Walked
    delay: float
    decay: float

    def frames(self, clock: FrameObservation, rates: Array | None) -> Array:
        """Frame values of the input itself (None), or of its responses to rates of the table, from the first on."""
        sinks = np.zeros(0) if rates is None else rates + self.decay
        if clock.mid_frame:
            return self._mid_frame(clock, sinks)
        frames = clock.frames
        integral = _counted(self.walked, sinks, frames.start - self.delay, frames.end - self.delay)
        gone = math.exp(-self.decay * self.delay)  # decay over the delay: the input is decay-corrected to injection
        return (gone / clock.divisor) * (integral[:-1] if sinks.size else integral[-1])

    def _mid_frame(self, clock: FrameObservation, sinks: Array) -> Array:
        mid = clock.frames.mid - self.delay
        walked = self.walked
        curve = _at(walked, sinks, mid)[:, :-1].T if sinks.size else np.interp(mid, walked.times, walked.u, left=0.0)
        return curve * np.exp(self.decay * mid) * clock.gain_or_one


@lru_cache(maxsize=64)
def _marched(forcing: Forcing, decay: float, nodes: bytes) -> _Walked:
    times = np.frombuffer(nodes).copy()
    u = np.asarray(forcing(times), np.float64) * np.exp(-decay * times)
    weights, which = _steps(decay, nodes)
    y, area = _walk(times, u, weights, which)
    return _Walked(times, u, y, area, weights, which)


def _march(forcing: Forcing, delay: float, decay: float, nodes: bytes) -> _March:
    return _March(_marched(forcing, decay, nodes), delay, decay)


@njit()
def _weigh(lengths, rates):
    """What steps of some lengths do, for every rate (steps, 3, rates)."""
    found = np.empty((lengths.size, 3, rates.size))
    for i in range(lengths.size):
        for r in range(rates.size):
            kept, first, last = step(rates[r], lengths[i])
            found[i, 0, r], found[i, 1, r], found[i, 2, r] = kept, first, last
    return found


@lru_cache(maxsize=8)
def _steps(decay: float, nodes: bytes) -> tuple[Array, NDArray[np.intp]]:
    """The weights of all lengths that steps between nodes have, few of which differ, and which is whose."""
    lengths, which = np.unique(np.diff(np.frombuffer(nodes)).round(_DIGITS), return_inverse=True)
    return _weigh(lengths, _RATES + decay), which


@njit()
def _walk(times, u, weights, which):
    """y at every `_EVERY`-th node (nodes, rates), and U at all."""
    area, here = np.zeros(times.size), np.zeros(weights.shape[2])
    y = np.empty((1 + (times.size - 1) // _EVERY, here.size))
    for i in range(times.size):
        if i % _EVERY == 0:
            y[i // _EVERY] = here
        if i + 1 < times.size:
            area[i + 1] = area[i] + 0.5 * (times[i + 1] - times[i]) * (u[i] + u[i + 1])
            _take(here, weights, which[i], u[i], u[i + 1])
    return y, area


@njit()
def _take(y, weights, which, before, after):
    """A step of y; rows of weights are passed by number: views of them would cost more than the sums."""
    for r in range(y.size):
        y[r] = weights[which, 0, r] * y[r] + weights[which, 1, r] * before + weights[which, 2, r] * after


@njit()
def _reach(walked, rates, t, found):
    """y of every rate and, last, U at a time; zero before the first node, the input held after the last."""
    times, u, y, area, weights, which = walked
    if t <= times[0]:
        found[:] = 0.0
        return
    i = min(np.searchsorted(times, t, side="right") - 1, times.size - 1)
    here = found[:-1]
    here[:] = y[i // _EVERY, : here.size]
    for k in range(i // _EVERY * _EVERY, i):
        _take(here, weights, which[k], u[k], u[k + 1])
    d, now = t - times[i], u[i]
    if i + 1 < times.size:
        now = u[i] + (u[i + 1] - u[i]) * d / (times[i + 1] - times[i])
    for r in range(here.size):
        kept, first, last = step(rates[r], d)
        here[r] = kept * here[r] + first * u[i] + last * now
    found[-1] = area[i] + 0.5 * d * (u[i] + now)


@njit()
def _at(walked, rates, wanted):
    """The same at many times (times, rates + 1)."""
    found = np.empty((wanted.size, rates.size + 1))
    for k in range(wanted.size):
        _reach(walked, rates, wanted[k], found[k])
    return found


@njit()
def _counted(walked, rates, start, end):
    """Integrals over frames of the response to every rate, (dU - dy) / a, and, last, of u (rates + 1, frames)."""
    found = np.empty((rates.size + 1, start.size))
    before, after = np.empty(rates.size + 1), np.empty(rates.size + 1)
    for k in range(start.size):
        if k > 0 and start[k] == end[k - 1]:
            before, after = after, before
        else:
            _reach(walked, rates, start[k], before)
        _reach(walked, rates, end[k], after)
        gained = after[-1] - before[-1]
        for r in range(rates.size):
            found[r, k] = (gained - (after[r] - before[r])) / max(rates[r], _LEAST)
        found[-1, k] = gained
    return found


@njit()
def _read(rates, breaks, spline, table):
    """Rows of a table at every rate (rates, K), as the spline through them has it; none lies beyond the table."""
    weight = np.empty((rates.size, spline.shape[2]))
    for n in range(rates.size):
        x = min(max(np.log(max(rates[n], 0.0) + _OFFSET), breaks[0]), breaks[-1])
        i = min(np.searchsorted(breaks, x, side="right") - 1, breaks.size - 2)
        d = x - breaks[i]
        for j in range(weight.shape[1]):
            weight[n, j] = spline[0, i, j]
        for order in range(1, spline.shape[0]):
            for j in range(weight.shape[1]):
                weight[n, j] = weight[n, j] * d + spline[order, i, j]
    return weight @ table
