"""A cube drawn from its pose: analytic, differentiable, three coloured faces at most.

A camera far away looks down at an elevation; what is nearer is drawn larger (one scale a body). A visible face is a
parallelogram on the canvas: with p - m = a e1 + b e2 for a pixel p, its middle m and half edges e1, e2, the pixel lies
inside where |a| < 1 and |b| < 1, made smooth by logistic steps. Faces of one body do not hide each other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

#: Colours of the faces along +x, -x, +y, -y, +z, -z (red, green, blue).
_COLOURS = ((1.0, 0.2, 0.2), (0.2, 1.0, 1.0), (0.2, 1.0, 0.2), (1.0, 0.2, 1.0), (0.3, 0.4, 1.0), (1.0, 1.0, 0.2))


@dataclass(frozen=True)
class Cube:
    """Images (3, size, size) of states that begin with x, y, z and a quaternion (scalar last).

    Args:
        half: half an edge.
        size: pixels along an edge.
        canvas: half the width of the scene in front of the camera.
        distance: of the camera.
        elevation: of the camera above the x axis' plane, radians.
        soft: width of an edge, in pixels.
    """

    half: float = 1.0 / math.sqrt(3.0)
    size: int = 64
    canvas: float = 2.6
    distance: float = 8.0
    elevation: float = math.pi / 6
    soft: float = 0.7
    channels: int = 3

    def observe(self, states: Float[Tensor, "*b d"]) -> Float[Tensor, "*b 3 H W"]:
        """Images of poses."""
        middle, axes = self._pose(states)
        scale = self.distance / (self.distance - middle[..., 2]) / self.canvas
        centre, edges = scale[..., None] * middle[..., :2], scale[..., None, None] * self.half * axes[..., :2]
        facing = axes[..., 2]
        images = states.new_zeros(*states.shape[:-1], 3, self.size, self.size)
        for axis in range(3):
            images = images + self._face(centre, edges, facing, axis, states)
        return images

    def squared_error(self, predicted: Float[Tensor, "*b d"], actual: Float[Tensor, "*b d"]) -> Float[Tensor, "*b"]:
        """Mean squared difference of the images."""
        return (self.observe(predicted) - self.observe(actual)).square().mean(dim=(-3, -2, -1))

    def _pose(self, states: Tensor) -> tuple[Tensor, Tensor]:
        """Middle [*b, 3] and the body's axes [*b, axis, 3] as the camera sees them: right, up, toward it."""
        camera = _camera(self.elevation, states.dtype, states.device)
        return states[..., :3] @ camera.T, rotation(states[..., 3:7]).mT @ camera.T

    def _face(self, centre: Tensor, edges: Tensor, facing: Tensor, axis: int, like: Tensor) -> Tensor:
        """The one of two opposite faces that is seen."""
        first, second = edges[..., (axis + 1) % 3, :], edges[..., (axis + 2) % 3, :]
        side = torch.where(facing[..., axis] >= 0, 1.0, -1.0)
        middle = centre + side[..., None] * edges[..., axis, :]
        area = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
        area = torch.where(area.abs() > 1e-3, area, 1e-3 * torch.where(area >= 0, 1.0, -1.0))
        grid = (torch.arange(self.size, dtype=like.dtype, device=like.device) + 0.5) * (2.0 / self.size) - 1.0
        across, down = grid - middle[..., :1], -grid - middle[..., 1:]
        a = self._inside(second[..., 1] / area, -second[..., 0] / area, across, down)
        b = self._inside(-first[..., 1] / area, first[..., 0] / area, across, down)
        colours = _colours(like.dtype, like.device)
        colour = torch.where(side[..., None] > 0, colours[2 * axis], colours[2 * axis + 1])
        seen = torch.tanh(facing[..., axis].abs() / 0.15)  # a face seen edge on fades instead of jumping
        return (colour * seen[..., None])[..., None, None] * (a * b)[..., None, :, :]

    def _inside(self, u: Tensor, v: Tensor, across: Tensor, down: Tensor) -> Tensor:
        """1 where |u x + v y| < 1, falling to 0 over the width of an edge."""
        place = (u[..., None] * across)[..., None, :] + (v[..., None] * down)[..., :, None]
        steep = self.size / (2.0 * self.soft) / torch.sqrt(u * u + v * v + 1e-12)
        return torch.sigmoid(steep[..., None, None] * (1.0 - place.abs()))


@cache
def _camera(elevation: float, dtype: torch.dtype, device: torch.device) -> Float[Tensor, "3 3"]:
    """Right, up and toward the camera in the world's coordinates; made once, since a device waits for such numbers."""
    c, s = math.cos(elevation), math.sin(elevation)
    return torch.tensor([[1.0, 0.0, 0.0], [0.0, s, c], [0.0, -c, s]], dtype=dtype, device=device)


@cache
def _colours(dtype: torch.dtype, device: torch.device) -> Float[Tensor, "6 3"]:
    return torch.tensor(_COLOURS, dtype=dtype, device=device)


def rotation(q: Float[Tensor, "*b 4"]) -> Float[Tensor, "*b 3 3"]:
    """Rotation matrix of a quaternion (x, y, z, w) of any length: body to world."""
    x, y, z, w = (q / q.norm(dim=-1, keepdim=True).clamp_min(1e-9)).unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)
