"""Two pendulums in a chain, whose masses the partial law takes to be equal.

With c = cos(phi1 - phi2), s = sin(phi1 - phi2), m = m1 / m2, L1 = L2 = 1.5:

    phi1'' = (G sin phi2 c - s (L1 phi1'^2 c + L2 phi2'^2) - (m + 1) G sin phi1) / (L1 (m + s^2))
    phi2'' = ((m + 1)(L1 phi1'^2 s - G sin phi2 + G sin phi1 c) + L2 phi2'^2 s c) / (L2 (m + s^2))

The partial law has m = 1. G in [5, 15]; m in [0.5, 1.5], out of distribution (1.5, 2]; 40 frames of 0.1 s.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from petkin.hybrid import Residual, RungeKutta, into_rows
from petkin_bench.systems.blobs import Blobs
from petkin_bench.systems.physics import Physics, Range, sees, uniform, uniform_truth

_LENGTH = 1.5
#: Length of an arm on the canvas.
_ARM = 0.43

_RANGES = (
    Range("G", "m/s^2", (5.0, 15.0), (5.0, 15.0), "gravity"),
    Range("m", "1", (0.5, 1.5), (1.5, 2.0), "mass ratio m1/m2"),
)


def _accelerations(state: Tensor, G: Tensor, m: Tensor | float) -> tuple[Tensor, Tensor]:
    first, second, fast1, fast2 = state.unbind(-1)
    c, s = torch.cos(first - second), torch.sin(first - second)
    sin1, sin2 = torch.sin(first), torch.sin(second)
    swing1, swing2 = _LENGTH * fast1**2, _LENGTH * fast2**2
    below = _LENGTH * (m + s * s)
    one = (G * sin2 * c - s * (swing1 * c + swing2) - (m + 1.0) * G * sin1) / below
    two = ((m + 1.0) * (swing1 * s - G * sin2 + G * sin1 * c) + swing2 * s * c) / below
    return one, two


def _full(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    return torch.stack([state[..., 2], state[..., 3], *_accelerations(state, p[..., 0], p[..., 1])], dim=-1)


def _partial(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    return torch.stack([state[..., 2], state[..., 3], *_accelerations(state, p[..., 0], 1.0)], dim=-1)


def _missing(states: Tensor, p: Tensor) -> Tensor:
    full, partial = _accelerations(states, p[..., 0], p[..., 1]), _accelerations(states, p[..., 0], 1.0)
    return torch.stack([a - b for a, b in zip(full, partial)])


def _place(states: Tensor) -> Tensor:
    arms = _ARM * torch.stack([torch.sin(states[..., :2]), torch.cos(states[..., :2])], dim=-1)
    return arms.cumsum(dim=-2)


def _energy(states: Tensor, p: Tensor) -> Tensor:
    """Over m2 and, for both, over L^2."""
    first, second, fast1, fast2 = states.unbind(-1)
    G, m = p[..., 0], p[..., 1]
    moving = 0.5 * m * fast1**2 + 0.5 * (fast1**2 + fast2**2 + 2.0 * fast1 * fast2 * torch.cos(first - second))
    return moving - G / _LENGTH * ((m + 1.0) * torch.cos(first) + torch.cos(second))


DOUBLE_PENDULUM = Physics(
    name="double_pendulum",
    states=("phi1", "phi2", "phi1'", "phi2'"),
    times=torch.arange(40) * 0.1,
    ranges=_RANGES,
    draw_truth=uniform_truth(_RANGES),
    law=_full,
    full=tuple(r.symbol for r in _RANGES),
    partial=_partial,
    kinematics=None,
    known=("G",),
    initial=uniform((-0.5 * math.pi, 0.5 * math.pi), (-math.pi / 8, math.pi / 8), (0.0, 0.0), (0.0, 0.0)),
    centre=(0.0, 0.0, 0.0, 0.0),
    reach=(1.0, 1.0, 1.0, 1.0),
    emission=Blobs(_place, channel=(0, 1), channels=3),
    residual=Residual(sees((0, 1, 2, 3), (1.0, 1.0, 3.0, 3.0)), 4, 2, into_rows(2, 3), bound=40.0),
    everything=Residual(sees((0, 1, 2, 3), (1.0, 1.0, 3.0, 3.0)), 4, 4, into_rows(0, 1, 2, 3), bound=60.0),
    missing=_missing,
    energy=_energy,
    flow=RungeKutta(2),
    sizes=(165, 77),
    seen=(0, 1),
)
