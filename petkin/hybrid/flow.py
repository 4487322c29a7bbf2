"""From an initial state to the states at the times of the frames, fast enough to be trained through."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from functools import cache
from typing import Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from petkin.dynamics import VectorField


class Flow(Protocol):
    """How states are carried from frame to frame."""

    def __call__(
        self,
        field: VectorField,
        initial: Float[Tensor, "*b d"],
        parameters: Float[Tensor, "*b p"],
        times: Float[Tensor, " T"],
        /,
    ) -> Float[Tensor, "*b T d"]:
        """States at the times; the first is the initial state's."""
        ...


@dataclass(frozen=True)
class RungeKutta:
    """The classical method of fourth order, in equal sub-steps between one time and the next.

    Args:
        substeps: steps between two times.
        compiled: compile what lies between two times, where gradients are asked for and a C++ compiler is there:
            three times as fast, after up to minutes of compilation whose result is kept on disk.
    """

    substeps: int = 1
    compiled: bool = False

    def __call__(self, field: VectorField, initial: Tensor, parameters: Tensor, times: Tensor, /) -> Tensor:
        between = _compiled() if self.compiled and torch.is_grad_enabled() else _between
        state, states = initial, [initial]
        for k in range(len(times) - 1):
            state = between(field, times[k], times[k + 1], self.substeps, state, parameters)
            states.append(state)
        return torch.stack(states, dim=-2)


def _between(field: VectorField, start: Tensor, end: Tensor, steps: int, state: Tensor, p: Tensor) -> Tensor:
    h = (end - start) / steps
    for i in range(steps):
        state = _step(field, start + i * h, h, state, p)
    return state


@cache
def _compiled():
    found = any(shutil.which(name) for name in (os.environ.get("CXX", "c++"), "g++", "clang++"))
    return torch.compile(_between, dynamic=False) if found else _between


def _step(field: VectorField, t: Tensor, h: Tensor, state: Tensor, p: Tensor) -> Tensor:
    half = 0.5 * h
    k1 = field(t, state, None, p)
    k2 = field(t + half, state + half * k1, None, p)
    k3 = field(t + half, state + half * k2, None, p)
    k4 = field(t + h, state + h * k3, None, p)
    return state + (h / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)
