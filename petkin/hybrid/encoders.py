"""Networks that read series: the whole of one, or its first frames.

`Stack` takes the frames of a series as the channels of one image; `SpatioTemporal` is the paper's, a convolution of
every frame followed by a map over time; `Curve` reads series of a few numbers. All end in features; what they are used
for is a linear `Head`.

Reference: arXiv:2403.08194, appendix D; the order inside a spatio-temporal block follows Jiang X et al. 2022 (the
paper's own source for it): convolution, normalisation, activation, map over time, activation.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, batch_norm, leaky_relu

_SLOPE = 0.1
#: Mean brightness below which a channel counts as dark, and the least width.
_DARK = 1e-4
#: Standardised moments are magnified by this before the first convolution: small differences of place decide.
_GAIN = 5.0
#: Numbers that describe a channel of a frame.
_MOMENTS = 6


class Stack(nn.Module):
    """Frames x channels of a series as the channels of one image, three convolutions of stride 2, features.

    Args:
        frames, channels, size: of a series [*b, frames, channels, size, size].
        filters: of the last convolution; those before have twice as many.
        pool: images are averaged over squares of this edge first.
    """

    def __init__(self, frames: int, channels: int, size: int, *, filters: int = 16, pool: int = 1) -> None:
        super().__init__()
        widths = (frames * channels, 2 * filters, 2 * filters, filters)
        convolutions = [nn.Conv2d(a, b, 5, stride=2, padding=2) for a, b in pairwise(widths)]
        self.layers = nn.Sequential(
            convolutions[0],
            nn.BatchNorm2d(widths[1]),
            nn.LeakyReLU(_SLOPE),
            convolutions[1],
            nn.BatchNorm2d(widths[2]),
            nn.LeakyReLU(_SLOPE),
            convolutions[2],
            nn.Tanh(),
            nn.Flatten(),
        )
        self.pool, self.frames = pool, frames
        self.features = filters * _halved(size // pool, 3) ** 2

    def forward(self, series: Float[Tensor, "n T C H W"]) -> Float[Tensor, "n f"]:
        images = series[:, : self.frames].flatten(1, 2)
        return self.layers(avg_pool2d(images, self.pool) if self.pool > 1 else images)


class Moments(nn.Module):
    """How bright every frame's channels are, where, how wide and how slanted: as they are, and convolved over time.

    A spot's mean place tells its position far below a pixel at the cost of one small matrix product, where convolutions
    over pixels have to learn it. Moments among the features leave to the convolutions what is no straight line of them.

    Args:
        frames, channels: of a series [*b, frames, channels, size, size] of any size.
        filters: of the convolutions over time.
        hidden: numbers that come out of them.
        straight: moments are features too.
    """

    def __init__(
        self, frames: int, channels: int, *, filters: int = 64, hidden: int = 128, straight: bool = True
    ) -> None:
        super().__init__()
        self.usual = nn.BatchNorm1d(channels * _MOMENTS, affine=False, eps=1e-3, momentum=None)
        widths = (channels * _MOMENTS, *[filters] * 4)
        strides = (1, 2, 2, 2)
        over_time = [
            layer
            for (a, b), stride in zip(pairwise(widths), strides)
            for layer in (nn.Conv1d(a, b, 5, stride=stride, padding=2), nn.SiLU())
        ]
        self.layers = nn.Sequential(
            *over_time, nn.Flatten(), nn.Linear(filters * _halved(frames, 3), hidden), nn.SiLU()
        )
        self.frames, self.straight = frames, straight
        self.features = hidden + straight * widths[0] * frames

    def forward(self, series: Float[Tensor, "n T C H W"]) -> Float[Tensor, "n f"]:
        said = self._standard(self.describe(series))
        convolved = self.layers(_GAIN * said)
        return torch.cat([convolved, said.flatten(1)], dim=-1) if self.straight else convolved

    def describe(self, series: Float[Tensor, "n T C H W"]) -> Float[Tensor, "n c T"]:
        """Brightness, place (u, v), widths and slant of every channel, in numbers of order one."""
        powers = _powers(series.shape[-1], series.dtype, series.device)
        mass, *raw = (series[:, : self.frames].flatten(3) @ powers).unbind(-1)
        u, v, uu, vv, uv = (moment / (mass + _DARK) for moment in raw)
        wide, high = (uu - u * u).clamp_min(_DARK), (vv - v * v).clamp_min(_DARK)
        slant = (uv - u * v) / torch.sqrt(wide * high)
        said = [torch.log(mass + _DARK) / 4.0 + 1.0, u, v, 2.0 * wide.sqrt(), 2.0 * high.sqrt(), slant]
        return torch.cat(said, dim=-1).movedim(1, -1)

    @torch.no_grad()
    def settle(self, series: Float[Tensor, "n T C H W"]) -> None:
        """Take the usual mean and spread of moments from these series; before, they are 0 and 1.

        Training adds nothing to them, so it sees no batch noise, and all processes that share it see the same.
        """
        self.usual.reset_running_stats()
        self.usual.train()(self.describe(series))

    def _standard(self, said: Float[Tensor, "n c T"]) -> Float[Tensor, "n c T"]:
        return batch_norm(said, self.usual.running_mean, self.usual.running_var, eps=self.usual.eps)


@cache
def _powers(size: int, dtype: torch.dtype, device: torch.device) -> Float[Tensor, "pixels 6"]:
    """1, u, v, u^2, v^2, u v of the pixels of the canvas [-1, 1]^2, over their number."""
    along = (torch.arange(size) + 0.5) * (2.0 / size) - 1.0
    v, u = torch.meshgrid(along, along, indexing="ij")
    powers = torch.stack([torch.ones_like(u), u, v, u * u, v * v, u * v], dim=-1).flatten(0, 1) / size**2
    return powers.to(device, dtype)


class SpatioTemporal(nn.Module):
    """The paper's context encoder: every block halves the image and the time axis, the last leaves one time.

    Args:
        frames, channels, size: of a series [*b, frames, channels, size, size].
        filters: of the first and the last block.
    """

    def __init__(self, frames: int, channels: int, size: int, *, filters: int = 8) -> None:
        super().__init__()
        times, widths = (frames, frames // 2, frames // 4, 1), (channels, filters, 2 * filters, filters)
        self.blocks = nn.ModuleList(
            _Block(times[i], times[i + 1], widths[i], widths[i + 1], last=i == 2) for i in range(3)
        )
        self.features = filters * _halved(size, 3) ** 2

    def forward(self, series: Float[Tensor, "n T C H W"]) -> Float[Tensor, "n f"]:
        for block in self.blocks:
            series = block(series)
        return series.flatten(1)


class _Block(nn.Module):
    def __init__(self, before: int, after: int, channels: int, filters: int, *, last: bool) -> None:
        super().__init__()
        self.convolution = nn.Conv2d(channels, filters, 5, stride=2, padding=2)
        self.normalisation = nn.BatchNorm2d(filters)
        self.over_time = nn.Linear(before, after)
        self.last = last

    def forward(self, series: Tensor) -> Tensor:
        count, frames = series.shape[:2]
        maps = leaky_relu(self.normalisation(self.convolution(series.flatten(0, 1))), _SLOPE)
        mixed = self.over_time(maps.unflatten(0, (count, frames)).movedim(1, -1)).movedim(-1, 1)
        return torch.tanh(mixed) if self.last else leaky_relu(mixed, _SLOPE)


class Curve(nn.Module):
    """A series of a few numbers, [n, numbers], through fully connected layers.

    Args:
        numbers: how many a series has.
        widths: of the hidden layers; the last is the number of features.
    """

    def __init__(self, numbers: int, widths: Sequence[int] = (128, 64)) -> None:
        super().__init__()
        sizes = (numbers, *widths)
        layers = [layer for a, b in pairwise(sizes) for layer in (nn.Linear(a, b), nn.SiLU())]
        self.layers = nn.Sequential(*layers)
        self.features = sizes[-1]

    def forward(self, series: Float[Tensor, "n numbers"]) -> Float[Tensor, "n f"]:
        return self.layers(series)


class Head(nn.Linear):
    """A linear map that starts near zero: small weights, no bias."""

    def __init__(self, features: int, outputs: int, *, scale: float = 0.1) -> None:
        super().__init__(features, outputs)
        with torch.no_grad():
            self.weight.mul_(scale)
            self.bias.zero_()


def _halved(size: int, times: int) -> int:
    for _ in range(times):
        size = (size + 1) // 2
    return size
