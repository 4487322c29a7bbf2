"""A system of ordinary differential equations: what it is called, what it depends on, how it moves, where it jumps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from petkin.dynamics.jumps import Jump
from petkin.dynamics.parameters import ParameterSet
from petkin.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float
    from torch import Tensor


class VectorField(Protocol):
    """The right-hand side of dx/dt = f(t, x, u(t), p). Any function, or module, of these four arguments will do.

    It must treat the elements of the batch one by one, whatever the batch's shape: that is what lets each of them hit
    its own wall at its own time.
    """

    def __call__(
        self,
        t: Float[Tensor, "*t"],
        state: Float[Tensor, "*b d"],
        forcing: Float[Tensor, "*b"] | None,
        parameters: Float[Tensor, "*b p"],
        /,
    ) -> Float[Tensor, "*b d"]:
        """dx/dt.

        Args:
            t: time; a scalar, or one time an element of the batch.
            state: x.
            forcing: u(t), or None for a system that nothing drives.
            parameters: p, in the order of the system's `ParameterSet`.
        """
        ...


@dataclass(frozen=True)
class System:
    """dx/dt = f(t, x, u(t), p) from an initial state, with jumps.

    Args:
        name: what to call it in messages and tables.
        states: names of the components of x.
        parameters: symbol, unit, start and bounds of every p.
        field: f.
        initial: x at the start, unless a solution says otherwise.
        jumps: events that change the state at once (a wall, a dose).
    """

    name: str
    states: tuple[str, ...]
    parameters: ParameterSet
    field: VectorField
    initial: tuple[float, ...]
    jumps: tuple[Jump, ...] = ()

    def __post_init__(self) -> None:
        if len(self.initial) != len(self.states):
            raise InputError(
                f"{self.name}: {len(self.states)} states ({', '.join(self.states)}) but {len(self.initial)} initial "
                "values; give one of each."
            )
