"""What is told of a learned tissue: c_p, its volume of distribution, and how much f_NN adds."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from petkin.hybrid import HybridField
from petkin.learning.flow import TissueFlow
from petkin.learning.prior import Curves, TissuePrior
from petkin.learning.tissue import Conditions

#: VT is C_T / C_P once both are at rest; fNN the mean over the scan of what is added to K1 C_P - k2 C_T.
REPORTED = ("K1", "k2", "vB", "VT", "fNN")
#: Step in u of differences; hours of constant plasma and the step (min) that VT is told by.
_STEP, _HOURS, _EULER = 1e-2, 10.0, 0.5


def late_plasma(conditions: Conditions, amounts: Float[Tensor, "n J"]) -> Float[Tensor, " n"]:
    """Mean C_P over the later half of the scan, at the common level."""
    late = conditions.grid.nodes >= 0.5 * conditions.grid.nodes[-1]
    return (amounts @ conditions.responses.plasma)[:, late].mean(dim=-1)


def tissue_and_residual(
    prior: TissuePrior, u: Float[Tensor, "n v"], amounts: Float[Tensor, "n J"]
) -> tuple[Float[Tensor, "n N"], Float[Tensor, "n N"]]:
    """C_T and f_NN at the nodes."""
    flow, field, physics = prior.task.flow, prior.field(u), prior.physics(u)
    assert isinstance(flow, TissueFlow)
    assert isinstance(field, HybridField)
    linear, _, _ = flow.linear(physics, amounts)
    layers = tuple((matrix[..., None], bias[..., None]) for matrix, bias in field.layers)  # type: ignore[attr-defined]
    states, slopes = flow.march(field.residual, layers, linear, physics, amounts)
    return states[0], slopes + physics[:, 1:2] * (states[0] - linear)


def volume(
    prior: TissuePrior, u: Float[Tensor, "n v"], plasma: Float[Tensor, " n"]
) -> tuple[Float[Tensor, " n"], Bool[Tensor, " n"]]:
    """C_T / C_P after hours of constant plasma, and whether it is at rest: within a percent over the last fifth."""
    field, physics = prior.field(u), prior.physics(u)
    assert isinstance(field, HybridField)
    state, now, path = u.new_zeros(len(u), field.residual.outputs), u.new_zeros(()), []
    for _ in range(round(_HOURS * 60.0 / _EULER)):
        state = state + _EULER * field(now, state, plasma, physics)
        path.append(state[:, 0])
    end, before = path[-1], path[-len(path) // 5]
    return end / plasma, (end - before).abs() < 0.01 * end.abs()


def quantities(
    prior: TissuePrior, u: Float[Tensor, "n v"], amounts: Float[Tensor, "n J"], plasma: Float[Tensor, " n"]
) -> Float[Tensor, "n 5"]:
    """What is `REPORTED` at the common level; VT is NaN where tissue does not come to rest."""
    ratio, rests = volume(prior, u, plasma)
    told = [torch.where(rests, ratio, torch.nan), mean_residual(prior, u, amounts)]
    return torch.cat([prior.physics(u), torch.stack(told, dim=1)], dim=1)


def mean_residual(prior: TissuePrior, u: Float[Tensor, "n v"], amounts: Float[Tensor, "n J"]) -> Float[Tensor, " n"]:
    """Mean of f_NN over the scan."""
    flow = prior.task.flow
    assert isinstance(flow, TissueFlow)
    nodes = flow.grid.nodes.float()
    return torch.trapezoid(tissue_and_residual(prior, u, amounts)[1], nodes, dim=-1) / nodes[-1]


def with_errors(
    prior: TissuePrior, u: Float[Tensor, "n v"], curves: Curves, plasma: Float[Tensor, " n"]
) -> tuple[Float[Tensor, "n 5"], Float[Tensor, "n 5"]]:
    """`quantities`, and 100 |se / value| of them: Gauss-Newton curvature, by differences in u."""
    count = u.shape[1]
    moved = torch.stack([u + sign * _STEP * torch.eye(count)[i] for sign in (1.0, -1.0) for i in range(count)])
    around = torch.cat([u[None], moved]).flatten(0, 1)
    times = 1 + 2 * count
    amounts = curves.amounts.repeat(times, 1)
    frames = prior.predict(around, amounts)[..., 1].unflatten(0, (times, -1))
    values = quantities(prior, around, amounts, plasma.repeat(times)).unflatten(0, (times, -1))
    slopes, ways = (
        ((part[1 : 1 + count] - part[1 + count :]) / (2.0 * _STEP)).movedim(0, -1) for part in (frames, values)
    )
    curvature = slopes.mT @ (curves.weights[..., None] * slopes) / prior.variance + prior.precision
    variance = (ways @ torch.linalg.inv(curvature) * ways).sum(dim=-1)
    return values[0], 100.0 * variance.sqrt() / values[0].abs().clamp_min(1e-9)
