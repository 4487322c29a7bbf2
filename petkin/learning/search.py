"""The likeliest parameters of many curves side by side, with derivatives by differences.

    minimise sum_k w_k (y_k - x_k(u))^2 + (u - m)' P (u - m)

Reference: Marquardt DW. SIAM J Appl Math 1963;11:431-441.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

#: Rounds; damping at first, after a step that gains and after one that does not, and where a curve is given up.
_ROUNDS, _DAMPING, _EASIER, _HARDER, _STUCK = 20, 1e-2, 0.1, 10.0, 1e5
#: A gain below this, in units of the objective, is none: a small part of what noise moves it by.
_SETTLED = 3e-2
#: Least damping, as a share of the largest curvature and at all.
_TINY, _NOTHING = 1e-9, 1e-30


@dataclass(frozen=True)
class Posterior:
    """What is searched.

    Args:
        predict: u (n, v) to frames (n, K), curve by curve.
        mean: m (v,).
        precision: P (v, v).
        step: in u, of differences.
    """

    predict: Callable[[Tensor], Tensor]
    mean: Float[Tensor, " v"]
    precision: Float[Tensor, "v v"]
    step: float

    def around(self, u: Float[Tensor, "n v"]) -> tuple[Float[Tensor, "n K"], Float[Tensor, "n K v"]]:
        """Frames at u and their derivatives, predicted together."""
        count = u.shape[1]
        beside = torch.cat([u[None], u + self.step * torch.eye(count)[:, None]])
        seen, *moved = self.predict(beside.flatten(0, 1)).unflatten(0, (1 + count, -1))
        return seen, ((torch.stack(moved) - seen) / self.step).movedim(0, -1).double()

    def objective(self, u: Tensor, seen: Tensor, values: Tensor, weights: Tensor) -> Float[Tensor, " *b"]:
        """What is made small; infinite where the numbers were left."""
        off = (u - self.mean).double()
        strange = ((off @ self.precision.double()) * off).sum(dim=-1)
        found = (weights * (values - seen) ** 2).double().sum(dim=-1) + strange
        return torch.where(torch.isfinite(found), found, torch.inf)

    def pull(self, u: Tensor, off: Tensor, weighted: Tensor) -> Float[Tensor, "*b v"]:
        """Half the objective's descent at u, whose frames are off by so much; derivatives times weights [K, v]."""
        return (off[..., None, :].double() @ weighted)[..., 0, :] - (u - self.mean).double() @ self.precision.double()


@torch.no_grad()
def likeliest(
    posterior: Posterior, values: Float[Tensor, "n K"], weights: Float[Tensor, "n K"], start: Float[Tensor, "n v"]
) -> Float[Tensor, "n v"]:
    """u of every curve, each for itself.

    Args:
        posterior: what is searched.
        values: y.
        weights: w, inverse variances.
        start: where to begin.
    """
    u, (seen, slopes) = start.clone(), posterior.around(start)
    least = posterior.objective(u, seen, values, weights)
    damping, at = torch.full((len(u),), _DAMPING, dtype=torch.float64), torch.arange(len(u))
    for _ in range(_ROUNDS):
        if not len(at):
            break
        weighted = weights[at, :, None].double() * slopes[at]
        pull = posterior.pull(u[at], values[at] - seen[at], weighted)
        tried = u[at] + _damped(slopes[at].mT @ weighted + posterior.precision.double(), pull, damping[at]).to(u)
        there, slopes_there = posterior.around(tried)
        objective = posterior.objective(tried, there, values[at], weights[at])
        gain = least[at] - objective
        better = gain > 0
        taken = at[better]
        u[taken], seen[taken], least[taken] = tried[better], there[better], objective[better]
        slopes[taken] = slopes_there[better]
        done = (better & (gain < _SETTLED) & (damping[at] <= _DAMPING)) | (damping[at] > _STUCK)
        damping[at] *= torch.where(better, _EASIER, _HARDER)
        at = at[~done]
    return u


def _damped(curvature: Float[Tensor, "n v v"], pull: Float[Tensor, "n v"], damping: Float[Tensor, " n"]) -> Tensor:
    diagonal = curvature.diagonal(dim1=1, dim2=2)
    more = damping[:, None] * diagonal + _TINY * diagonal.amax(dim=1, keepdim=True) + _NOTHING
    return torch.linalg.solve(curvature + torch.diag_embed(more), pull)
