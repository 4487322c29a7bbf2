"""f_NN: the unknown part of a system's derivative, a small network whose weights are an argument.

    f_NN(z; w) = A tanh(N(s(z); w) / A),    N: Linear, SiLU, ... Linear

Weights come last-but-batch, [W, *b], so that every element of a batch may have a network of its own: a layer is
y_o = sum_i w_oi x_i + v_o with all three [.., *b]. The bound A keeps a derivative that feeds back on itself from
leaving the numbers; what is far below it is not changed.

Reference: Ye Y et al. Unsupervised learning of hybrid latent dynamics: a learn-to-identify framework.
arXiv:2403.08194, appendix D.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import silu

from petkin.errors import InputError

#: What f_NN sees: (state[*b, d], forcing[*b] or None, parameters[*b, p]) -> inputs of order one [i, *b].
Sight = Callable[[Tensor, Tensor | None, Tensor], Tensor]
#: Where f_NN acts: (f_NN [r, *b], state [*b, d]) -> what is added to the derivative [*b, d], linear in f_NN.
Action = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class Network:
    """Sizes of a fully connected network whose weights are given.

    Args:
        inputs, outputs: how many numbers go in and come out.
        width: of the hidden layers.
        depth: how many of them.
    """

    inputs: int
    outputs: int
    width: int = 8
    depth: int = 4

    @property
    def sizes(self) -> tuple[tuple[int, int], ...]:
        """(out, in) of every layer."""
        widths = (self.inputs, *[self.width] * self.depth, self.outputs)
        return tuple((after, before) for before, after in pairwise(widths))

    @property
    def weights(self) -> int:
        """How many weights and biases there are."""
        return sum(out * (into + 1) for out, into in self.sizes)

    def layers(self, weights: Float[Tensor, "W ..."]) -> tuple[tuple[Tensor, Tensor], ...]:
        """Matrices [out, in, *b] and biases [out, *b], views of the weights."""
        if len(weights) != self.weights:
            raise InputError(f"A network of {self.weights} weights was given {len(weights)}.")
        parts, first = [], 0
        for out, into in self.sizes:
            matrix = weights[first : first + out * into].unflatten(0, (out, into))
            first += out * into
            parts.append((matrix, weights[first : first + out]))
            first += out
        return tuple(parts)

    def draw(self, generator: torch.Generator, *, last: float = 0.1) -> Float[Tensor, " W"]:
        """Usual random weights, those of the last layer times `last`: a network that starts near zero."""
        drawn = []
        for i, (out, into) in enumerate(self.sizes):
            scale = math.sqrt(1.0 / into) * (last if i == self.depth else 1.0)
            drawn.append((2.0 * torch.rand(out * (into + 1), generator=generator) - 1.0) * scale)
        return torch.cat(drawn)


def run_layers(layers: tuple[tuple[Tensor, Tensor], ...], inputs: Float[Tensor, "i ..."]) -> Float[Tensor, "o ..."]:
    """N(inputs; w). Weights [.., *b, 1] serve all points of the inputs' last axis, by products of matrices."""
    if inputs.shape[-1] > 1 and inputs.ndim > 1 and all(matrix.shape[-1] == 1 for matrix, _ in layers):
        return _run_along(layers, inputs)
    x = inputs
    for matrix, bias in layers[:-1]:
        x = silu((matrix * x).sum(dim=1) + bias)
    matrix, bias = layers[-1]
    return (matrix * x).sum(dim=1) + bias


def _run_along(layers: tuple[tuple[Tensor, Tensor], ...], inputs: Float[Tensor, "i *b n"]) -> Float[Tensor, "o *b n"]:
    x = inputs.movedim(0, -2).contiguous()
    for index, (matrix, bias) in enumerate(layers):
        x = matrix[..., 0].movedim((0, 1), (-2, -1)).contiguous() @ x + bias.movedim(0, -2)
        x = silu(x) if index < len(layers) - 1 else x
    return x.movedim(-2, 0)


@dataclass(frozen=True)
class Residual:
    """What f_NN sees, where it acts, and how large it may be.

    Args:
        sees: its inputs, scaled to order one.
        inputs: how many they are.
        outputs: numbers of f_NN.
        acts: how they enter the derivative; see `into_rows`.
        bound: A, in the units of the derivative: a few times what is plausible.
        width, depth: of the hidden layers.
        rests: whether f_NN is nought where all its inputs are, A tanh((N(s) - N(0)) / A): of nothing comes nothing.
    """

    sees: Sight
    inputs: int
    outputs: int
    acts: Action
    bound: float
    width: int = 8
    depth: int = 4
    rests: bool = False

    @property
    def network(self) -> Network:
        return Network(self.inputs, self.outputs, self.width, self.depth)

    def layers(self, weights: Float[Tensor, "W ..."]) -> tuple[tuple[Tensor, Tensor], ...]:
        """Layers of N; where f_NN rests, with the last bias at which N(0) is nought, whatever the one that is given."""
        layers = self.network.layers(weights)
        if not self.rests:
            return layers
        *first, (matrix, bias) = layers
        nothing = bias.new_zeros(self.inputs, *[1] * (bias.ndim - 1))
        return (*first, (matrix, -run_layers((*first, (matrix, torch.zeros_like(bias))), nothing)))

    def value(
        self, layers: tuple[tuple[Tensor, Tensor], ...], state: Tensor, forcing: Tensor | None, parameters: Tensor
    ) -> Float[Tensor, "r ..."]:
        """f_NN, of the weights' `layers`."""
        value = run_layers(layers, self.sees(state, forcing, parameters))
        return self.bound * torch.tanh(value / self.bound)

    def rows(
        self, layers: tuple[tuple[Tensor, Tensor], ...], state: Tensor, forcing: Tensor | None, parameters: Tensor
    ) -> tuple[Tensor, ...]:
        """The same row by row, of which each knows what it alone comes from."""
        return self.value(layers, state, forcing, parameters).unbind()


def into_rows(*rows: int) -> Action:
    """f_NN adds to the derivatives of these states; the others keep theirs: phi' is the velocity, whatever it says."""

    def acts(value: Tensor, state: Tensor) -> Tensor:
        unit = torch.eye(state.shape[-1], dtype=state.dtype, device=state.device)
        columns = torch.stack([unit[row] for row in rows])
        return value.movedim(0, -1) @ columns

    return acts
