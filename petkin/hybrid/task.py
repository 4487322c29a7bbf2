"""What is to be identified: a system known in part, seen through an emission, at given times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from petkin.dynamics import ParameterSet, VectorField
from petkin.errors import InputError
from petkin.hybrid.flow import Flow, RungeKutta
from petkin.hybrid.residual import Residual


class Emission(Protocol):
    """What is observed of a trajectory: images, frame means, the states themselves."""

    def observe(self, states: Float[Tensor, "*b T d"], /) -> Tensor:
        """Observations [*b, T, ...], differentiable; that at a time shows the state at that time alone."""
        ...

    def squared_error(
        self, predicted: Float[Tensor, "*b T d"], actual: Float[Tensor, "*b T d"], /
    ) -> Float[Tensor, "*b T"]:
        """Mean squared difference of the observations of two trajectories, a value a time."""
        ...


@dataclass(frozen=True)
class Task:
    """A system to identify.

    Args:
        name: what to call it.
        states: names of the d components of z.
        times: of the frames (T,), in the system's unit; the first is the start.
        parameters: c_p with bounds a little wider than what is expected.
        known: f_PHY, or None for a purely neural derivative.
        residual: f_NN, or None for pure physics.
        emission: what is observed.
        centre, reach: z at the start is centre + reach x (a number of order one); reach 0 holds a state.
        flow: how states are carried from frame to frame.
        start: observed series [n, T, ...] -> z at the start [n, d], where it is known; else it is encoded.
        seen: components that observations show, whose errors are measured apart: a velocity that flips at a wall is
            wrong by twice itself for a hit that is a hair late.
        meant: what of c_p acts, where not all of it does (of a direction, not its length); for measuring.
        missing: (states, full parameters) -> what f_NN should find, a row for each of the residual's; for measuring.
    """

    name: str
    states: tuple[str, ...]
    times: Float[Tensor, " T"]
    parameters: ParameterSet
    known: VectorField | None
    residual: Residual | None
    emission: Emission
    centre: Float[Tensor, " d"]
    reach: Float[Tensor, " d"]
    flow: Flow = field(default_factory=RungeKutta)
    start: Callable[[Tensor], Tensor] | None = None
    missing: Callable[[Tensor, Tensor], Tensor] | None = None
    seen: tuple[int, ...] = ()
    meant: Callable[[Tensor], Tensor] | None = None

    def to(self, device: torch.device | str) -> Task:
        """The same with its tensors on another device."""
        return replace(self, times=self.times.to(device), centre=self.centre.to(device), reach=self.reach.to(device))

    def __post_init__(self) -> None:
        if self.known is None and self.residual is None:
            raise InputError(f"{self.name}: neither known physics nor a residual; there is nothing to integrate.")
        if len(self.centre) != len(self.states) or len(self.reach) != len(self.states):
            raise InputError(
                f"{self.name}: {len(self.states)} states but {len(self.centre)} centres and {len(self.reach)} reaches."
            )
