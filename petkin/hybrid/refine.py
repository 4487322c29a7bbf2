"""From what the encoders say at once to what fits best: Levenberg-Marquardt on z(0), c_p and c_n of observed series.

    (J^T J + lambda diag(J^T J)) move = J^T (observed - predicted),    J_t = O_t S_t

The weights of f_NN follow c_n through the hypernetwork, so what is searched is small, and known dynamics stay near. An
observation at t shows z(t) alone, so J need not be made: S_t, what z(t) owes to z(0), c_p and c_n, and O_t, what is
seen of z(t), come from forward differentiation, each in one pass for all series, and of the pictures only O_t^T O_t
and O_t^T (observed - predicted) are kept.

Reference: Marquardt DW. SIAM J Appl Math 1963;11:431-441.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.func import jvp, vmap

from petkin.hybrid.model import Encoded, Identifier

#: Where in its interval a parameter may start, so that its slope is not lost.
_EDGE = 1e-3
#: First damping; what a step that gains, or does not, makes of it; what keeps unseen components where they are.
_DAMPING, _EASIER, _HARDER, _UNSEEN = 1e-2, 0.1, 10.0, 1e-7
_TINY = 1e-30
#: An error below this share of the observations' mean square is rounding.
_ROUNDING = 1e-12
#: Numbers of observations that are looked at together.
_NUMBERS = 1 << 19
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
    """Sets of series as a function of moves [*, D, n, u], in units of `reach`, of logits in bounds, and of c_n."""

    model: Identifier
    start: Encoded
    observed: Float[Tensor, "D n F ..."]

    def only(self, sets: Int[Tensor, " E"]) -> _Search:
        """Some of the sets."""
        start = (x[sets] for x in (self.start.initial, self.start.physics, self.start.code))
        return _Search(self.model, Encoded(*start), self.observed[sets])

    @property
    def free(self) -> int:
        """Components of z(0) that are searched: those that are not held."""
        return int((self.model.task.reach != 0).sum())

    @property
    def bounded(self) -> int:
        """Components of c_p."""
        return self.start.physics.shape[-1]

    def moved(self, moves: Float[Tensor, "*a D n u"]) -> Encoded:
        model, start = self.model, self.start
        sizes = (self.free, self.bounded, start.code.shape[-1])
        initial, physics, code = moves.split(sizes, dim=-1)
        reach = torch.diag(model.task.reach)[model.task.reach != 0]
        share = ((start.physics - model.lower) / model.span).clamp(_EDGE, 1.0 - _EDGE)
        inside = model.lower + model.span * torch.sigmoid(torch.logit(share) + physics)
        return Encoded(start.initial + initial @ reach, inside, start.code + code)

    def told(self, found: Encoded) -> Float[Tensor, "*a D n F y"]:
        """Predicted states, and beside them c_p, which a decoder may see."""
        states = self.model.predict(found, self.model.task.times[: self.observed.shape[2]])
        return torch.cat([states, found.physics[..., None, :].expand(*states.shape[:-1], -1)], dim=-1)

    def error(self, found: Encoded) -> Float[Tensor, " D"]:
        """Mean squared error of the observations of a set."""
        told, seen = self.told(found).flatten(0, 2), self.observed.flatten(0, 2)
        off = [(o - self.observe(t)).square().flatten(1).mean(dim=1) for t, o in self.parts(told, seen)]
        return torch.cat(off).unflatten(0, self.observed.shape[:3]).mean(dim=(1, 2))

    def observe(self, told: Float[Tensor, "*a N y"]) -> Tensor:
        """What is observed of states, each by itself."""
        states, physics = told.split((len(self.model.task.states), self.bounded), dim=-1)
        found = Encoded(states, physics, self.start.code[:0])
        return self.model.observe(found, states[..., None, :]).squeeze(told.ndim - 1)

    def parts(self, *tensors: Tensor) -> Iterator[tuple[Tensor, ...]]:
        """The same few rows of all, so that the pictures of one time fit into the cache."""
        size = max(1, _NUMBERS // self.observed[0, 0, 0].numel())
        return zip(*(tensor.split(size) for tensor in tensors))

    @property
    def shown(self) -> list[int]:
        """What of `told` an observation shows."""
        task = self.model.task
        return (
            list(task.seen) if task.seen and self.model.decoder is None else [*range(len(task.states) + self.bounded)]
        )

    def slopes(self, moves: Float[Tensor, "D n v"], units: int) -> Float[Tensor, "u D n F s"]:
        """What is shown owes so much to each of the first components of the moves."""
        ways = torch.eye(moves.shape[-1], dtype=moves.dtype, device=moves.device)[:units, None, None]
        ways, many = (x.expand(units, *moves.shape).contiguous() for x in (ways, moves))
        return jvp(lambda m: self.told(self.moved(m))[..., self.shown], (many,), (ways,))[1]

    def sight(self, moves: Float[Tensor, "D n v"]) -> tuple[Tensor, Tensor]:
        """O_t^T O_t [D, n, F, s, s] and O_t^T (observed - predicted) [D, n, F, s], a number of an observation."""
        told = self.told(self.moved(moves))
        ways = torch.eye(told.shape[-1], dtype=told.dtype, device=told.device)[self.shown]
        curve, slope = [], []
        for at, seen in self.parts(told.flatten(0, 2), self.observed.flatten(0, 2)):
            change = vmap(lambda way: jvp(self.observe, (at,), (way.expand_as(at),))[1])(ways)  # noqa: B023
            change, off = change.flatten(2).movedim(0, 1), (seen - self.observe(at)).flatten(1)
            curve.append(change @ change.mT / off.shape[1])
            slope.append((change @ off[..., None])[..., 0] / off.shape[1])
        return tuple(torch.cat(x).unflatten(0, told.shape[:3]) for x in (curve, slope))  # type: ignore[return-value]


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
    start = _shared(model, said) if dynamics else said
    search = _Search(model, start, observed)
    units = search.free + dynamics * (search.bounded + start.code.shape[-1])
    moves = observed.new_zeros(*observed.shape[:2], search.free + search.bounded + start.code.shape[-1])
    before = search.error(start)
    least, damping = before.clone(), torch.full_like(before, _DAMPING)
    exact = _ROUNDING * observed.square().flatten(1).mean(dim=1)
    done = least < exact
    for _ in range(steps):
        at = torch.nonzero(~done)[:, 0]
        if not len(at):
            break
        part = search.only(at)
        tried = moves[at] + _step(part, moves[at], units, damping[at])
        error = part.error(part.moved(tried))
        better, settled = error < least[at], (error > (1.0 - _SETTLED) * least[at]) & (damping[at] <= _DAMPING)
        moves[at] = torch.where(better[:, None, None], tried, moves[at])
        least[at] = torch.where(better, error, least[at])
        damping[at] *= torch.where(better, _EASIER, _HARDER)
        done[at] = torch.where(better, settled | (error < exact[at]), damping[at] > _STUCK)
    return Refined(_choose(least < before, search.moved(moves), start), before, least)


def _step(
    search: _Search, moves: Float[Tensor, "D n v"], units: int, damping: Float[Tensor, " D"]
) -> Float[Tensor, "D n v"]:
    """The move of every series: its own of z(0), and one of what the set shares; no further than `units`."""
    seen, pull = search.sight(moves)
    slopes, free, count = search.slopes(moves, units), search.free, moves.shape[1]
    turned = torch.einsum("udnfs,dnfst->udnft", slopes, seen)
    curve = torch.einsum("udnfs,vdnfs->dnuv", turned, slopes).double()
    slope = torch.einsum("udnfs,dnfs->dnu", slopes, pull).double()
    own = torch.arange(count * free).reshape(count, free)
    places = torch.cat([own, torch.arange(units - free).expand(count, -1) + count * free], dim=-1)
    size = count * free + units - free
    matrix, right = curve.new_zeros(len(curve), size, size), curve.new_zeros(len(curve), size)
    for i, place in enumerate(places):
        matrix[:, place[:, None], place] += curve[:, i]
        right[:, place] += slope[:, i]
    scale = matrix.diagonal(dim1=1, dim2=2)
    damped = damping[:, None].double() * scale + _UNSEEN * scale.amax(dim=1, keepdim=True) + _TINY
    found = torch.linalg.solve(matrix + torch.diag_embed(damped), right)[:, places].to(slopes)
    return torch.nn.functional.pad(found, (0, moves.shape[-1] - units))


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
