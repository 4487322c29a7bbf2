"""What frames report of the pieces that every tissue curve is made of: exactly, or from a table for many curves.

    plasma(a):  e^{-a t} * C_P        blood:  C_B        blood_area:  int_0^t C_B

The table is for a diagnosis, which asks for thousands of curves under many inputs: everything is marched once along
the nodes of the input, for a hundred rates; a delay then only moves the frame edges, and any rate is read by a spline.
With u the decayed input and y its response, y' = u - (a + lambda) y, so a frame's integral is (dU - dy) / (a + lambda).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from petkin.dynamics import Forcing, Shifted
from petkin.imaging import FrameObservation
from petkin.inputs import InputFunction

Array = NDArray[np.float64]

#: Rates of the table, 1/min: 0 and a geometric ladder; a spline in log(a + offset) reads between them to 1e-5.
_OFFSET = 0.004
_RATES = np.concatenate([[0.0], np.geomspace(3e-4, 15.0, 95)])
#: Added to a + lambda where it divides, 1/min.
_LEAST = 1e-7


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

    @property
    def blood_area(self) -> Any:
        """Of int_0^t C_B, (K,), min kBq/mL."""
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
        return self.clock.of_forcing(self.input.whole_blood)

    @property
    def blood_area(self) -> torch.Tensor:
        return self.clock.of_response(self.input.whole_blood, torch.zeros((), dtype=torch.float64))


class Tabulated:
    """The same from a table; inputs are read as straight lines between `nodes`."""

    def __init__(self, input: InputFunction, clock: FrameObservation, nodes: Array) -> None:
        self._input, self._clock, self._nodes = input, clock, nodes
        self._plasma = _table(input.plasma, clock, nodes)
        blood = _march(*_unshifted(input.whole_blood), clock.decay, nodes.tobytes())
        self.blood = blood.frames(clock, None)
        self.blood_area = blood.frames(clock, 0)

    def plasma(self, rates: Array) -> Array:
        return self._plasma(np.log(np.clip(rates, 0.0, _RATES[-1]) + _OFFSET))

    def metabolites(self, rates: Array) -> Array:
        total = self._input.total_plasma
        if total is None or self._input.parent_fraction is None:
            return np.zeros((*np.shape(rates), len(self._clock.frames)))
        whole = _table(total, self._clock, self._nodes)
        return whole(np.log(np.clip(rates, 0.0, _RATES[-1]) + _OFFSET)) - self.plasma(rates)


def _table(forcing: Forcing, clock: FrameObservation, nodes: Array) -> CubicSpline:
    base, delay = _unshifted(forcing)
    frames = _march(base, delay, clock.decay, nodes.tobytes()).frames(clock, slice(None))
    return CubicSpline(np.log(_RATES + _OFFSET), frames)


def _unshifted(forcing: Forcing) -> tuple[Forcing, float]:
    delay = 0.0
    while isinstance(forcing, Shifted):
        delay, forcing = delay + float(forcing.delay), forcing.forcing
    return forcing, delay


@dataclass(frozen=True)
class _March:
    """y of every rate and U = int u, decayed, at the nodes of an input that is read `delay` minutes late."""

    nodes: Array
    u: Array
    y: Array
    area: Array
    delay: float
    decay: float

    def frames(self, clock: FrameObservation, which: int | slice | None) -> Array:
        """Frame values of the input itself (None), or of its responses to some of the rates."""
        edges = np.concatenate([clock.frames.start, clock.frames.end]) - self.delay
        y, area = _at(self.nodes, self.u, self.y, self.area, _RATES + self.decay, edges)
        count = len(clock.frames)
        gone = np.exp(-self.decay * self.delay)  # decay over the delay: the input is decay-corrected to injection
        if clock.mid_frame:
            return self._mid_frame(clock, which)
        if which is None:
            integral = area[count:] - area[:count]
        else:
            dy = y[which, count:] - y[which, :count]
            sunk = np.maximum(_RATES[which] + self.decay, _LEAST)
            integral = ((area[count:] - area[:count]) - dy) / (sunk if isinstance(which, int) else sunk[:, None])
        return gone * integral / clock.divisor.numpy()

    def _mid_frame(self, clock: FrameObservation, which: int | slice | None) -> Array:
        mid = clock.frames.mid - self.delay
        if which is None:
            curve = np.interp(mid, self.nodes, self.u, left=0.0)
        else:
            curve = _at(self.nodes, self.u, self.y, self.area, _RATES + self.decay, mid)[0][which]
        return curve * np.exp(self.decay * mid) * clock.gain_or_one.numpy()


@lru_cache(maxsize=32)
def _marched(forcing: Forcing, decay: float, nodes: bytes) -> tuple[Array, Array, Array, Array]:
    times = np.frombuffer(nodes).copy()
    u = np.asarray(forcing(torch.from_numpy(times)).numpy() * np.exp(-decay * times), np.float64)
    y, area = _walk(times, u, _RATES + decay)
    return times, u, y, area


def _march(forcing: Forcing, delay: float, decay: float, nodes: bytes) -> _March:
    return _March(*_marched(forcing, decay, nodes), delay, decay)


@njit(cache=True, error_model="numpy")
def _step(a, d, first, last):
    """int_0^d e^{-a (d - s)} u(s) ds for u straight from `first` to `last`."""
    x = a * d
    if x < 1e-3:
        return d * (first * (0.5 - x / 3.0 + x * x / 8.0) + last * (0.5 - x / 6.0 + x * x / 24.0))
    gone = -np.expm1(-x)
    ramp = (x - gone) / (x * x)  # weight of the last value, over d
    return d * ((gone / x - ramp) * first + ramp * last)


@njit(cache=True, error_model="numpy")
def _walk(times, u, rates):
    count = times.size
    y, area = np.zeros((rates.size, count)), np.zeros(count)
    for i in range(count - 1):
        d = times[i + 1] - times[i]
        area[i + 1] = area[i] + 0.5 * d * (u[i] + u[i + 1])
        for r in range(rates.size):
            y[r, i + 1] = np.exp(-rates[r] * d) * y[r, i] + _step(rates[r], d, u[i], u[i + 1])
    return y, area


@njit(cache=True, error_model="numpy")
def _at(times, u, y, area, rates, wanted):
    """y and U at any time; zero before the first node, the input held after the last."""
    count = wanted.size
    found, total = np.zeros((rates.size, count)), np.zeros(count)
    for k in range(count):
        t = wanted[k]
        if t <= times[0]:
            continue
        i = min(np.searchsorted(times, t, side="right") - 1, times.size - 1)
        d, here = t - times[i], u[i]
        if i + 1 < times.size:
            here = u[i] + (u[i + 1] - u[i]) * d / (times[i + 1] - times[i])
        total[k] = area[i] + 0.5 * d * (u[i] + here)
        for r in range(rates.size):
            found[r, k] = np.exp(-rates[r] * d) * y[r, i] + _step(rates[r], d, u[i], here)
    return found, total
