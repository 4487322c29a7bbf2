"""Series grouped by the dynamics behind them, and the episodes that training draws from them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from petkin.errors import InputError
from petkin.hybrid.aggregate import Aggregate, mean


@dataclass(frozen=True)
class Dataset:
    """M dynamics with S series each: the true states, from which observations are made when they are needed.

    Args:
        states: (M, S, T, d).
        truth: parameters of the full physics behind every dynamics (M, P).
    """

    states: Float[Tensor, "M S T d"]
    truth: Float[Tensor, "M P"]

    def __post_init__(self) -> None:
        if self.states.ndim != 4 or len(self.states) != len(self.truth):
            raise InputError(
                f"States of shape {tuple(self.states.shape)} and truth of shape {tuple(self.truth.shape)} do not "
                "belong together; give (dynamics, series, times, states) and (dynamics, parameters)."
            )

    def to(self, device: torch.device | str) -> Dataset:
        """The same on another device."""
        return Dataset(self.states.to(device), self.truth.to(device))

    @property
    def dynamics(self) -> int:
        return self.states.shape[0]

    @property
    def series(self) -> int:
        return self.states.shape[1]

    def take(self, dynamics: Int[Tensor, " D"], series: Int[Tensor, "D S"]) -> Dataset:
        """Some dynamics with some series each."""
        return Dataset(self.states[dynamics[:, None], series], self.truth[dynamics])


def episodes(data: Dataset, *, dynamics: int, series: int, generator: torch.Generator) -> Iterator[Dataset]:
    """Endless batches of `dynamics` x `series`, drawn without replacement inside a batch.

    Raises:
        InputError: the data hold fewer than that.
    """
    if data.dynamics < dynamics or data.series < series:
        raise InputError(
            f"An episode of {dynamics} dynamics x {series} series cannot be drawn from {data.dynamics} x {data.series}."
        )
    while True:
        chosen = torch.randperm(data.dynamics, generator=generator)[:dynamics]
        order = torch.stack([torch.randperm(data.series, generator=generator)[:series] for _ in chosen])
        yield data.take(chosen, order)


def of_others(values: Float[Tensor, "D S v"], k: int, aggregate: Aggregate = mean) -> Float[Tensor, "D S v"]:
    """For every series what the k that follow it say together, in a circle: contexts never hold their own query.

    With k = S - 1 this is leave-one-out: S encodings serve S queries with S - 1 contexts each.
    """
    if not 1 <= k < values.shape[1]:
        raise InputError(f"Each of {values.shape[1]} series cannot have {k} others as its context.")
    return aggregate(torch.stack([values.roll(-shift, dims=1) for shift in range(1, k + 1)], dim=2))
