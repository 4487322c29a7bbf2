"""What drives a system from outside: u(t), with exact responses of a first-order system to it.

A `Forcing` knows its knots (times where it is not smooth), its integral, and its response

    y(t) = int_0^t e^{-a (t - s)} u(s) ds,

which is all that an exact solution of a linear compartment system needs. Everything is batched and differentiable.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from petkin.dynamics.exponential import exp_divided_difference
from petkin.dynamics.recurrence import linear_recurrence
from petkin.errors import InputError


@runtime_checkable
class Forcing(Protocol):
    """An outside input u(t), zero before its onset; integrals and responses start there if it lies before time 0.

    Shapes: `*b` the batch of the forcing, `*r` of the rates, `*rb` both broadcast.
    """

    @property
    def knots(self) -> Float[Tensor, " knots"]:
        """Times at which u or a derivative of it jumps, ascending."""
        ...

    def __call__(self, t: Float[Tensor, " times"]) -> Float[Tensor, "*b times"]:
        """u(t)."""
        ...

    def integral(self, t: Float[Tensor, " times"], decay: float = 0.0) -> Float[Tensor, "*b times"]:
        """int_0^t e^{-decay s} u(s) ds."""
        ...

    def response(self, rates: Float[Tensor, "*r"], t: Float[Tensor, " times"]) -> Float[Tensor, "*rb times"]:
        """y(t) = int_0^t e^{-a (t - s)} u(s) ds for every rate a >= 0."""
        ...

    def response_integral(
        self, rates: Float[Tensor, "*r"], t: Float[Tensor, " times"], decay: float = 0.0
    ) -> Float[Tensor, "*rb times"]:
        """int_0^t e^{-decay s} y(s) ds for every rate."""
        ...


@dataclass(frozen=True)
class PiecewiseLinear:
    """u(t) linear between knots, zero before the first, held at the last value after the last. A doubled knot jumps.

    Args:
        times: knots, ascending (equal neighbours make a jump).
        values: u at the knots, last axis along the knots.
    """

    times: Float[Tensor, " knots"]
    values: Float[Tensor, "*b knots"]

    def __post_init__(self) -> None:
        if self.times.ndim != 1 or self.times.numel() == 0 or self.values.shape[-1] != self.times.numel():
            raise InputError(
                f"A piecewise-linear forcing needs as many values as knots; got {tuple(self.values.shape)} values "
                f"for {tuple(self.times.shape)} knots."
            )
        if bool((torch.diff(self.times) < 0).any()):
            raise InputError("The knots of a piecewise-linear forcing must ascend; sort them first.")

    @property
    def knots(self) -> Tensor:
        return self.times

    def __call__(self, t: Tensor) -> Tensor:
        piece = self._piece(t)
        return (self.values[..., piece.index] + self._slopes[..., piece.index] * piece.elapsed) * piece.started

    def integral(self, t: Tensor, decay: float = 0.0) -> Tensor:
        whole = self._integrals(self._steps, slice(None, -1), decay) * torch.exp(-decay * self.times[:-1])
        piece = self._piece(t)
        partial = self._integrals(piece.elapsed, piece.index, decay) * torch.exp(-decay * self.times[piece.index])
        return (_running(whole)[..., piece.index] + partial) * piece.started

    def response(self, rates: Tensor, t: Tensor) -> Tensor:
        a = torch.as_tensor(rates)[..., None]
        piece = self._piece(t)
        carried = self._at_knots(a)[..., piece.index] * torch.exp(-a * piece.elapsed)
        return (carried + self._fresh(a, piece.elapsed, piece.index)) * piece.started

    def response_integral(self, rates: Tensor, t: Tensor, decay: float = 0.0) -> Tensor:
        a = torch.as_tensor(rates)[..., None]
        knots = self._at_knots(a)
        whole = self._response_integrals(a, knots[..., :-1], self._steps, slice(None, -1), decay)
        running = _running(whole * torch.exp(-decay * self.times[:-1]))
        piece = self._piece(t)
        partial = self._response_integrals(a, knots[..., piece.index], piece.elapsed, piece.index, decay)
        return (running[..., piece.index] + partial * torch.exp(-decay * self.times[piece.index])) * piece.started

    @property
    def _steps(self) -> Tensor:
        return torch.diff(self.times)

    @property
    def _slopes(self) -> Tensor:
        steps = self._steps
        slopes = torch.diff(self.values, dim=-1) / torch.where(steps > 0, steps, torch.ones_like(steps))
        return torch.cat([slopes * (steps > 0), torch.zeros_like(self.values[..., :1])], dim=-1)

    def _piece(self, t: Tensor) -> _Piece:
        index = torch.searchsorted(self.times, t.detach().contiguous(), right=True) - 1
        started = (index >= 0).to(t.dtype)
        index = index.clamp(min=0)
        return _Piece(index=index, elapsed=(t - self.times[index]) * started, started=started)

    def _integrals(self, elapsed: Tensor, at: Tensor | slice, decay: float) -> Tensor:
        level, slope = self.values[..., at], self._slopes[..., at]
        constant = exp_divided_difference((0.0, -decay), elapsed)
        ramp = exp_divided_difference((0.0, -decay, -decay), elapsed)
        return level * constant + slope * ramp

    def _fresh(self, a: Tensor, elapsed: Tensor, at: Tensor | slice) -> Tensor:
        """Response at the end of a piece to the input inside that piece alone."""
        level, slope = self.values[..., at], self._slopes[..., at]
        constant = exp_divided_difference((0.0, -a), elapsed)
        return level * constant + slope * exp_divided_difference((0.0, 0.0, -a), elapsed)

    def _at_knots(self, a: Tensor) -> Tensor:
        """y at every knot, y_{i+1} = e^{-a d_i} y_i + fresh_i (stable: all factors are <= 1)."""
        return linear_recurrence(torch.exp(-a * self._steps), self._fresh(a, self._steps, slice(None, -1)))

    def _response_integrals(
        self, a: Tensor, start: Tensor, elapsed: Tensor, at: Tensor | slice, decay: float
    ) -> Tensor:
        """int_0^elapsed e^{-decay s} y(s) ds inside pieces that begin at y = start."""
        level, slope = self.values[..., at], self._slopes[..., at]
        sunk = -(a + decay)
        return (
            start * exp_divided_difference((0.0, sunk), elapsed)
            + level * exp_divided_difference((0.0, -decay, sunk), elapsed)
            + slope * exp_divided_difference((0.0, -decay, -decay, sunk), elapsed)
        )


@dataclass(frozen=True)
class _Piece:
    index: Tensor
    elapsed: Tensor
    started: Tensor


def _running(pieces: Tensor) -> Tensor:
    return torch.cat([pieces.new_zeros(*pieces.shape[:-1], 1), torch.cumsum(pieces, dim=-1)], dim=-1)


@dataclass(frozen=True)
class ExponentialSum:
    """u(t) = sum_j c_j s^{n_j} e^{l_j s} with s = t - onset >= 0, and zero before.

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

    def __call__(self, t: Tensor) -> Tensor:
        elapsed, started = self._clock(t)
        return sum(c * elapsed**n * torch.exp(e * elapsed) for c, e, n in self._terms()) * started  # type: ignore[return-value]

    def integral(self, t: Tensor, decay: float = 0.0) -> Tensor:
        elapsed, started = self._clock(t)
        return math.exp(-decay * self.onset) * started * self._chain(elapsed, (0.0,), decay)

    def response(self, rates: Tensor, t: Tensor) -> Tensor:
        elapsed, started = self._clock(t)
        return started * self._chain(elapsed, (-torch.as_tensor(rates)[..., None],), 0.0)

    def response_integral(self, rates: Tensor, t: Tensor, decay: float = 0.0) -> Tensor:
        elapsed, started = self._clock(t)
        sunk = -(torch.as_tensor(rates)[..., None] + decay)
        return math.exp(-decay * self.onset) * started * self._chain(elapsed, (0.0, sunk), decay)

    def _clock(self, t: Tensor) -> tuple[Tensor, Tensor]:
        return (t - self.onset).clamp(min=0.0), (t >= self.onset).to(t.dtype)

    def _terms(self) -> list[tuple[Tensor, Tensor, int]]:
        return [(self.coefficients[..., j, None], self.exponents[..., j, None], n) for j, n in enumerate(self.powers)]

    def _chain(self, elapsed: Tensor, poles: tuple[Tensor | float, ...], decay: float) -> Tensor:
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
    delay: float | Float[Tensor, " delays"]

    @property
    def knots(self) -> Tensor:
        knots = self.forcing.knots
        return torch.sort((knots + self._column(knots)).flatten()).values

    def __call__(self, t: Tensor) -> Tensor:
        return self._spread(self.forcing, t)

    def integral(self, t: Tensor, decay: float = 0.0) -> Tensor:
        return self._sunk(t, decay) * self._spread(lambda s: self.forcing.integral(s, decay), t)

    def response(self, rates: Tensor, t: Tensor) -> Tensor:
        return self._spread(lambda s: self.forcing.response(rates, s), t)

    def response_integral(self, rates: Tensor, t: Tensor, decay: float = 0.0) -> Tensor:
        return self._sunk(t, decay) * self._spread(lambda s: self.forcing.response_integral(rates, s, decay), t)

    def _column(self, like: Tensor) -> Tensor:
        return torch.as_tensor(self.delay, dtype=like.dtype, device=like.device)[..., None]

    def _sunk(self, t: Tensor, decay: float) -> Tensor:
        return torch.exp(-decay * self._column(t))

    def _spread(self, read: Callable[[Tensor], Tensor], t: Tensor) -> Tensor:
        shifted = t - self._column(t)
        values = read(shifted.flatten())
        return values.reshape(*values.shape[:-1], *shifted.shape)
