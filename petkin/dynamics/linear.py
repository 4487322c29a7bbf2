"""Exact solution of a linear system by the matrix exponential: slower than a closed form, and independent of it.

Between two nodes the input solves a linear equation itself, w' = W w and u = r.w: w = (u, u') where it is a straight
line, w_k = c n! s^k e^{l s} / k! (k = 0..n) where it is a term c s^n e^{l s}. State and input then obey z' = M z with

    M = [[A, b r], [0, W]],    z(t + h) = exp(M h) z(t),

and the decayed integral comes from one more augmentation, exp([[M - lam, 0], [P, 0]] h), P z = x. No eigenvalue is
ever divided by, so that equal rates, zero rates and rates at the input's own poles are nothing special.

Reference: Van Loan CF. Computing integrals involving the matrix exponential. IEEE Trans Automat Contr 1978;23:395-404.
doi:10.1109/TAC.1978.1101743
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from petkin.dynamics.forcing import ExponentialSum, Forcing, PiecewiseLinear, Shifted
from petkin.errors import InputError


def solve_linear(
    matrix: Float[Tensor, "*#b d d"],
    drive: Float[Tensor, "*#b d"],
    forcing: Forcing,
    times: Float[Tensor, " times"],
    *,
    initial: Float[Tensor, "*#b d"] | None = None,
) -> Float[Tensor, "*#b times d"]:
    """x(t) of dx/dt = A x + b u(t), x(0) = initial, exactly.

    Args:
        matrix: A (1/time).
        drive: b.
        forcing: u, a `PiecewiseLinear`, an `ExponentialSum`, or one of them `Shifted`; its batch is broadcast.
        times: where x is wanted, >= 0, in any order.
        initial: x(0); by default the system rests until the forcing sets in, even if that is before time 0.

    Returns:
        x at the times.

    Raises:
        InputError: another kind of forcing, times before the start, or shapes that do not fit.

    Reference: see the module.
    """
    march = _march(matrix, drive, forcing, times, initial)
    return march.states[..., march.order, : matrix.shape[-1]]


def integrate_linear(
    matrix: Float[Tensor, "*#b d d"],
    drive: Float[Tensor, "*#b d"],
    forcing: Forcing,
    times: Float[Tensor, " times"],
    *,
    initial: Float[Tensor, "*#b d"] | None = None,
    decay: float = 0.0,
) -> Float[Tensor, "*#b times d"]:
    """int_start^t e^{-decay s} x(s) ds of the solution of `solve_linear`, exactly.

    Args:
        matrix: A (1/time).
        drive: b.
        forcing: u.
        times: ends of the integrals.
        initial: x(0).
        decay: rate of the weight, 1/time.

    Returns:
        The integrals at the times, from 0 (from the forcing's onset where that is earlier and nothing is said of x(0)).

    Raises:
        InputError: as `solve_linear`.

    Reference: see the module.
    """
    march = _march(matrix, drive, forcing, times, initial)
    d, size = matrix.shape[-1], march.generator.shape[-1]
    sunk = march.generator - decay * torch.eye(size, dtype=matrix.dtype, device=matrix.device)
    above = torch.cat([sunk, sunk.new_zeros(*sunk.shape[:-1], d)], dim=-1)
    below = torch.eye(d, size + d, dtype=matrix.dtype, device=matrix.device).expand(*sunk.shape[:-2], d, size + d)
    whole = torch.linalg.matrix_exp(torch.cat([above, below], dim=-2)[..., None, :, :] * march.steps[:, None, None])
    pieces = (whole[..., size:, :size] @ march.states[..., :-1, :, None])[..., 0]
    weight = torch.exp(-decay * march.nodes[:-1]).to(matrix.dtype)
    total = torch.cumsum(pieces * weight[:, None], dim=-2)
    return torch.cat([total.new_zeros(*total.shape[:-2], 1, d), total], dim=-2)[..., march.order, :]


@dataclass(frozen=True)
class _March:
    """State and input at every node, the input as it leaves the node (at the last one it is not used)."""

    generator: Float[Tensor, "*#b n n"]
    nodes: Float[Tensor, " nodes"]
    states: Float[Tensor, "*#b nodes n"]
    order: Tensor

    @property
    def steps(self) -> Tensor:
        return torch.diff(self.nodes).to(self.generator.dtype)


@dataclass(frozen=True)
class _Tail:
    """The input as a linear system of its own: W, r, and w at the start of every piece."""

    generator: Float[Tensor, "*#b m m"]
    readout: Float[Tensor, "*#b m"]
    starts: Float[Tensor, "*#b pieces m"]


def _march(matrix: Tensor, drive: Tensor, forcing: Forcing, times: Tensor, initial: Tensor | None) -> _March:
    _check_shapes(matrix, drive, initial)
    own = times.detach().to(matrix.device, torch.float64)
    knots = torch.as_tensor(forcing.knots).detach().to(matrix.device, torch.float64)
    start = 0.0 if initial is not None else min(0.0, float(knots[0]))
    if bool((own < start).any()):
        raise InputError(f"A solution is asked for at t = {float(own.min()):g}, before its start at t = {start:g}.")
    inside = knots[(knots > start) & (knots < own.max())]
    nodes = torch.unique(torch.cat([own.new_tensor([start]), inside, own]))
    tail = _tail(forcing, nodes)
    generator = _joined(matrix, drive, tail)
    rest = matrix.new_zeros(matrix.shape[-1]) if initial is None else initial.to(matrix)
    states = _propagated(generator, tail, rest, torch.diff(nodes).to(matrix.dtype))
    return _March(generator, nodes, states, torch.searchsorted(nodes, own))


def _tail(forcing: Forcing, nodes: Tensor) -> _Tail:
    base, delay = forcing, nodes.new_zeros(1)
    while isinstance(base, Shifted):
        delay, base = (
            delay + torch.as_tensor(base.delay, dtype=nodes.dtype, device=nodes.device)[..., None],
            base.forcing,
        )
    if isinstance(base, PiecewiseLinear):
        return _straight_lines(forcing, nodes)
    if isinstance(base, ExponentialSum):
        return _exponentials(base, nodes - base.onset - delay)
    raise InputError(
        f"The matrix exponential solves for piecewise-linear and exponential inputs, not for {type(base).__name__}; "
        "sample it at knots, or use solve()."
    )


def _joined(matrix: Tensor, drive: Tensor, tail: _Tail) -> Tensor:
    """M of the module."""
    coupling = drive[..., :, None] * tail.readout[..., None, :]
    batch = np.broadcast_shapes(matrix.shape[:-2], coupling.shape[:-2], tail.generator.shape[:-2])
    d, m = coupling.shape[-2:]
    top = torch.cat([matrix.expand(*batch, d, d), coupling.expand(*batch, d, m)], dim=-1)
    bottom = torch.cat([matrix.new_zeros(*batch, m, d), tail.generator.expand(*batch, m, m)], dim=-1)
    return torch.cat([top, bottom], dim=-2)


def _propagated(generator: Tensor, tail: _Tail, state: Tensor, steps: Tensor) -> Tensor:
    transitions = torch.linalg.matrix_exp(generator[..., None, :, :] * steps[:, None, None])
    d = state.shape[-1]
    batch = np.broadcast_shapes(generator.shape[:-2], tail.starts.shape[:-2], state.shape[:-1])
    x, path = state.expand(*batch, d), []
    starts = tail.starts.expand(*batch, *tail.starts.shape[-2:])
    for i in range(steps.numel()):
        path.append(torch.cat([x, starts[..., i, :]], dim=-1))
        x = (transitions[..., i, :d, :] @ path[-1][..., None])[..., 0]
    path.append(torch.cat([x, starts.new_zeros(*batch, starts.shape[-1])], dim=-1))
    return torch.stack(path, dim=-2)


def _straight_lines(forcing: Forcing, nodes: Tensor) -> _Tail:
    """w = (u, u'), read well inside the pieces: at their ends a doubled knot has two values."""
    at = torch.as_tensor(forcing.knots).dtype
    steps = torch.diff(nodes)
    early, late = (forcing((nodes[:-1] + part * steps).to(at)) for part in (0.25, 0.75))
    half = late - early
    starts = torch.stack([early - 0.5 * half, 2.0 * half / steps.to(half.dtype)], dim=-1)
    generator = starts.new_tensor([[0.0, 1.0], [0.0, 0.0]])
    return _Tail(generator, starts.new_tensor([1.0, 0.0]), starts)


def _exponentials(forcing: ExponentialSum, since: Float[Tensor, "*b nodes"]) -> _Tail:
    """w_k = c n! s^k e^{l s} / k! of every term at time s since the onset, one Jordan block a term."""
    batch = np.broadcast_shapes(forcing.coefficients.shape[:-1], forcing.exponents.shape[:-1])
    on = since[..., :-1] + since[..., 1:] > 0  # by the middle of the piece: its start may miss the onset by rounding
    elapsed = since[..., :-1].clamp(min=0.0).to(forcing.coefficients.dtype)
    blocks, reads, starts = [], [], []
    for j, n in enumerate(forcing.powers):
        c, e = forcing.coefficients[..., j].expand(batch), forcing.exponents[..., j].expand(batch)
        unit = torch.eye(n + 1, dtype=elapsed.dtype, device=elapsed.device)
        blocks.append(e[..., None, None] * unit + torch.diag(elapsed.new_ones(n), -1))
        reads.append(unit[n].expand(*batch, -1))
        terms = torch.stack([elapsed**k / math.factorial(k) for k in range(n + 1)], dim=-1) * on[..., None]
        # The coefficient scales w, not r: large entries of M would cost digits in its exponential.
        scale = math.factorial(n) * c[..., None] * torch.exp(e[..., None] * elapsed)
        starts.append(scale[..., None] * terms)
    return _Tail(_block_diagonal(blocks), torch.cat(reads, dim=-1), torch.cat(starts, dim=-1))


def _block_diagonal(blocks: list[Float[Tensor, "*b _ _"]]) -> Float[Tensor, "*b m m"]:
    size, first, rows = sum(block.shape[-1] for block in blocks), 0, []
    for block in blocks:
        last = first + block.shape[-1]
        rows.append(torch.nn.functional.pad(block, (first, size - last)))
        first = last
    return torch.cat(rows, dim=-2)


def _check_shapes(matrix: Tensor, drive: Tensor, initial: Tensor | None) -> None:
    d = matrix.shape[-1]
    wrong = matrix.ndim < 2 or matrix.shape[-2] != d or drive.shape[-1:] != (d,)
    if wrong or (initial is not None and initial.shape[-1:] != (d,)):
        raise InputError(
            f"A linear system needs a square matrix and vectors of its size; got matrix {tuple(matrix.shape)}, drive "
            f"{tuple(drive.shape)}, initial state {None if initial is None else tuple(initial.shape)}."
        )
