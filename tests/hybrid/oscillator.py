"""A small task for the tests: an oscillator of unknown frequency whose damping is not known, seen as it is."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from petkin.dynamics import Parameter, ParameterSet
from petkin.hybrid import Curve, Dataset, Identifier, Residual, RungeKutta, Task, into_rows

FRAMES = 8


def known(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    place, speed = state.unbind(-1)
    return torch.stack([speed, -p[..., 0] * place], dim=-1)


def full(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    place, speed = state.unbind(-1)
    return torch.stack([speed, -p[..., 0] * place - p[..., 1] * speed], dim=-1)


RESIDUAL = Residual(lambda state, forcing, p: state[..., 1][None], 1, 1, into_rows(1), bound=5.0)


class AsItIs:
    """The states themselves."""

    def observe(self, states: Tensor) -> Tensor:
        return states

    def squared_error(self, predicted: Tensor, actual: Tensor) -> Tensor:
        return ((predicted - actual) ** 2).mean(dim=-1)


class Flat(nn.Module):
    """The first frames of a series as one row of numbers."""

    def __init__(self, frames: int) -> None:
        super().__init__()
        self.curve, self.frames = Curve(2 * frames, (16, 8)), frames
        self.features = self.curve.features

    def forward(self, series: Tensor) -> Tensor:
        return self.curve(series[:, : self.frames].flatten(1))


def task(*, residual: Residual | None = RESIDUAL) -> Task:
    return Task(
        name="oscillator",
        states=("x", "v"),
        times=torch.arange(FRAMES) * 0.4,
        parameters=ParameterSet((Parameter("w2", "1/s^2", 2.0, 0.5, 4.0),)),
        known=known,
        residual=residual,
        emission=AsItIs(),
        centre=torch.zeros(2),
        reach=torch.ones(2),
        missing=lambda states, p: (-p[..., 1] * states[..., 1])[None],
    )


def make(seed: int, *, code: int = 3, residual: Residual | None = RESIDUAL) -> Identifier:
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    return Identifier(task(residual=residual), Flat(FRAMES), Flat(2), code=code, generator=generator)


def data(dynamics: int = 12, series: int = 6, seed: int = 0) -> Dataset:
    generator = torch.Generator().manual_seed(seed)
    truth = torch.rand(dynamics, 2, generator=generator) * torch.tensor([2.0, 0.8]) + torch.tensor([1.0, 0.1])
    start = torch.rand(dynamics * series, 2, generator=generator) * 2.0 - 1.0
    states = RungeKutta(8)(full, start, truth.repeat_interleave(series, 0), task().times)
    return Dataset(states.unflatten(0, (dynamics, series)), truth)
