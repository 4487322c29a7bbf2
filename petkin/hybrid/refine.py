"""From what the encoders say at once to what fits best: gradient steps on z(0), c_p and c_n of observed series.

The weights of f_NN follow c_n through the hypernetwork, so what is searched is small, and known dynamics stay near.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from petkin.hybrid.model import Encoded, Identifier

#: Where in its interval a parameter may start, so that its slope is not lost.
_EDGE = 1e-3


@dataclass(frozen=True)
class Refined:
    """What was found, and what it gained.

    Args:
        found: initial states of all series (D, n, d), c_p and c_n of their sets, repeated for each series.
        before, after: mean squared error of the observations of a set (D,); `after` is never above `before`.
    """

    found: Encoded
    before: Float[Tensor, " D"]
    after: Float[Tensor, " D"]


def refine(
    model: Identifier,
    said: Encoded,
    observed: Float[Tensor, "D n F ..."],
    *,
    steps: int = 60,
    rate: float = 0.03,
) -> Refined:
    """Fit sets of series of the same dynamics, from where the encoders start.

    Args:
        model: trained, set to be evaluated.
        said: what it says of each series by itself, (D, n).
        observed: the first F frames of the series.
        steps: of Adam, all sets side by side, each for itself; the best point of every set is kept.
        rate: of the steps, in units of `reach`, of the logit of a parameter in its bounds, and of c_n.
    """
    start = _shared(model, said)
    share = ((start.physics[:, :1] - model.lower) / model.span).clamp(_EDGE, 1.0 - _EDGE)
    moves = [torch.zeros_like(part) for part in (start.initial, share, start.code[:, :1])]
    optimiser = torch.optim.Adam(moves, lr=rate)

    def moved() -> Encoded:
        physics = model.lower + model.span * torch.sigmoid(torch.logit(share) + moves[1])
        initial, code = start.initial + model.task.reach * moves[0], start.code + moves[2]
        return Encoded(initial, physics.expand_as(start.physics), code)

    with torch.no_grad():
        before = _error(model, start, observed)
    best, least = start, before
    for step in range(steps + 1):
        for move in moves:
            move.requires_grad_(step < steps)
        found = moved()
        error = _error(model, found, observed)
        better = error.detach() < least
        best, least = _choose(better, found, best), torch.where(better, error.detach(), least)
        if step < steps:
            for move, slope in zip(moves, torch.autograd.grad(error.sum(), moves, materialize_grads=True)):
                move.grad = torch.nan_to_num(slope)
            optimiser.step()
    return Refined(best, before, least)


def _shared(model: Identifier, said: Encoded) -> Encoded:
    """One c_p and c_n a set."""
    parts = said.physics.shape[-1], said.code.shape[-1]
    together = model.aggregate(torch.cat([said.physics, said.code], dim=-1))[:, None].expand(
        *said.physics.shape[:2], -1
    )
    physics, code = together.detach().split(parts, dim=-1)
    return Encoded(said.initial.detach(), physics, code)


def _error(model: Identifier, found: Encoded, observed: Tensor) -> Float[Tensor, " D"]:
    predicted = model.predict(found, model.task.times[: observed.shape[2]])
    return (model.observe(found, predicted) - observed).square().flatten(1).mean(dim=1)


def _choose(better: Tensor, new: Encoded, old: Encoded) -> Encoded:
    """Set by set the better one."""
    pairs = ((new.initial, old.initial), (new.physics, old.physics), (new.code, old.code))
    return Encoded(*(torch.where(better[:, None, None], a.detach(), b) for a, b in pairs))
