"""A free cube, pushed at one corner by a force that the partial law takes to lie in the plane.

    x' = v,  q' = (omega, 0) q / 2,  m v' = f,  I omega' = (R r) x f - omega x I omega

f = 10 (cos psi sin phi, sin psi sin phi, cos phi) constant in the world, r = (1, 1, 1) / sqrt 3 in the body, m = 8 and
I = 16/3 (eight unit masses at the corners; a cube's inertia is the same about all axes, so omega x I omega = 0). The
partial law has phi = pi / 2. psi in [-pi, pi); phi in (pi/8, pi/2], out of distribution [0, pi/8]; 30 frames of 1/30 s.
q is scalar last.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from petkin.hybrid import Residual, RungeKutta
from petkin_bench.systems.cube import Cube, rotation
from petkin_bench.systems.physics import Physics, Range, uniform

_MASS, _INERTIA, _FORCE = 8.0, 16.0 / 3.0, 10.0
_LEVER = 1.0 / math.sqrt(3.0)
_RANGES = (
    Range("ux", "1", (-1.0, 1.0), (-1.0, 1.0), "direction in the plane, cos psi"),
    Range("uy", "1", (-1.0, 1.0), (-1.0, 1.0), "direction in the plane, sin psi"),
    Range("fx", "N", (-10.0, 10.0), (-4.0, 4.0), "force along x"),
    Range("fy", "N", (-10.0, 10.0), (-4.0, 4.0), "force along y"),
    Range("fz", "N", (0.0, 9.3), (9.2, 10.0), "force along z"),
)
_STATES = ("x", "y", "z", "qx", "qy", "qz", "qw", "vx", "vy", "vz", "wx", "wy", "wz")


def _pushed(force: Tensor, state: Tensor) -> Tensor:
    """What a force at the corner does to the velocities [*b, 13]; linear in the force."""
    lever = (rotation(state[..., 3:7]) @ state.new_full((3, 1), _LEVER)).squeeze(-1)
    turning = torch.linalg.cross(lever.expand(force.shape), force)
    return torch.cat([torch.zeros_like(state[..., :7]), force / _MASS, turning / _INERTIA], dim=-1)


def _kinematics(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    q, w = state[..., 3:7], state[..., 10:]
    turned = 0.5 * torch.cat([w * q[..., 3:] + torch.linalg.cross(w, q[..., :3]), -(w * q[..., :3]).sum(-1, True)], -1)
    return torch.cat([state[..., 7:10], turned, torch.zeros_like(state[..., 7:])], dim=-1)


def _law(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    return _kinematics(t, state, forcing, p) + _pushed(p, state)


def _direction(p: Tensor) -> Tensor:
    return p[..., :2] / p[..., :2].norm(dim=-1, keepdim=True).clamp_min(1e-6)


def _partial(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    force = torch.cat([_FORCE * _direction(p), torch.zeros_like(p[..., :1])], dim=-1)
    return _kinematics(t, state, forcing, p) + _pushed(force, state)


def _draw(count: int, outside: bool, generator: torch.Generator) -> Tensor:
    psi, polar = (torch.rand(count, dtype=torch.float64, generator=generator) for _ in range(2))
    psi = 2.0 * math.pi * psi - math.pi
    low, high = (0.0, math.pi / 8) if outside else (math.pi / 8, math.pi / 2)
    polar = high - (high - low) * polar
    plane = torch.stack([torch.cos(psi), torch.sin(psi)], dim=-1)
    flat = _FORCE * torch.sin(polar)[:, None] * plane
    return torch.cat([plane, flat, _FORCE * torch.cos(polar)[:, None]], dim=-1)


def _missing(states: Tensor, p: Tensor) -> Tensor:
    """Force, full minus partial."""
    gap = torch.cat([p[..., 2:4] - _FORCE * _direction(p), p[..., 4:5]], dim=-1)
    return gap.movedim(-1, 0).expand(3, *states.shape[:-1])


def _sees(state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
    return _direction(p).movedim(-1, 0)


def _push(value: Tensor, state: Tensor) -> Tensor:
    return _pushed(value.movedim(0, -1).expand(*state.shape[:-1], 3), state)


def _energy(states: Tensor, p: Tensor) -> Tensor:
    """Moving and turning, less the work of the force at its corner."""
    lever = (rotation(states[..., 3:7]) @ states.new_full((3, 1), _LEVER)).squeeze(-1)
    moving = 0.5 * (_MASS * states[..., 7:10].square().sum(-1) + _INERTIA * states[..., 10:].square().sum(-1))
    return moving - (p[..., 2:] * (states[..., :3] + lever)).sum(-1)


_REST = [(0.0, 0.0)]
RIGID_BODY = Physics(
    name="rigid_body",
    states=_STATES,
    times=torch.arange(30) / 30.0,
    ranges=_RANGES,
    draw_truth=_draw,
    law=_law,
    full=("fx", "fy", "fz"),
    partial=_partial,
    known=("ux", "uy"),
    kinematics=_kinematics,
    initial=uniform((-1.0, 1.0), (-1.0, 1.0), *_REST * 4, (1.0, 1.0), *_REST * 6),
    centre=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6),
    reach=(1.0, 1.0, *[0.0] * 11),
    emission=Cube(),
    residual=Residual(_sees, 2, 3, _push, bound=40.0),
    everything=Residual(lambda state, forcing, p: torch.ones_like(state[..., 0])[None], 1, 3, _push, bound=40.0),
    missing=_missing,
    energy=_energy,
    flow=RungeKutta(1),
    sizes=(192, 25),
    seen=tuple(range(7)),
    meant=_direction,
    rough=Cube(size=32, soft=0.35),
)
