"""How to train, and what changes in the course of it: the learning rate and the times that are predicted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Settings:
    """How to train.

    Args:
        steps: how many.
        strategy: reconstruct, meta or mixed.
        dynamics, series: of an episode.
        context: k, series that identify for another; 0 for all others of the episode.
        vary: draw k from 1 to `context`, episode by episode.
        episodes: whose gradients are averaged in a step; processes that torchrun starts share them.
        rate: highest learning rate, reached after `warm_up` of the steps and annealed to `final` of itself.
        clip: largest norm of a gradient.
        horizon, curriculum: predict only the first `horizon` times at first, all after this share of the steps.
        glimpse: of the predicted times only so many are compared, drawn anew a step; 0 for all. For costly pictures.
        norm, orthogonality: weights of the penalties on f_NN's mean square and on its overlap with f_PHY. They rise and
            fall with the learning rate: physics explains what it can while there is time, and f_NN ends unbiased.
        seed: of first weights and episodes.
        save_every: steps between checkpoints.
        restarts: how often a dead run may begin again.
        check_every: steps between checks on validation dynamics; 0 for none.
        patience: checks without a better one at the end of the anneal after which a run ends; 0 for never.
        axes: Adam works along the axes in which gradients vary (`TurnedAdam`), renewed after so many steps; 0 for those
            of the weights.
    """

    steps: int
    strategy: str = "meta"
    dynamics: int = 8
    series: int = 8
    context: int = 0
    rate: float = 3e-3
    warm_up: float = 0.1
    final: float = 1e-3
    clip: float = 1.0
    horizon: int = 0
    curriculum: float = 0.0
    glimpse: int = 0
    norm: float = 0.0
    orthogonality: float = 0.0
    seed: int = 0
    save_every: int = 500
    restarts: int = 2
    vary: bool = False
    episodes: int = 1
    check_every: int = 0
    patience: int = 0
    axes: int = 0


def learning_rate(step: int, settings: Settings) -> float:
    """One cycle: up in a straight line, down along half a cosine."""
    rise = max(1, round(settings.warm_up * settings.steps))
    if step < rise:
        return settings.rate * (step + 1) / rise
    share = (step - rise) / max(1, settings.steps - rise)
    low = settings.final * settings.rate
    return low + 0.5 * (settings.rate - low) * (1.0 + math.cos(math.pi * share))


def compared(step: int, settings: Settings, frames: int) -> slice | list[int]:
    """Which of the predicted times are compared at this step."""
    if not 0 < settings.glimpse < frames:
        return slice(None)
    generator = torch.Generator().manual_seed(1_000_003 * settings.seed + step)
    return sorted(torch.randperm(frames, generator=generator)[: settings.glimpse].tolist())


def frames_at(step: int, settings: Settings, frames: int) -> int:
    """How many times are predicted at this step."""
    if not settings.horizon or step >= settings.curriculum * settings.steps:
        return frames
    share = step / (settings.curriculum * settings.steps)
    return min(frames, settings.horizon + round(share * (frames - settings.horizon)))
