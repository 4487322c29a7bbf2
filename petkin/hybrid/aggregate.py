"""One code from the codes of k context series, whatever their number and order.

    mean:       c = sum_i c_i / k
    attention:  c = sum_i a_i c_i,   a = softmax_i(Q key(c_i, c_i - mean)),   a row of the learned Q a number of c

Both are means, so c_p stays within its bounds, and one context series says what it says alone. Attention begins as the
mean (Q = 0) and learns which series to trust: those that moved enough to tell, those that agree with the others.

Reference: Lee J et al. Set Transformer, ICML 2019, arXiv:1810.00825 (pooling by learned queries).
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import silu

from petkin.dynamics import ParameterSet

#: Codes of k series [*b, k, v] -> one [*b, v].
Aggregate = Callable[[Tensor], Tensor]


def mean(codes: Float[Tensor, "*b k v"]) -> Float[Tensor, "*b v"]:
    """Every series counts the same."""
    return codes.mean(dim=-2)


class Attention(nn.Module):
    """A mean whose weights are learned, number by number.

    Args:
        parameters: c_p, whose bounds make its numbers comparable with the others.
        code: numbers in c_n.
        width: of the keys.
    """

    def __init__(self, parameters: ParameterSet, code: int, *, width: int = 16) -> None:
        super().__init__()
        numbers = len(parameters) + code
        self.key = nn.Linear(2 * numbers, width)
        self.query = nn.Linear(width, numbers, bias=False)
        nn.init.zeros_(self.query.weight)
        low, high = torch.tensor(parameters.lower), torch.tensor(parameters.upper)
        self.shift: Tensor
        self.register_buffer("shift", torch.cat([0.5 * (low + high), torch.zeros(code)]).float())
        self.scale: Tensor
        reach = torch.where(high > low, 0.5 * (high - low), 1.0)
        self.register_buffer("scale", torch.cat([reach, torch.ones(code)]).float())

    def forward(self, codes: Float[Tensor, "*b k v"]) -> Float[Tensor, "*b v"]:
        level = (codes - self.shift) / self.scale
        apart = level - level.mean(dim=-2, keepdim=True)
        keys = silu(self.key(torch.cat([level, apart], dim=-1)))
        return (torch.softmax(self.query(keys), dim=-2) * codes).sum(dim=-2)
