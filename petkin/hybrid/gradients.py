"""Loss and gradients of a step: kernel by kernel, or, on a GPU, replayed as one graph of kernels.

A step launches thousands of small kernels, which takes a GPU far longer than what they do. Where all steps are alike,
they are recorded once and replayed together.

Reference: Nguyen V, Carilli M, Eryilmaz SB, et al. Accelerating PyTorch with CUDA graphs. pytorch.org, 2021.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from petkin.hybrid.episodes import Dataset
from petkin.hybrid.model import Encoded, Identifier
from petkin.hybrid.parallel import place
from petkin.hybrid.penalty import penalty
from petkin.hybrid.schedule import Settings, compared, frames_at, learning_rate
from petkin.hybrid.strategies import find_strategy

#: Steps that are done aside before one is recorded, in which libraries take their memory.
_ASIDE = 3


def loss_of(model: Identifier, batch: Dataset, k: int, settings: Settings, step: int) -> tuple[Tensor, Tensor, Tensor]:
    """What is minimised, the error in it, and the share of the observations' mean square that a prediction has."""
    with torch.no_grad():
        observed = model.task.emission.observe(batch.states)
    found = find_strategy(settings.strategy)(model.encode(observed), k, model.aggregate)
    count = frames_at(step, settings, len(model.task.times))
    predicted = model.predict(found, model.task.times[:count])
    some = compared(step, settings, count)
    error = model.squared_error(found, predicted[..., some, :], batch.states[..., :count, :][..., some, :]).mean()
    price = penalty(model, found, predicted, norm=settings.norm, orthogonality=settings.orthogonality)
    price = price * (learning_rate(step, settings) / settings.rate)
    return error + price, error, _light(model, found, predicted, observed[:1, :1, :count])


@torch.no_grad()
def _light(model: Identifier, found: Encoded, predicted: Tensor, observed: Tensor) -> Tensor:
    """Of the first series alone: it is a look, not a measurement."""
    seen = model.observe(replace(found, physics=found.physics[:1, :1]), predicted[:1, :1].detach())
    return seen.square().mean() / observed.square().mean().clamp_min(1e-30)


@dataclass(frozen=True)
class _Recorded:
    """A step's kernels, and where they read and write."""

    graph: torch.cuda.CUDAGraph
    states: Tensor
    said: Tensor
    gradients: list[Tensor | None]


class Gradients:
    """Puts the gradients of a step where the weights are.

    Args:
        model: whose weights.
        settings: of the training.
    """

    def __init__(self, model: Identifier, settings: Settings) -> None:
        self.model, self.settings = model, settings
        self._weights = list(model.parameters())
        self._recorded: dict[tuple[object, ...], _Recorded] = {}

    def __call__(self, mine: Iterable[tuple[Dataset, int]], step: int) -> Tensor:
        """Loss, error and light of this process's episodes, each with its k (3,): their part of the step's mean."""
        drawn = list(mine)
        if len(drawn) == 1 and self._alike(step):
            return self._replayed(*drawn[0], step).cpu()
        return self._computed(drawn, step).cpu()

    def _alike(self, step: int) -> bool:
        """Whether steps from here on launch the same kernels with the same numbers, on a GPU."""
        s, frames = self.settings, len(self.model.task.times)
        changing = s.norm or s.orthogonality or 0 < s.glimpse < frames
        return self.model.device.type == "cuda" and not changing and frames_at(step, s, frames) == frames

    def _computed(self, drawn: Sequence[tuple[Dataset, int]], step: int) -> Tensor:
        for weight in self._weights:
            weight.grad = None
        share = place()[1] / self.settings.episodes
        means = torch.zeros(3, device=self.model.device)
        for batch, k in drawn:
            loss, error, light = loss_of(self.model, batch, k, self.settings, step)
            (share * loss).backward()
            means = means + share * torch.stack([loss, error, light]).detach()
        return means

    def _replayed(self, batch: Dataset, k: int, step: int) -> Tensor:
        key = (k, batch.states.shape)
        if key not in self._recorded:
            self._recorded[key] = self._record(batch, k, step)
        found = self._recorded[key]
        found.states.copy_(batch.states)
        found.graph.replay()
        for weight, gradient in zip(self._weights, found.gradients, strict=True):
            weight.grad = gradient
        return found.said

    def _record(self, batch: Dataset, k: int, step: int) -> _Recorded:
        held = Dataset(batch.states.clone(), batch.truth)
        aside = torch.cuda.Stream(self.model.device)
        aside.wait_stream(torch.cuda.current_stream(self.model.device))
        with torch.cuda.stream(aside):
            for _ in range(_ASIDE):
                self._computed([(held, k)], step)
        torch.cuda.current_stream(self.model.device).wait_stream(aside)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            said = self._computed([(held, k)], step)
        return _Recorded(graph, held.states, said, [weight.grad for weight in self._weights])
