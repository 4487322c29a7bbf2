"""A damped pendulum whose damping is not known.

    phi'' = -(G / L) sin phi - beta phi',   L = 2

The partial law has no damping. G in [5, 15]; beta in (0, 1], out of distribution (1, 1.25]; 25 frames of 0.2 s.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from petkin.hybrid import Residual, RungeKutta, into_rows
from petkin_bench.systems.blobs import Blobs
from petkin_bench.systems.physics import Physics, Range, sees, uniform, uniform_truth

_LENGTH = 2.0
#: Length of the arm on the canvas.
_ARM = 0.66

_RANGES = (
    Range("G", "m/s^2", (5.0, 15.0), (5.0, 15.0), "gravity"),
    Range("beta", "1/s", (0.0, 1.0), (1.0, 1.25), "damping"),
)


def _full(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    angle, speed = state.unbind(-1)
    return torch.stack([speed, -p[..., 0] / _LENGTH * torch.sin(angle) - p[..., 1] * speed], dim=-1)


def _partial(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    angle, speed = state.unbind(-1)
    return torch.stack([speed, -p[..., 0] / _LENGTH * torch.sin(angle)], dim=-1)


def _place(states: Tensor) -> Tensor:
    """The bob, hanging down at phi = 0."""
    angle = states[..., 0]
    return torch.stack([_ARM * torch.sin(angle), _ARM * torch.cos(angle)], dim=-1)[..., None, :]


def _energy(states: Tensor, p: Tensor) -> Tensor:
    """Per mass, J/kg."""
    angle, speed = states.unbind(-1)
    return 0.5 * (_LENGTH * speed) ** 2 - p[..., 0] * _LENGTH * torch.cos(angle)


PENDULUM = Physics(
    name="pendulum",
    states=("phi", "phi'"),
    times=torch.arange(25) * 0.2,
    ranges=_RANGES,
    draw_truth=uniform_truth(_RANGES),
    law=_full,
    full=tuple(r.symbol for r in _RANGES),
    partial=_partial,
    kinematics=None,
    known=("G",),
    initial=uniform((-0.5 * math.pi, 0.5 * math.pi), (-2.0, 2.0)),
    centre=(0.0, 0.0),
    reach=(1.0, 2.0),
    emission=Blobs(_place),
    residual=Residual(sees((1,), (2.0,)), 1, 1, into_rows(1), bound=20.0),
    everything=Residual(sees((0, 1), (1.0, 2.0)), 2, 2, into_rows(0, 1), bound=30.0),
    missing=lambda states, p: (-p[..., 1] * states[..., 1])[None],
    energy=_energy,
    flow=RungeKutta(1),
    sizes=(190, 81),
    seen=(0,),
)
