"""State-triggered jumps: what they are, and the record of those that happened."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from torch import Tensor


@dataclass(frozen=True)
class Jump:
    """An event: where `guard` falls from positive through zero, the state becomes `reset` of itself.

    Both take (t, state[*b, d], parameters[*b, p]) with t a scalar or one time an element; the guard returns [*b], the
    reset [*b, d]. A reset that leaves the guard at zero (a bounce, a kick) fires again only after the guard has been
    positive; one that throws the state through another armed guard fires that one at once.

    Args:
        name: what to call it in messages.
        guard: smooth where it vanishes.
        reset: the state right after.
    """

    name: str
    guard: Callable[[Tensor, Tensor, Tensor], Tensor]
    reset: Callable[[Tensor, Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class Hits:
    """The jumps that happened, those of one element in order of time.

    Args:
        time: when; differentiable.
        element: which element of the batch, counted in row-major order.
        jump: which jump of the system.
    """

    time: Float[Tensor, " hits"]
    element: Int[Tensor, " hits"]
    jump: Int[Tensor, " hits"]
