"""What drives a system from outside: u(t), with exact responses of a first-order system to it.

A `Forcing` knows its knots (times where it is not smooth), its integral, and its response

    y(t) = int_0^t e^{-a (t - s)} u(s) ds,

which is all that an exact solution of a linear compartment system needs. Everything is batched, and computed with
what is at hand: arrays give arrays; where forcing, times or rates are tensors the answer is one, and differentiable.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from petkin.dynamics.arrays import alike, library
from petkin.dynamics.exponential import exp_divided_difference
from petkin.dynamics.recurrence import at_knots, linear_recurrence
from petkin.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float
    from torch import Tensor

#: Of numpy or of torch.
Array = Any
#: Rates that a table has at most; more are those of voxels, and what they need is not kept.
_TABLE = 256


@runtime_checkable
class Forcing(Protocol):
    """An outside input u(t), zero before its onset; integrals and responses start there if it lies before time 0.

    Shapes: `*b` the batch of the forcing, `*r` of the rates, `*rb` both broadcast.
    """

    @property
    def knots(self) -> Any:
        """Times at which u or a derivative of it jumps, ascending (knots,)."""
        ...

    def __call__(self, t: Float[Array, " times"]) -> Any:
        """u(t), (*b, times)."""
        ...

    def integral(self, t: Float[Array, " times"], decay: float = 0.0) -> Any:
        """int_0^t e^{-decay s} u(s) ds, (*b, times)."""
        ...

    def response(self, rates: Float[Array, "*r"], t: Float[Array, " times"]) -> Any:
        """y(t) = int_0^t e^{-a (t - s)} u(s) ds for every rate a >= 0, (*rb, times)."""
        ...

    def response_integral(self, rates: Float[Array, "*r"], t: Float[Array, " times"], decay: float = 0.0) -> Any:
        """int_0^t e^{-decay s} y(s) ds for every rate, (*rb, times)."""
        ...


@dataclass(frozen=True, eq=False)
class PiecewiseLinear:
    """u(t) linear between knots, zero before the first, held at the last value after the last. A doubled knot jumps.

    It equals itself alone, so that what is known of it can be kept by it.

    Args:
        times: knots, ascending (equal neighbours make a jump).
        values: u at the knots, last axis along the knots.
    """

    times: Float[Array, " knots"]
    values: Float[Array, "*b knots"]

    def __post_init__(self) -> None:
        if self.times.ndim != 1 or len(self.times) == 0 or self.values.shape[-1] != len(self.times):
            raise InputError(
                f"A piecewise-linear forcing needs as many values as knots; got {tuple(self.values.shape)} values "
                f"for {tuple(self.times.shape)} knots."
            )
        if bool((self.times[1:] < self.times[:-1]).any()):
            raise InputError("The knots of a piecewise-linear forcing must ascend; sort them first.")

    @property
    def knots(self) -> Any:
        return self.times

    @property
    def tensors(self) -> PiecewiseLinear:
        """The same lines, as tensors."""
        import torch

        return PiecewiseLinear(torch.as_tensor(self.times), torch.as_tensor(self.values))

    def __call__(self, t: Array) -> Any:
        lines, t = self._beside(t)
        if lines._xp is np and lines.values.ndim == 1:
            return np.interp(t, lines.times, lines.values, left=0.0)
        piece = lines._piece(t)
        return (lines.values[..., piece.index] + lines._slopes[..., piece.index] * piece.elapsed) * piece.started

    def integral(self, t: Array, decay: float = 0.0) -> Any:
        lines, t = self._beside(t)
        piece, weight = lines._piece(t), lines._xp.exp(-decay * lines.times)
        whole = lines._integrals(lines._steps, slice(None, -1), decay) * weight[:-1]
        partial = lines._integrals(piece.elapsed, piece.index, decay) * weight[piece.index]
        return (_running(whole)[..., piece.index] + partial) * piece.started

    def response(self, rates: Array, t: Array) -> Any:
        lines, a, t = self._beside(rates, t)
        if t is lines.times:
            return lines._at_knots(a[..., None])
        a, piece = a[..., None], lines._piece(t)
        carried = lines._at_knots(a)[..., piece.index] * lines._xp.exp(-a * piece.elapsed)
        return (carried + lines._fresh(a, piece.elapsed, piece.index)) * piece.started

    def response_integral(self, rates: Array, t: Array, decay: float = 0.0) -> Any:
        lines, a, t = self._beside(rates, t)
        piece, weight = lines._piece(t), lines._xp.exp(-decay * lines.times)
        states, areas = _walked(lines, a, decay) if lines._xp is np else lines._walk(a, decay)
        partial = lines._response_integrals(a[..., None], states[..., piece.index], piece.elapsed, piece.index, decay)
        return (areas[..., piece.index] + partial * weight[piece.index]) * piece.started

    def _walk(self, a: Any, decay: float) -> tuple[Any, Any]:
        """y and int_0^t e^{-decay s} y(s) ds at every knot, (*rb, knots)."""
        a, weight = a[..., None], self._xp.exp(-decay * self.times)
        states = self._at_knots(a)
        whole = self._response_integrals(a, states[..., :-1], self._steps, slice(None, -1), decay) * weight[:-1]
        return states, _running(whole)

    def _beside(self, *numbers: Any) -> tuple[Any, ...]:
        """The same lines and some numbers, all of them arrays or all of them tensors."""
        times, values, *others = alike(self.times, self.values, *numbers)
        same = times is self.times and values is self.values
        return self if same else PiecewiseLinear(times, values), *others

    @property
    def _xp(self) -> Any:
        return library(self.times)

    @property
    def _steps(self) -> Any:
        return self._xp.diff(self.times)

    @property
    def _slopes(self) -> Any:
        steps, xp = self._steps, self._xp
        slopes = xp.diff(self.values) / xp.where(steps > 0, steps, xp.ones_like(steps))
        return xp.concatenate([slopes * (steps > 0), xp.zeros_like(self.values[..., :1])], -1)

    def _piece(self, t: Any) -> _Piece:
        read = t if self._xp is np else t.detach().contiguous()
        index = self._xp.searchsorted(self.times, read, side="right") - 1
        started = index >= 0
        index = index.clip(min=0)
        return _Piece(index=index, elapsed=(t - self.times[index]) * started, started=started)

    def _integrals(self, elapsed: Any, at: Any, decay: float) -> Any:
        level, slope = self.values[..., at], self._slopes[..., at]
        constant = exp_divided_difference((0.0, -decay), elapsed)
        ramp = exp_divided_difference((0.0, -decay, -decay), elapsed)
        return level * constant + slope * ramp

    def _fresh(self, a: Any, elapsed: Any, at: Any) -> Any:
        """Response at the end of a piece to the input inside that piece alone."""
        level, slope = self.values[..., at], self._slopes[..., at]
        constant = exp_divided_difference((0.0, -a), elapsed)
        return level * constant + slope * exp_divided_difference((0.0, 0.0, -a), elapsed)

    def _at_knots(self, a: Any) -> Any:
        """y at every knot, y_{i+1} = e^{-a d_i} y_i + fresh_i (stable: all factors are <= 1)."""
        if self._xp is np and self.values.ndim == 1:
            return at_knots(self.times, self.values, a.ravel()).reshape(*a.shape[:-1], self.times.size)
        return linear_recurrence(self._xp.exp(-a * self._steps), self._fresh(a, self._steps, slice(None, -1)))

    def _response_integrals(self, a: Any, start: Any, elapsed: Any, at: Any, decay: float) -> Any:
        """int_0^elapsed e^{-decay s} y(s) ds inside pieces that begin at y = start."""
        level, slope = self.values[..., at], self._slopes[..., at]
        sunk = -(a + decay)
        return (
            start * exp_divided_difference((0.0, sunk), elapsed)
            + level * exp_divided_difference((0.0, -decay, sunk), elapsed)
            + slope * exp_divided_difference((0.0, -decay, -decay, sunk), elapsed)
        )


def _walked(lines: PiecewiseLinear, rates: Array, decay: float) -> tuple[Any, Any]:
    """What `_walk` finds in arrays; of tables the last are kept, since delays are tried one after another."""
    if rates.size > _TABLE:
        return lines._walk(rates, decay)
    return _kept_walk(lines, np.asarray(rates, np.float64).tobytes(), rates.shape, float(decay))


@lru_cache(maxsize=4)
def _kept_walk(lines: PiecewiseLinear, rates: bytes, shape: tuple[int, ...], decay: float) -> tuple[Any, Any]:
    return lines._walk(np.frombuffer(rates).reshape(shape), decay)


@dataclass(frozen=True)
class _Piece:
    index: Any
    elapsed: Any
    started: Any


def _running(pieces: Any) -> Any:
    xp = library(pieces)
    return xp.concatenate([xp.zeros_like(pieces.sum(-1)[..., None]), xp.cumsum(pieces, -1)], -1)


@dataclass(frozen=True)
class ExponentialSum:
    """u(t) = sum_j c_j s^{n_j} e^{l_j s} with s = t - onset >= 0, and zero before.

    Formulas are for simulation, where derivatives are wanted: they hold tensors, and answer with them.

    Args:
        coefficients: c_j, last axis over the terms.
        exponents: l_j (1/time), broadcastable against the coefficients.
        powers: n_j, small non-negative integers, one a term.
        onset: time of the start.
    """

    coefficients: Float[Tensor, "*b terms"]
    exponents: Float[Tensor, "*b terms"]
    powers: tuple[int, ...]
    onset: float = 0.0

    def __post_init__(self) -> None:
        if not len(self.powers) == self.coefficients.shape[-1] == self.exponents.shape[-1]:
            raise InputError(
                f"An exponential sum needs one coefficient, exponent and power a term; got "
                f"{self.coefficients.shape[-1]}, {self.exponents.shape[-1]} and {len(self.powers)}."
            )

    @property
    def knots(self) -> Tensor:
        return self.coefficients.new_tensor([self.onset])

    def __call__(self, t: Array) -> Tensor:
        elapsed, started = self._clock(t)
        return sum(c * elapsed**n * (e * elapsed).exp() for c, e, n in self._terms()) * started  # type: ignore[return-value]

    def integral(self, t: Array, decay: float = 0.0) -> Tensor:
        elapsed, started = self._clock(t)
        return math.exp(-decay * self.onset) * started * self._chain(elapsed, (0.0,), decay)

    def response(self, rates: Array, t: Array) -> Tensor:
        elapsed, started = self._clock(t)
        return started * self._chain(elapsed, (-self._tensor(rates)[..., None],), 0.0)

    def response_integral(self, rates: Array, t: Array, decay: float = 0.0) -> Tensor:
        elapsed, started = self._clock(t)
        sunk = -(self._tensor(rates)[..., None] + decay)
        return math.exp(-decay * self.onset) * started * self._chain(elapsed, (0.0, sunk), decay)

    def _tensor(self, numbers: Array) -> Tensor:
        return alike(numbers, self.coefficients)[0]

    def _clock(self, t: Array) -> tuple[Tensor, Tensor]:
        t = self._tensor(t)
        return (t - self.onset).clamp(min=0.0), (t >= self.onset).to(t.dtype)

    def _terms(self) -> list[tuple[Tensor, Tensor, int]]:
        return [(self.coefficients[..., j, None], self.exponents[..., j, None], n) for j, n in enumerate(self.powers)]

    def _chain(self, elapsed: Tensor, poles: tuple[Tensor | float, ...], decay: float) -> Any:
        parts = [
            c * math.factorial(n) * exp_divided_difference((*poles, *([e - decay] * (n + 1))), elapsed)
            for c, e, n in self._terms()
        ]
        return sum(parts[1:], parts[0])


@dataclass(frozen=True)
class Shifted:
    """u(t - delay): the same forcing, later (delay > 0) or earlier.

    Args:
        forcing: u, one forcing (its own batch is empty where `delay` is a batch).
        delay: time, or a batch of them (delays,): results then have an axis of delays before the one of times.
    """

    forcing: Forcing
    delay: float | Float[Array, " delays"]

    @property
    def knots(self) -> Any:
        knots, delay = self._beside(self.forcing.knots)
        moved = (knots + delay).reshape(-1)
        return moved[moved.argsort()]

    def __call__(self, t: Array) -> Any:
        return self._spread(self.forcing, t)

    def integral(self, t: Array, decay: float = 0.0) -> Any:
        return self._sunk(self._spread(lambda s: self.forcing.integral(s, decay), t), decay)

    def response(self, rates: Array, t: Array) -> Any:
        return self._spread(lambda s: self.forcing.response(rates, s), t)

    def response_integral(self, rates: Array, t: Array, decay: float = 0.0) -> Any:
        return self._sunk(self._spread(lambda s: self.forcing.response_integral(rates, s, decay), t), decay)

    def _beside(self, numbers: Array) -> tuple[Any, Any]:
        """Numbers along times, and the delay or a column of delays, both arrays or both tensors."""
        numbers, delay = alike(numbers, self.delay)
        return numbers, delay[..., None]

    def _sunk(self, values: Array, decay: float) -> Any:
        """Integrals that decay from injection on, of a forcing that starts later."""
        values, delay = self._beside(values)
        return library(values).exp(-decay * delay) * values

    def _spread(self, read: Callable[[Any], Any], t: Array) -> Any:
        t, delay = self._beside(t)
        shifted = t - delay
        values = read(shifted.reshape(-1))
        return values.reshape(*values.shape[:-1], *shifted.shape)
