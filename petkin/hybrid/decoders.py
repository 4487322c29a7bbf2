"""A learned observation, where what is seen of a state is not known: x = g(s(z, c_p)), fully connected.

What the decoder sees decides what it takes for granted: all states; those of them that are known to be seen (a prior);
or these and c_p, where what is seen changes with the parameters.

Reference: arXiv:2403.08194, appendix D.1 (neural decoder), sections 4.4 and C.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import prod

from jaxtyping import Float
from torch import Tensor, nn

from petkin.hybrid.residual import Sight


class Decoder(nn.Module):
    """Observations of states.

    Args:
        sees: what of the states and parameters goes in, scaled to order one.
        inputs: how many numbers that is.
        shape: of the observation at one time.
        widths: of the hidden layers; those of the paper are the default.
    """

    def __init__(
        self, sees: Sight, inputs: int, shape: tuple[int, ...], *, widths: Sequence[int] = (32, 128, 512)
    ) -> None:
        super().__init__()
        sizes = (inputs, *widths)
        hidden = [layer for a, b in pairwise(sizes) for layer in (nn.Linear(a, b), nn.ReLU())]
        self.layers = nn.Sequential(*hidden, nn.Linear(sizes[-1], prod(shape)), nn.Unflatten(-1, shape))
        self.sees = sees

    def forward(self, states: Float[Tensor, "*b T d"], physics: Float[Tensor, "*b p"]) -> Tensor:
        seen = physics[..., None, :].expand(*states.shape[:-1], -1)
        return self.layers(self.sees(states, None, seen).movedim(0, -1))
