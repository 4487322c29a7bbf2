"""A derivative that is known in part: dz/dt = f_PHY(z; c_p) + f_NN(z; c_n)."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from petkin.dynamics import VectorField
from petkin.hybrid.residual import Residual


@dataclass(frozen=True)
class HybridField:
    """A known derivative plus a residual; itself a `VectorField`. Where the residual is zero, it is `known` to the bit.

    Args:
        known: f_PHY, or None where nothing is known.
        residual: f_NN.
        weights: of f_NN, [W, *b], or [W, 1] for one network of all.
    """

    known: VectorField | None
    residual: Residual
    weights: Float[Tensor, "W ..."]

    def __post_init__(self) -> None:
        object.__setattr__(self, "layers", self.residual.layers(self.weights))

    def __call__(
        self,
        t: Float[Tensor, "*t"],
        state: Float[Tensor, "*b d"],
        forcing: Float[Tensor, "*b"] | None,
        parameters: Float[Tensor, "*b p"],
        /,
    ) -> Float[Tensor, "*b d"]:
        added = self.residual.value(self.layers, state, forcing, parameters)  # type: ignore[attr-defined]
        added = self.residual.acts(added, state)
        return added if self.known is None else self.known(t, state, forcing, parameters) + added
