"""The paper's form of training, step by step as it is written: the baseline of `petkin-bench speed train`.

Every query brings k context series of its own, all of which are encoded for it alone; the rollout is eager; the error
is taken between pictures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor, nn

from petkin.hybrid import Dataset, Encoded, Identifier, RungeKutta, Settings

#: Context series of a query.
_CONTEXT = 7


class Naive(nn.Module):
    """An `Identifier`, used naively.

    Args:
        model: its parts.
        apart: a context encoder of its own for c_n, as the paper has it; None to take both codes from one.
    """

    def __init__(self, model: Identifier, apart: nn.Module | None) -> None:
        super().__init__()
        assert isinstance(model.task.flow, RungeKutta)
        model.task = replace(model.task, flow=RungeKutta(model.task.flow.substeps))
        self.model, self.apart = model, apart

    def forward(self, contexts: Float[Tensor, "q k T C H W"], queries: Float[Tensor, "q T C H W"]) -> Tensor:
        """Mean squared error of the predicted pictures of the queries."""
        model, flat = self.model, contexts.flatten(0, 1)
        assert model.to_code is not None and model.to_physics is not None  # noqa: PT018
        assert model.first is not None and model.to_initial is not None  # noqa: PT018
        features = model.context(flat)
        physics = model.lower + model.span * torch.sigmoid(model.to_physics(features))
        code = model.to_code(features if self.apart is None else self.apart(flat))
        initial = model.task.centre + model.task.reach * model.to_initial(model.first(queries))
        several = contexts.shape[:2]
        found = Encoded(initial, physics.unflatten(0, several).mean(1), code.unflatten(0, several).mean(1))
        return (model.task.emission.observe(model.predict(found)) - queries).square().mean()


def train_naive(naive: Naive, data: Dataset, settings: Settings, progress: Callable[[int, float], None]) -> None:
    """Train on pictures that are all drawn beforehand, at a constant rate."""
    pictures = naive.model.task.emission.observe(data.states)
    optimiser = torch.optim.Adam(naive.parameters(), lr=settings.rate)
    generator = torch.Generator().manual_seed(settings.seed)
    for step in range(1, settings.steps + 1):
        chosen = torch.randint(data.dynamics, (settings.dynamics * settings.series,), generator=generator)
        order = torch.stack([torch.randperm(data.series, generator=generator)[: _CONTEXT + 1] for _ in chosen])
        series = pictures[chosen[:, None], order]
        loss = naive(series[:, 1:], series[:, 0])
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(naive.parameters(), settings.clip)
        optimiser.step()
        progress(step, float(loss.detach()))
