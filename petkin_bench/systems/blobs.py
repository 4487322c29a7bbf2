"""Bodies drawn as soft round spots: analytic images, differentiable everywhere, their errors in closed form.

A body at (x, y) of the canvas [-1, 1]^2 is the image exp(-((u - x)^2 + (v - y)^2) / (2 sigma^2)), a product of two
profiles. So |I_a - I_b|^2 follows from six dot products of profiles, and no predicted image has to be made.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Blobs:
    """Images (channels, size, size) of a system's bodies, values in [0, 1].

    Args:
        place: states [*b, d] -> positions of the bodies on the canvas [*b, bodies, 2].
        channel: of every body.
        channels: how many there are; one without a body stays dark.
        size: pixels along an edge.
        sigma: of a spot, in canvas units.
    """

    place: Callable[[Tensor], Tensor]
    channel: tuple[int, ...] = (0,)
    channels: int = 1
    size: int = 32
    sigma: float = 0.09

    def observe(self, states: Float[Tensor, "*b d"]) -> Float[Tensor, "*b C H W"]:
        """Images of states."""
        across, down = self._profiles(states)
        spots = down[..., :, None] * across[..., None, :]
        images = spots.new_zeros(*spots.shape[:-3], self.channels, self.size, self.size)
        for body, channel in enumerate(self.channel):
            images[..., channel, :, :] += spots[..., body, :, :]
        return images

    def squared_error(self, predicted: Float[Tensor, "*b d"], actual: Float[Tensor, "*b d"]) -> Float[Tensor, "*b"]:
        """Mean squared difference of the images of two states; bodies must not share a channel."""
        (a, b), (c, d) = self._profiles(predicted), self._profiles(actual)
        own = (a * a).sum(-1) * (b * b).sum(-1) + (c * c).sum(-1) * (d * d).sum(-1)
        both = (a * c).sum(-1) * (b * d).sum(-1)
        return (own - 2.0 * both).sum(-1) / (self.channels * self.size**2)

    def _profiles(self, states: Tensor) -> tuple[Tensor, Tensor]:
        """Across and down, [*b, bodies, size]."""
        middle = (torch.arange(self.size, dtype=states.dtype, device=states.device) + 0.5) * (2.0 / self.size) - 1.0
        place = self.place(states)[..., None]
        profiles = torch.exp(-0.5 * ((middle - place) / self.sigma) ** 2)
        return profiles[..., 0, :], profiles[..., 1, :]
