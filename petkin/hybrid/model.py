"""The whole that is trained: encoders that identify, a field that is known in part, a flow that predicts."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

from petkin.dynamics import VectorField
from petkin.errors import InputError
from petkin.hybrid.aggregate import Aggregate, mean
from petkin.hybrid.encoders import Head
from petkin.hybrid.field import HybridField
from petkin.hybrid.residual import Network
from petkin.hybrid.task import Task

#: Spread of the hypernetwork's last weights: codes change f_NN little at first.
_SPREAD = 0.05


@dataclass(frozen=True)
class Encoded:
    """What the encoders say of every series by itself.

    Args:
        initial: state at the start (*b, d).
        physics: c_p (*b, p).
        code: c_n (*b, q); q = 0 where f_NN is one for all.
    """

    initial: Float[Tensor, "*#b d"]
    physics: Float[Tensor, "*#b p"]
    code: Float[Tensor, "*#b q"]


class HyperNetwork(nn.Module):
    """c_n -> the weights of f_NN, as a straight line and what bends it. At the start one usual network close to zero.

    The straight part carries to codes beyond those of training: a force of another direction, a stronger damping.
    """

    def __init__(self, code: int, network: Network, generator: torch.Generator) -> None:
        super().__init__()
        sizes = (code, 16, 16, 16, 8)
        hidden = [layer for a, b in pairwise(sizes) for layer in (nn.Linear(a, b), nn.SiLU())]
        last = nn.Linear(sizes[-1], network.weights)
        self.layers = nn.Sequential(*hidden, last)
        self.straight = nn.Linear(code, network.weights, bias=False)
        with torch.no_grad():
            last.weight.normal_(0.0, _SPREAD, generator=generator)
            last.bias.copy_(network.draw(generator))
            self.straight.weight.normal_(0.0, _SPREAD, generator=generator)

    def forward(self, code: Float[Tensor, "*b q"]) -> Float[Tensor, "W ..."]:
        return (self.layers(code) + self.straight(code)).movedim(-1, 0)


class Identifier(nn.Module):
    """Encoders, hypernetwork (or one global f_NN) and flow of one task.

    Args:
        task: what is to be identified.
        context: encoder of a whole series, with `features`.
        first: encoder of its first frames, with `features`; None where the task knows the start.
        code: numbers in c_n; 0 for one f_NN of all dynamics.
        generator: draws the first weights of f_NN.
        aggregate: makes one c_p and c_n of those that several context series say.
        decoder: (states [*b, T, d], c_p [*b, p]) -> observations, learned in place of the task's emission.
    """

    def __init__(
        self,
        task: Task,
        context: nn.Module,
        first: nn.Module | None,
        *,
        code: int,
        generator: torch.Generator,
        aggregate: Aggregate = mean,
        decoder: nn.Module | None = None,
    ) -> None:
        super().__init__()
        if (first is None) != (task.start is not None):
            raise InputError(f"{task.name}: the start is either known to the task or read by an encoder of frames.")
        self.task, self.context, self.first = task, context, first
        self.aggregate, self.decoder = aggregate, decoder
        self.to_initial = Head(int(first.features), len(task.states)) if first else None  # type: ignore[arg-type]
        features, count = int(context.features), len(task.parameters)  # type: ignore[arg-type]
        self.to_physics = Head(features, count) if count else None
        coded = code if task.residual is not None else 0
        self.to_code = Head(features, coded, scale=1.0) if coded else None
        self.hyper = HyperNetwork(coded, task.residual.network, generator) if task.residual and coded else None
        alone = task.residual is not None and not coded
        self.weights = nn.Parameter(task.residual.network.draw(generator)) if task.residual and alone else None
        self.lower: Tensor
        self.register_buffer("lower", torch.tensor(task.parameters.lower, dtype=torch.float32))
        self.span: Tensor
        self.register_buffer("span", torch.tensor(task.parameters.upper, dtype=torch.float32) - self.lower)

    @property
    def device(self) -> torch.device:
        return self.lower.device

    def place_on(self, device: torch.device | str) -> Identifier:
        """Move weights and task to a device; the model itself is returned."""
        self.task = self.task.to(device)
        return self.to(device)

    def encode(self, series: Float[Tensor, "*series"], *, batch: int = 2) -> Encoded:
        """What the encoders say of observed series (*b, T, ...); `batch` leading axes count them."""
        shape, flat = series.shape[:batch], series.flatten(0, batch - 1)
        features = self.context(flat)
        initial = self._initial(flat)
        physics = features[:, :0]
        if self.to_physics is not None:
            physics = self.lower + self.span * torch.sigmoid(self.to_physics(features))
        code = self.to_code(features) if self.to_code is not None else features[:, :0]
        return Encoded(*(part.unflatten(0, shape) for part in (initial, physics, code)))

    def _initial(self, series: Float[Tensor, "n T ..."]) -> Float[Tensor, "n d"]:
        if self.task.start is not None:
            return self.task.start(series)
        assert self.first is not None
        assert self.to_initial is not None
        return self.task.centre + self.task.reach * self.to_initial(self.first(series))

    def field(self, code: Float[Tensor, "*b q"]) -> VectorField:
        """The derivative that the codes stand for."""
        if self.task.residual is None:
            assert self.task.known is not None
            return self.task.known
        return HybridField(self.task.known, self.task.residual, self._weights(code))

    def _weights(self, code: Float[Tensor, "*b q"]) -> Float[Tensor, "W ..."]:
        """Weights of f_NN: as the hypernetwork writes them, or the same for all."""
        if self.hyper is not None:
            return self.hyper(code)
        assert self.weights is not None
        return self.weights.reshape(-1, *[1] * (code.ndim - 1))

    def predict(self, found: Encoded, times: Float[Tensor, " T"] | None = None) -> Float[Tensor, "*b T d"]:
        """States at the task's times (or at others) from initial states, parameters and codes."""
        times = self.task.times if times is None else times
        return self.task.flow(self.field(found.code), found.initial, found.physics, times)

    def observe(self, found: Encoded, states: Float[Tensor, "*b T d"]) -> Tensor:
        """What is observed of predicted states."""
        emission = self.task.emission
        return emission.observe(states) if self.decoder is None else self.decoder(states, found.physics)

    def squared_error(
        self, found: Encoded, predicted: Float[Tensor, "*b T d"], actual: Float[Tensor, "*b T d"]
    ) -> Float[Tensor, "*b T"]:
        """Mean squared difference of what is observed of predicted and of actual states, a value a time."""
        emission = self.task.emission
        if self.decoder is None:
            return emission.squared_error(predicted, actual)
        off = self.decoder(predicted, found.physics) - emission.observe(actual)
        return off.square().flatten(predicted.ndim - 1).mean(dim=-1)

    def residual(
        self, code: Float[Tensor, "*b q"], states: Float[Tensor, "*b T d"], physics: Float[Tensor, "*b p"]
    ) -> Float[Tensor, "r *b T"]:
        """f_NN along trajectories.

        Raises:
            ValueError: the task has none.
        """
        if self.task.residual is None:
            raise ValueError(f"{self.task.name} has no residual.")
        layers = self.task.residual.layers(self._weights(code)[..., None])
        seen = physics[..., None, :].expand(*states.shape[:-1], -1)
        return self.task.residual.value(layers, states, None, seen)
