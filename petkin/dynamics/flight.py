"""Where a batch stands between its jumps, and how its guards are read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from petkin.dynamics.jumps import Jump


class Motion(Protocol):
    """The smooth motion between jumps."""

    @property
    def parameters(self) -> Float[Tensor, "*b p"]: ...

    @property
    def step(self) -> float:
        """Longest leg, the measure of what is short."""
        ...

    def rate(self, t: Float[Tensor, "*t"], state: Float[Tensor, "*b d"], /) -> Float[Tensor, "*b d"]:
        """dx/dt."""
        ...

    def flow(
        self, state: Float[Tensor, "*b d"], start: Float[Tensor, "*t"], duration: Float[Tensor, "*t"], /
    ) -> Float[Tensor, "*b d"]:
        """The state `duration` after `start`, both a scalar or one an element."""
        ...


@dataclass(frozen=True)
class Flight:
    """Where a batch stands with its J guards.

    Args:
        time: now, float64; a scalar where all elements agree.
        state: x now.
        armed: the guard has been positive since its last hit.
        fresh: the jump has just happened and left its guard at zero up to rounding, so that its sign tells nothing.
        scale: largest |guard| seen, the measure of rounding.
        last: time of the last hit.
    """

    time: Float[Tensor, "*t"]
    state: Float[Tensor, "*b d"]
    armed: Bool[Tensor, "J ..."]
    fresh: Bool[Tensor, "J ..."]
    scale: Float[Tensor, "J ..."]
    last: Float[Tensor, "J ..."]


@torch.no_grad()
def take_off(jumps: tuple[Jump, ...], parameters: Float[Tensor, "*b p"], time: float, state: Tensor) -> Flight:
    """A batch at its start: a guard is armed where it is not negative."""
    now = torch.tensor(time, dtype=torch.float64, device=state.device)
    guards = torch.stack([guard_of(jump, now, state, parameters) for jump in jumps])
    none = torch.zeros_like(guards, dtype=torch.bool)
    never = torch.full(guards.shape, -torch.inf, dtype=torch.float64, device=state.device)
    return Flight(now, state, guards >= 0, none, guards.abs(), never)


def guard_of(jump: Jump, t: Tensor, state: Tensor, parameters: Tensor) -> Tensor:
    """The guard [*b] in the number type of the state."""
    return jump.guard(t.to(state.dtype), state, parameters)


def guard_and_slope(jump: Jump, motion: Motion, t: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
    """The guard and its derivative in time along the flow, without autograd history."""
    with torch.enable_grad():
        now = t.detach().to(state.dtype).expand(state.shape[:-1]).clone().requires_grad_()
        here = state.detach().requires_grad_()
        value = jump.guard(now, here, motion.parameters.detach())
        by_time, by_state = torch.autograd.grad(value.sum(), (now, here), allow_unused=True, materialize_grads=True)
    with torch.no_grad():
        return value.detach(), by_time + (by_state * motion.rate(t.detach(), state.detach())).sum(dim=-1)
