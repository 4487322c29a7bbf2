"""From known inputs to frames: the linear part in closed form, the residual's part on a grid, all times at once.

With the prior a sum of exponentials, C = sum_i phi_i e^{-a_i t} * C_P + R, and only

    dR/dt = -k R + f(C_linear + R),    R(0) = 0

is integrated: exactly for f in straight lines between the nodes. The states at all nodes are the unknowns of one
system, solved by Newton's method: every pass evaluates f and its derivative at all nodes in a few large operations
and follows a linear recurrence. The last pass alone is differentiated: at the solution its derivative is that of the
solution (implicit function theorem), so gradients cost one pass whatever the number of passes.

References: Hochbruck M, Ostermann A. Exponential integrators. Acta Numer 2010;19:209-286,
doi:10.1017/S0962492910000048. Lim YH et al. Parallelizing non-linear sequential models over the sequence length.
ICLR 2024, arXiv:2309.12252.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from petkin.dynamics import VectorField
from petkin.hybrid import HybridField, Residual
from petkin.kinetics import CompartmentModel
from petkin.learning.grid import Grid
from petkin.learning.responses import Responses

#: Newton's method ends where no state moves by more than this (in the curve's unit) or after so many passes.
_TOLERANCE, _PASSES = 1e-2, 12
#: Largest slope of f times the later weight of a step.
_MOST = 0.4

Layers = tuple[tuple[Tensor, Tensor], ...]


@dataclass(frozen=True)
class TissueFlow:
    """Frames of a tissue curve under a compartment model, with or without a residual.

    Initial states are (0, 0, g_1 .. g_J): C_T, the last frame's mean, and the amounts of the known inputs. Where the
    residual has two outputs, the second is the derivative of an unseen compartment that starts at 0.

    Args:
        model: the linear part, or None for none.
        responses: its answers to the inputs.
        grid: of the residual.
        blood: whether the last parameter is vB.
    """

    model: CompartmentModel | None
    responses: Responses
    grid: Grid
    blood: bool = False

    def __call__(self, field: VectorField, initial: Tensor, parameters: Tensor, times: Tensor, /) -> Tensor:
        """C_T at the frames' ends, frame values, and the inputs' amounts again [*b, frames, 2 + J]."""
        amounts = initial[..., 2:]
        linear, at_ends, means = self.linear(parameters, amounts)
        if isinstance(field, HybridField):
            layers = tuple((matrix[..., None], bias[..., None]) for matrix, bias in field.layers)  # type: ignore[attr-defined]
            states, slopes = self.march(field.residual, layers, linear, parameters, amounts)
            more_at_ends, more = self.grid.read(states[0] - linear, slopes, amounts)
            at_ends, means = at_ends + more_at_ends, means + more
        if self.blood:
            vB = parameters[..., -1:]
            means = (1.0 - vB) * means + vB * (amounts @ self.responses.blood)
        count = len(times)
        told = amounts[..., None, :].expand(*amounts.shape[:-1], count, -1)
        return torch.cat([at_ends[..., :count, None], means[..., :count, None], told], dim=-1)

    def linear(self, parameters: Tensor, amounts: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The linear part at nodes, frame ends and over frames."""
        if self.model is None:
            nodes, ends, frames = self.responses.parts
            return tuple(amounts.new_zeros(*amounts.shape[:-1], n) for n in (nodes, ends, frames))  # type: ignore[return-value]
        phi, rate = zip(*self.model.impulse(*parameters[..., : self.model.rates].unbind(-1)))
        parts = self.responses(torch.stack(rate, dim=-1), amounts)
        scale = torch.stack(phi, dim=-1)[..., None]
        return tuple((scale * part).sum(dim=-2) for part in parts)  # type: ignore[return-value]

    def march(
        self, residual: Residual, layers: Layers, linear: Tensor, parameters: Tensor, amounts: Tensor
    ) -> tuple[Float[Tensor, "r *b N"], Float[Tensor, "*b N"]]:
        """States at the nodes (C_T, then what is hidden), and the slope of R there."""
        hidden = residual.outputs - 1
        k = parameters[..., 1] if self.model is not None else linear.new_zeros(linear.shape[:-1])
        base = torch.stack([linear, *[torch.zeros_like(linear)] * hidden])
        steps = _Steps.of(torch.stack([k, *[torch.zeros_like(k)] * hidden]), self.grid.steps)
        seen = (amounts @ self.responses.plasma, parameters[..., None, :])
        held = tuple((matrix.detach(), bias.detach()) for matrix, bias in layers)
        with torch.no_grad():
            states = _settle(residual, held, base, steps, seen)
        value, jacobian = _value_and_jacobian(residual, layers, states, seen)
        answer = base + steps.solve(value, jacobian, base - states)
        driven = value[0] + (jacobian[0] * (answer - states)).sum(dim=0)
        return answer, driven - k[..., None] * (answer[0] - linear)


