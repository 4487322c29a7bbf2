"""What every plasma-input compartment model is here: a sum of exponentials convolved with the plasma, plus blood.

    C_T(t)   = sum_i phi_i e^{-a_i t} * C_P(t),  phi_i >= 0, a_i >= 0        tissue
    C(t)     = (1 - vB) C_T(t) + vB C_B(t)                                   what a voxel holds

Where vessel walls trap tracer as well, blood is not C_B alone but C_B(t) + Kb int_0^t C_P ds.

A model is one `CompartmentModel`: its parameters, the map from rate constants to (phi, a) and back, its differential
equation and its macro-parameters. The maps are plain arithmetic, so that they serve torch (gradients), numpy, and
complex numbers (derivatives by complex step) alike.

References: Gunn RN, Gunn SR, Cunningham VJ. Positron emission tomography compartmental models. J Cereb Blood Flow
Metab 2001;21:635-652. doi:10.1097/00004647-200106000-00002. Symbols: Innis RB et al. J Cereb Blood Flow Metab
2007;27:1533-1539. doi:10.1038/sj.jcbfm.9600493.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from petkin.dynamics import Forcing, Parameter, ParameterSet, System
from petkin.dynamics.arrays import alike
from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction

if TYPE_CHECKING:
    from jaxtyping import Float
    from torch import Tensor

#: One exponential of the impulse response: (amplitude phi, rate a).
Exponential = tuple[Any, Any]

#: Blood volume fraction, the last parameter of every model here.
BLOOD_VOLUME = Parameter("vB", "1", start=0.05, lower=0.0, upper=1.0, meaning="fraction of the volume that is blood")


@dataclass(frozen=True)
class Macro:
    """A quantity that follows from the rate constants: symbol, unit, formula over them, meaning."""

    symbol: str
    unit: str
    formula: Callable[..., Any]
    meaning: str


@dataclass(frozen=True)
class CompartmentModel:
    """A compartment model with plasma input and blood volume.

    Args:
        label: BEP023 model label.
        name: what it is called in full.
        equation: the differential equation as text.
        reference: where it comes from.
        parameters: rate constants of the tissue in order, then Kb where vessel walls trap, then vB.
        states: names of the compartments.
        free_rates: how many a_i are free.
        trapping: whether one more exponential has a = 0 (irreversible uptake).
        impulse: rate constants -> exponentials, fastest first.
        invert: exponentials, fastest first -> rate constants.
        field: (state[*b, d], plasma[*b], rate constants[*b, P - 1]) -> d state/dt[*b, d].
        macros: derived quantities, from the rate constants of the tissue.
        wall: whether vessel walls trap tracer, at a rate Kb.
    """

    label: str
    name: str
    equation: str
    reference: str
    parameters: ParameterSet
    states: tuple[str, ...]
    free_rates: int
    trapping: bool
    impulse: Callable[..., tuple[Exponential, ...]]
    invert: Callable[..., tuple[Any, ...]]
    field: Callable[[Tensor, Tensor, Tensor], Tensor]
    macros: tuple[Macro, ...]
    wall: bool = False

    @property
    def rates(self) -> int:
        """How many parameters are rate constants of the tissue; they come first."""
        return len(self.parameters) - 1 - self.wall

    @property
    def quantities(self) -> tuple[Parameter | Macro, ...]:
        """All that a fit reports: parameters, then macro-parameters, each with symbol, unit and meaning."""
        return (*self.parameters, *self.macros)

    @property
    def system(self) -> System:
        """The tissue for `petkin.dynamics.solve`: states C_i from zero, forcing C_P, parameters the rate constants."""

        def field(t: Tensor, state: Tensor, plasma: Tensor | None, p: Tensor) -> Tensor:
            return self.field(state, state.new_zeros(()) if plasma is None else plasma, p)

        rates = ParameterSet(self.parameters.members[: self.rates])
        initial = (0.0,) * len(self.states)
        return System(self.label, self.states, rates, field, initial)

    def exponentials(self, parameters: Float[Tensor, "*b P"]) -> tuple[Float[Tensor, "*b m"], Float[Tensor, "*b m"]]:
        """phi_i (mL/cm3/min) and a_i (1/min) of the tissue's impulse response."""
        import torch

        pairs = self.impulse(*parameters[..., : self.rates].unbind(-1))
        shape = parameters.shape[:-1]
        phi = torch.stack([torch.as_tensor(p, dtype=parameters.dtype).expand(shape) for p, _ in pairs], dim=-1)
        rate = torch.stack([torch.as_tensor(a, dtype=parameters.dtype).expand(shape) for _, a in pairs], dim=-1)
        return phi, rate

    def tissue(self, parameters: Float[Tensor, "*b P"], plasma: Forcing, t: Float[Tensor, " times"]) -> Tensor:
        """C_T(t), kBq/mL, exact for the given forcing; shape (*b, times)."""
        phi, rate = self.exponentials(parameters)
        return (phi[..., None] * plasma.response(rate, t)).sum(dim=-2)

    def curve(self, parameters: Float[Tensor, "*b P"], arterial: InputFunction, t: Float[Tensor, " times"]) -> Tensor:
        """C(t), kBq/mL; shape (*b, times)."""
        vB, blood = parameters[..., -1:], arterial.whole_blood(t)
        if self.wall:
            blood = blood + parameters[..., -2:-1] * arterial.plasma.integral(t)
        return (1.0 - vB) * self.tissue(parameters, arterial.plasma, t) + vB * blood

    def frame_values(
        self, parameters: Float[Tensor, "*b P"], arterial: InputFunction, observation: FrameObservation
    ) -> Float[Tensor, "*b frames"]:
        """What the frames report of C(t), kBq/mL."""
        phi, rate = self.exponentials(parameters)
        vB = parameters[..., -1:]
        tissue = (phi[..., None] * observation.of_response(arterial.plasma, rate)).sum(dim=-2)
        blood = alike(observation.of_forcing(arterial.whole_blood), vB)[0]
        if self.wall:
            blood = blood + parameters[..., -2:-1] * observation.of_response(arterial.plasma, alike(0.0, rate)[0])
        return (1.0 - vB) * tissue + vB * blood

    def macro(self, parameters: Float[Tensor, "*b P"]) -> dict[str, Tensor]:
        """Macro-parameters by symbol, each of shape (*b)."""
        rates = parameters[..., : self.rates].unbind(-1)
        return {m.symbol: m.formula(*rates) for m in self.macros}
