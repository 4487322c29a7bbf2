"""A ball in a box, under gravity whose direction is not known.

    v' = g = G (cos phi, sin phi),    v -> -v at the walls x, y = +-5

The partial law has g = (0, -G). G in (0, 5]; phi = i pi / 8 with i in -6..-1, 2..7, out of distribution -8, -7, 0, 1;
25 frames of 0.1 s. Between two hits the ball flies a parabola, so it is carried from wall to wall exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from petkin.dynamics import VectorField
from petkin.hybrid import Residual, into_rows
from petkin_bench.systems.blobs import Blobs
from petkin_bench.systems.physics import Physics, Range, uniform

_WALL = 5.0
_INSIDE, _OUTSIDE = (-6, -5, -4, -3, -2, -1, 2, 3, 4, 5, 6, 7), (-8, -7, 0, 1)
_RANGES = (
    Range("G", "m/s^2", (0.0, 5.0), (0.0, 5.0), "size of gravity"),
    Range("gx", "m/s^2", (-5.0, 5.0), (-5.0, 5.0), "gravity along x"),
    Range("gy", "m/s^2", (-5.0, 5.0), (-5.0, 5.0), "gravity along y"),
)


@dataclass(frozen=True)
class Bounces:
    """Exact flight of (x, y, vx, vy) under an acceleration that is constant in time, between walls at +-`wall`.

    The hit times are roots of quadratics and stay differentiable. x and y do not meet: each axis flies for itself.

    Args:
        wall: distance of the walls from the middle.
        most: hits an axis; later walls are open.
    """

    wall: float = _WALL
    most: int = 12

    def __call__(
        self, field: VectorField, initial: Float[Tensor, "*b 4"], parameters: Float[Tensor, "*b p"], times: Tensor, /
    ) -> Float[Tensor, "*b T 4"]:
        pull = field(times[0], initial, None, parameters)[..., 2:]
        x, v = initial[..., :2].clamp(-self.wall, self.wall), initial[..., 2:]
        hit = torch.zeros_like(x)
        since = (times - times[0])[:, None]
        places, speeds = [], []
        for _ in range(self.most):
            wait, up = _next_hit(x, v, pull, self.wall)
            after = since - hit[..., None, :]
            here = after >= 0
            places.append((here, x[..., None, :] + after * (v[..., None, :] + 0.5 * after * pull[..., None, :])))
            speeds.append(v[..., None, :] + after * pull[..., None, :])
            x = torch.where(up, self.wall, -self.wall).to(x)
            v, hit = -(v + wait * pull), hit + wait
        place, speed = places[0][1], speeds[0]
        for (here, later), fast in zip(places[1:], speeds[1:]):
            place, speed = torch.where(here, later, place), torch.where(here, fast, speed)
        return torch.cat([place, speed], dim=-1)


#: Waiting time of those that never hit, s: beyond every series.
_NEVER = 1e3


def _next_hit(x: Tensor, v: Tensor, a: Tensor, wall: float) -> tuple[Tensor, Tensor]:
    """Time to the next wall, and whether it is the upper one."""
    upper, lower = _time_to(wall - x, v, a), _time_to(wall + x, -v, -a)
    return torch.minimum(upper, lower), upper <= lower


def _time_to(gap: Tensor, v: Tensor, a: Tensor) -> Tensor:
    """Smallest s > 0 with v s + a s^2 / 2 = gap >= 0, in the form that loses no digits; _NEVER where there is none."""
    square = v * v + 2.0 * a * gap
    reached = square >= 0
    root = torch.sqrt(torch.where(reached, square, 1.0).clamp_min(1e-20))
    rising, pulled = (v > 0) & reached, (v <= 0) & (a > 0)
    straight = 2.0 * gap / torch.where(rising, v + root, 1.0)
    around = (root - v) / torch.where(pulled, a, 1.0)
    wait = torch.where(rising, straight, torch.where(pulled, around, _NEVER))
    return wait.clamp_max(_NEVER)


def _draw(count: int, outside: bool, generator: torch.Generator) -> Tensor:
    size = 5.0 * (1.0 - torch.rand(count, dtype=torch.float64, generator=generator))
    eighths = torch.tensor(_OUTSIDE if outside else _INSIDE, dtype=torch.float64)
    angle = eighths[torch.randint(len(eighths), (count,), generator=generator)] * math.pi / 8
    return torch.stack([size, size * torch.cos(angle), size * torch.sin(angle)], dim=-1)


def _law(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    return torch.cat([state[..., 2:], p], dim=-1)


def _partial(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    return torch.cat([state[..., 2:], torch.zeros_like(p), -p], dim=-1)


def _kinematics(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    return torch.cat([state[..., 2:], torch.zeros_like(state[..., 2:])], dim=-1)


def _missing(states: Tensor, p: Tensor) -> Tensor:
    """(gx, gy + G), the same at all times."""
    found = torch.stack([p[..., 1], p[..., 2] + p[..., 0]])
    return found.expand(2, *states.shape[:-1])


BOUNCING_BALL = Physics(
    name="bouncing_ball",
    states=("x", "y", "vx", "vy"),
    times=torch.arange(25) * 0.1,
    ranges=_RANGES,
    draw_truth=_draw,
    law=_law,
    full=("gx", "gy"),
    partial=_partial,
    known=("G",),
    kinematics=_kinematics,
    initial=uniform((-4.0, 4.0), (-4.0, 4.0), (0.0, 0.0), (0.0, 0.0)),
    centre=(0.0, 0.0, 0.0, 0.0),
    reach=(4.0, 4.0, 1.0, 1.0),
    emission=Blobs(lambda states: states[..., None, :2] / 6.0, sigma=0.16),
    residual=Residual(lambda state, forcing, p: p[..., 0][None] / 5.0, 1, 2, into_rows(2, 3), bound=30.0),
    everything=Residual(lambda state, forcing, p: torch.ones_like(state[..., 0])[None], 1, 2, into_rows(2, 3), 30.0),
    missing=_missing,
    energy=lambda states, p: 0.5 * states[..., 2:].square().sum(-1) - (p[..., 1:] * states[..., :2]).sum(-1),
    flow=Bounces(),
    sizes=(260, 81),
    seen=(0, 1),
)
