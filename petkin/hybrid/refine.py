"""From what the encoders say at once to what fits best: Levenberg-Marquardt on z(0), c_p and c_n of observed series.

    (J^T J + lambda diag(J^T J)) move = J^T (observed - predicted)

The weights of f_NN follow c_n through the hypernetwork, so what is searched is small, and known dynamics stay near. J
comes from forward differentiation: a pass for every component of z(0), c_p and c_n, all series at once.

Reference: Marquardt DW. SIAM J Appl Math 1963;11:431-441.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import jvp

from petkin.hybrid.model import Encoded, Identifier

#: Where in its interval a parameter may start, so that its slope is not lost.
_EDGE = 1e-3
#: First damping; what a step that gains, or does not, makes of it; what keeps unseen components where they are.
_DAMPING, _EASIER, _HARDER, _UNSEEN = 1e-2, 0.1, 10.0, 1e-7
_TINY = 1e-30
#: A gain in squared error below which a set is done, and a damping at which it is given up.
_SETTLED, _STUCK = 1e-2, 1e3


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


@dataclass(frozen=True)
class _Search:
    """Sets of series as a function of moves [D, n, u], in units of `reach`, of logits in bounds, and of c_n."""

    model: Identifier
    start: Encoded
    observed: Float[Tensor, "D n F ..."]

    def moved(self, moves: Float[Tensor, "D n u"]) -> Encoded:
        model, start = self.model, self.start
        sizes = (start.initial.shape[-1], start.physics.shape[-1], start.code.shape[-1])
        initial, physics, code = moves.split(sizes, dim=-1)
        share = ((start.physics - model.lower) / model.span).clamp(_EDGE, 1.0 - _EDGE)
        inside = model.lower + model.span * torch.sigmoid(torch.logit(share) + physics)
        return Encoded(start.initial + model.task.reach * initial, inside, start.code + code)

    def off(self, found: Encoded) -> Float[Tensor, "D n o"]:
        predicted = self.model.predict(found, self.model.task.times[: self.observed.shape[2]])
        return (self.observed - self.model.observe(found, predicted)).flatten(2)


@torch.no_grad()
def refine(
    model: Identifier,
    said: Encoded,
    observed: Float[Tensor, "D n F ..."],
    *,
    steps: int = 12,
    dynamics: bool = True,
) -> Refined:
    """Fit sets of series of the same dynamics side by side, each for itself, from where the encoders start.

    Args:
        model: trained, set to be evaluated.
        said: what it says of each series by itself, (D, n).
        observed: the first F frames of the series.
        steps: tried at most; the best point of every set is kept.
        dynamics: find one c_p and c_n a set too; else z(0) alone, and series keep the c_p and c_n they come with.
    """
    best = _shared(model, said) if dynamics else said
    search = _Search(model, best, observed)
    free = search.start.initial.shape[-1]
    shared = search.start.physics.shape[-1] + search.start.code.shape[-1]
    moves = observed.new_zeros(*observed.shape[:2], free + shared)
    off = search.off(best)
    before = least = off.square().mean(dim=(1, 2))
    damping = torch.full_like(before, _DAMPING)
    for _ in range(steps):
        slopes = _slopes(search, moves, free + dynamics * shared)
        tried = moves + torch.nn.functional.pad(_step(slopes, off, free, damping), (0, (not dynamics) * shared))
        found = search.moved(tried)
        now = search.off(found)
        error = now.square().mean(dim=(1, 2))
        better, gain = error < least, 1.0 - error / least
        best, least = _choose(better, found, best), torch.where(better, error, least)
        moves, off = (torch.where(better[:, None, None], a, b) for a, b in ((tried, moves), (now, off)))
        damping = damping * torch.where(better, _EASIER, _HARDER)
        if bool(torch.where(better, gain < _SETTLED, damping > _STUCK).all()):
            break
    return Refined(best, before, least)


def _slopes(search: _Search, moves: Float[Tensor, "D n v"], units: int) -> Float[Tensor, "u D n o"]:
    """How what is predicted changes with a component of the moves of every series."""
    directions = torch.eye(moves.shape[-1], dtype=moves.dtype, device=moves.device)[:units]
    return torch.stack(
        [-jvp(lambda m: search.off(search.moved(m)), (moves,), (u.expand_as(moves),))[1] for u in directions]
    )


def _step(
    slopes: Float[Tensor, "u D n o"], off: Float[Tensor, "D n o"], free: int, damping: Float[Tensor, " D"]
) -> Float[Tensor, "D n u"]:
    """The move of every series: its own of z(0), and one of what the set shares."""
    units, _, count, _ = slopes.shape
    curve = torch.einsum("udno,vdno->dnuv", slopes, slopes).double()
    slope = torch.einsum("udno,dno->dnu", slopes, off).double()
    own = torch.arange(count * free).reshape(count, free)
    places = torch.cat([own, torch.arange(units - free).expand(count, -1) + count * free], dim=-1)
    size = count * free + units - free
    matrix, right = curve.new_zeros(len(curve), size, size), curve.new_zeros(len(curve), size)
    for i, place in enumerate(places):
        matrix[:, place[:, None], place] += curve[:, i]
        right[:, place] += slope[:, i]
    scale = matrix.diagonal(dim1=1, dim2=2)
    damped = damping[:, None].double() * scale + _UNSEEN * scale.amax(dim=1, keepdim=True) + _TINY
    return torch.linalg.solve(matrix + torch.diag_embed(damped), right)[:, places].to(off)


def _shared(model: Identifier, said: Encoded) -> Encoded:
    """One c_p and c_n a set."""
    parts = said.physics.shape[-1], said.code.shape[-1]
    together = model.aggregate(torch.cat([said.physics, said.code], dim=-1))[:, None].expand(
        *said.physics.shape[:2], -1
    )
    physics, code = together.split(parts, dim=-1)
    return Encoded(said.initial, physics, code)


def _choose(better: Tensor, new: Encoded, old: Encoded) -> Encoded:
    """Set by set the better one."""
    pairs = ((new.initial, old.initial), (new.physics, old.physics), (new.code, old.code))
    return Encoded(*(torch.where(better[:, None, None], a, b) for a, b in pairs))