def _settle(residual: Residual, layers: Layers, base: Tensor, steps: _Steps, seen: tuple[Tensor, Tensor]) -> Tensor:
    """States at the nodes, by Newton's method from the linear part."""
    states = base
    for _ in range(_PASSES):
        value, jacobian = _value_and_jacobian(residual, layers, states, seen)
        new = base + steps.solve(value, jacobian, base - states)
        moved, states = float((new - states).abs().max()), new
        if moved < _TOLERANCE:
            break
    return states


def _value_and_jacobian(
    residual: Residual, layers: Layers, states: Float[Tensor, "r *b N"], seen: tuple[Tensor, Tensor]
) -> tuple[Float[Tensor, "r *b N"], Float[Tensor, "r r *b N"]]:
    """f, which carries gradients to its weights, and df/dz, which does not, at every node."""
    with torch.enable_grad():
        at = states.detach().requires_grad_()
        rows = residual.rows(layers, at.movedim(0, -1), *seen)
        slopes = [torch.autograd.grad(row.sum(), at, retain_graph=True)[0] for row in rows]
        value = torch.stack(rows)
    return value, torch.stack(slopes)


@dataclass(frozen=True)
class _Steps:
    """Exact steps of dR/dt = -k R + f, f straight between nodes: R' = E R + w0 f + w1 f', component by component."""

    keep: Float[Tensor, "r *b J"]
    early: Float[Tensor, "r *b J"]
    late: Float[Tensor, "r *b J"]

    @classmethod
    def of(cls, rates: Float[Tensor, "r ..."], steps: Float[Tensor, " J"]) -> _Steps:
        h = steps.to(torch.float64)
        x = (rates.to(torch.float64)[..., None] * h).clamp_min(1e-4)
        first = -torch.expm1(-x) / x
        second = (1.0 - first) / x
        parts = (torch.exp(-x), h * (first - second), h * second)
        return cls(*(part.to(rates.dtype) for part in parts))

    def solve(
        self, value: Float[Tensor, "r *b N"], jacobian: Float[Tensor, "r r *b N"], off: Float[Tensor, "r *b N"]
    ) -> Float[Tensor, "r *b N"]:
        """R at the nodes for f = value + jacobian (off + R), off = C_linear minus where f was taken.

        An f that feeds back on itself within one step is followed with a smaller slope: Newton's method would leave
        the numbers before f reaches its bound.
        """
        one = torch.eye(len(value), dtype=value.dtype, device=value.device).reshape(
            len(value), len(value), *[1] * (value.ndim - 1)
        )
        most = _MOST / torch.nn.functional.pad(self.late, (1, 0), value=1e-3)[:, None]
        jacobian = torch.minimum(jacobian, most)
        jacobian = torch.where(one > 0, jacobian, torch.maximum(jacobian, -most))
        straight = value + _times(jacobian, off)
        inverse = _inverse(one - self.late[:, None] * jacobian[..., 1:])
        carried = self.keep[:, None] * one + self.early[:, None] * jacobian[..., :-1]
        forcing = self.early * straight[..., :-1] + self.late * straight[..., 1:]
        return _walk(_product(inverse, carried), _times(inverse, forcing))


def _inverse(matrices: Float[Tensor, "r r ..."]) -> Float[Tensor, "r r ..."]:
    """Of a number, or of two rows of two."""
    if len(matrices) == 1:
        return 1.0 / matrices
    (a, b), (c, d) = matrices
    return torch.stack([torch.stack([d, -b]), torch.stack([-c, a])]) / (a * d - b * c)


def _times(matrices: Float[Tensor, "r r ..."], vectors: Float[Tensor, "r ..."]) -> Float[Tensor, "r ..."]:
    return (matrices * vectors).sum(dim=1)


def _product(left: Float[Tensor, "r r ..."], right: Float[Tensor, "r r ..."]) -> Float[Tensor, "r r ..."]:
    return (left[:, :, None] * right).sum(dim=1)


def _walk(factors: Float[Tensor, "r r *b J"], values: Float[Tensor, "r *b J"]) -> Float[Tensor, "r *b N"]:
    """All states of y_{j+1} = F_j y_j + v_j from y_0 = 0, in log2(J) passes."""
    span = 1
    while span < values.shape[-1]:
        later = factors[..., span:]
        values = torch.cat([values[..., :span], values[..., span:] + _times(later, values[..., :-span])], dim=-1)
        factors = torch.cat([factors[..., :span], _product(later, factors[..., :-span])], dim=-1)
        span *= 2
    return torch.nn.functional.pad(values, (1, 0))
