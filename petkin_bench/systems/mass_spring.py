"""Two masses on a line, joined by a spring and a damper that is not known.

    v1' = -s (k / m1) (|x| - l0) - (beta / m1) v,   v2' = s (k / m2) (|x| - l0) + (beta / m2) v,

x = x1 - x2, v = v1 - v2, s = x / |x|, l0 = 6, m1 = m2 = 1. The partial law has no damper. k in [5, 15]; beta in (0, 1],
out of distribution (1, 1.5]; 25 frames of 0.2 s.
"""

from __future__ import annotations

import torch
from torch import Tensor

from petkin.hybrid import Residual, RungeKutta, into_rows
from petkin_bench.systems.blobs import Blobs
from petkin_bench.systems.physics import Physics, Range, sees, uniform, uniform_truth

_REST = 6.0
#: Half the canvas, m.
_CANVAS = 6.0

_RANGES = (
    Range("k", "1/s^2", (5.0, 15.0), (5.0, 15.0), "stiffness"),
    Range("beta", "1/s", (0.0, 1.0), (1.0, 1.5), "damping"),
)


def _spring(state: Tensor, k: Tensor) -> Tensor:
    """Acceleration of the first mass by the spring."""
    apart = state[..., 0] - state[..., 1]
    return -torch.sign(apart) * k * (apart.abs() - _REST)


def _full(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    first = _spring(state, p[..., 0]) - p[..., 1] * (state[..., 2] - state[..., 3])
    return torch.stack([state[..., 2], state[..., 3], first, -first], dim=-1)


def _partial(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    first = _spring(state, p[..., 0])
    return torch.stack([state[..., 2], state[..., 3], first, -first], dim=-1)


def _place(states: Tensor) -> Tensor:
    across = states[..., :2] / _CANVAS
    return torch.stack([across, torch.zeros_like(across)], dim=-1)


def _energy(states: Tensor, p: Tensor) -> Tensor:
    stretch = (states[..., 0] - states[..., 1]).abs() - _REST
    return 0.5 * (states[..., 2] ** 2 + states[..., 3] ** 2) + 0.5 * p[..., 0] * stretch**2


def _missing(states: Tensor, p: Tensor) -> Tensor:
    damped = p[..., 1] * (states[..., 2] - states[..., 3])
    return torch.stack([-damped, damped])


MASS_SPRING = Physics(
    name="mass_spring",
    states=("x1", "x2", "v1", "v2"),
    times=torch.arange(25) * 0.2,
    ranges=_RANGES,
    draw_truth=uniform_truth(_RANGES),
    law=_full,
    full=tuple(r.symbol for r in _RANGES),
    partial=_partial,
    kinematics=None,
    known=("k",),
    initial=uniform((-4.0, -2.0), (2.0, 4.0), (0.0, 0.0), (0.0, 0.0)),
    centre=(-3.0, 3.0, 0.0, 0.0),
    reach=(1.0, 1.0, 1.0, 1.0),
    emission=Blobs(_place, channel=(0, 1), channels=3),
    residual=Residual(sees((2, 3), (2.0, 2.0)), 2, 2, into_rows(2, 3), bound=30.0),
    everything=Residual(sees((0, 1, 2, 3), (3.0, 3.0, 2.0, 2.0)), 4, 4, into_rows(0, 1, 2, 3), bound=60.0),
    missing=_missing,
    energy=_energy,
    flow=RungeKutta(2),
    sizes=(160, 81),
    seen=(0, 1),
)
