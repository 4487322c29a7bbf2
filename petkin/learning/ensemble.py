"""Many noisy curves at once: each as the tissues of a population that look like it.

Tissues u_i are drawn once from the prior N(m, P^-1), and their curves x_i computed under the scan's input. What is
told of a curve y of noise variance s^2 then needs no descent:

    E[q | y] = sum_i w_i q_i / sum_i w_i,    w_i = exp(-sum_k W_k (y_k - x_ik)^2 / (2 s^2)),

and its variance likewise. Where s^2 is so small that few tissues count, the weights are tempered to an exponent
lambda < 1 at which enough do, and the rest of the likelihood, (1 - lambda) / s^2, is taken in by a linear update with
the moments of those that count, exact where quantities are linear in curves:

    q + G (y - x),    G = (1 - lambda) C_qx [(1 - lambda) C_xx + s^2]^-1.

Curves are compared along the directions in which drawn ones vary; what of a curve lies outside of these tells s^2.

References: Doucet A, de Freitas N, Gordon N. Sequential Monte Carlo methods in practice. Springer 2001,
doi:10.1007/978-1-4757-3437-9; for the update, Evensen G. Ocean Dyn 2003;53:343-367, doi:10.1007/s10236-003-0036-9.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from petkin.learning.prior import TissuePrior
from petkin.learning.quantities import late_plasma, mean_residual, volume
from petkin.learning.tissue import Conditions

#: Tissues drawn, as many at a time; their number that must count; exponents tried, each a quarter of the one before.
_DRAWN, _AT_A_TIME, _COUNT, _EXPONENTS = 2048, 512, 64, 10
#: Directions of curves; curves at a time.
_DIRECTIONS, _CHUNK = 8, 2048
#: Spread of a logarithm that is no knowledge; logarithm of a weight below which numbers are slow and count for nothing.
_MOST, _LEAST = 10.0, -80.0


@dataclass(frozen=True)
class Ensemble:
    """Drawn tissues and their curves.

    Args:
        root: square roots of the frame weights (K,).
        mean: of the drawn curves, weighted by them (K,).
        directions: in which they vary (K, r).
        curves: along these (M, r).
        quantities: logarithms of K1, k2, vB and VT; mean f_NN; 1 where VT is not at rest, else 0 (M, 6).
        least: smallest s^2: what the prior was learned to.
    """

    root: Float[Tensor, " K"]
    mean: Float[Tensor, " K"]
    directions: Float[Tensor, "K r"]
    curves: Float[Tensor, "M r"]
    quantities: Float[Tensor, "M 6"]
    least: float


def draw_ensemble(
    prior: TissuePrior, conditions: Conditions, amount: float, weights: Float[Tensor, " K"], seed: int = 0
) -> Ensemble:
    """Tissues of the population under one scan's input.

    Args:
        prior: what was learned.
        conditions: the scan's input and frames.
        amount: of the input, at the common level.
        weights: relative inverse variances of frames.
        seed: of the draw.
    """
    generator = torch.Generator().manual_seed(seed)
    spread = torch.linalg.cholesky(torch.linalg.inv(prior.precision))
    u = prior.mean + torch.randn(_DRAWN, len(prior.mean), generator=generator) @ spread.T
    parts = []
    with torch.no_grad():
        for some in u.split(_AT_A_TIME):
            amounts = torch.full((len(some), 1), amount)
            ratio, rests = volume(prior, some, late_plasma(conditions, amounts))
            told = [mean_residual(prior, some, amounts), (~rests).float()]
            positive = torch.cat([prior.physics(some), ratio[:, None]], dim=1).clamp_min(1e-9).log()
            curves = prior.predict(some, amounts)[..., 1]
            parts.append(torch.cat([curves, positive, torch.stack(told, dim=1)], dim=1))
    curves, quantities = torch.cat(parts).double().split([len(weights), 6], dim=1)
    root = weights.double().sqrt()
    mean = (root * curves).mean(dim=0)
    off = root * curves - mean
    count = min(_DIRECTIONS, int(root.count_nonzero()) // 2)
    directions = torch.linalg.svd(off, full_matrices=False).Vh[:count].T
    return Ensemble(root, mean, directions, off @ directions, quantities, float(prior.variance))


def posterior(
    drawn: Ensemble, values: Float[Tensor, "n K"]
) -> tuple[Float[Tensor, "n 5"], Float[Tensor, "n 5"], Float[Tensor, " n"]]:
    """K1, k2, vB, VT, mean f_NN; their percent standard errors; the weighted mean square that is left.

    A value does not depend on what other curves there are, but for rounding by which chunk it falls into.
    """
    parts = [_posterior(drawn, chunk.double()) for chunk in values.split(_CHUNK)]
    found, errors, misfit = (torch.cat(part) for part in zip(*parts))
    return found, errors, misfit


def _posterior(drawn: Ensemble, values: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    off = drawn.root * values - drawn.mean
    seen, frames = off @ drawn.directions, int(drawn.root.count_nonzero())
    outside = (off**2).sum(dim=1) - (seen**2).sum(dim=1)
    noise = (outside / (frames - seen.shape[1])).clamp_min(drawn.least)
    scaled = (seen / noise[:, None]).float()  # single precision: where it would matter, weights are tempered
    likelihood = scaled @ drawn.curves.float().T - 0.5 * (drawn.curves**2).sum(dim=1).float() / noise[:, None].float()
    share, exponent = _shares(likelihood - likelihood.amax(dim=1, keepdim=True))
    mean_x, mean_q, cov_xx, cov_qx, var_q = _moments(share, drawn)
    rest = (1.0 - exponent)[:, None, None]
    eye = torch.eye(seen.shape[1], dtype=seen.dtype)
    system = rest * cov_xx + noise[:, None, None] * eye
    news = torch.linalg.solve(system, rest * torch.cat([cov_xx, cov_qx], dim=1).mT).mT @ (seen - mean_x)[..., None]
    gain = torch.linalg.solve(system, rest * cov_qx.mT).mT
    after_x, after_q = mean_x + news[:, : seen.shape[1], 0], mean_q + news[:, seen.shape[1] :, 0]
    deviation = (var_q - (gain * cov_qx).sum(dim=-1)).clamp_min(0.0).sqrt()
    misfit = (outside + ((seen - after_x) ** 2).sum(dim=1)) / frames
    return *_told(after_q, deviation), misfit


def _shares(logarithms: Float[Tensor, "n M"]) -> tuple[Float[Tensor, "n M"], Float[Tensor, " n"]]:
    """Weights that sum to 1, and the exponent at which enough tissues count."""
    exponent = torch.ones(len(logarithms), dtype=torch.float64)
    weights = logarithms.clamp_min(_LEAST).exp()
    for _ in range(_EXPONENTS):
        few = torch.nonzero(weights.sum(dim=1) ** 2 < _COUNT * torch.linalg.vecdot(weights, weights))[:, 0]
        if not len(few):
            break
        exponent[few] *= 0.25
        weights[few] = (exponent[few, None].float() * logarithms[few]).clamp_min(_LEAST).exp()
    return weights / weights.sum(dim=1, keepdim=True), exponent


def _moments(share: Tensor, drawn: Ensemble) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Means of curves and quantities; covariances of curves, of quantities with curves; variances of quantities."""
    x, q = drawn.curves, drawn.quantities - drawn.quantities.mean(dim=0)
    r, m = x.shape[1], q.shape[1]
    products = [(x[:, :, None] * x[:, None, :]).flatten(1), (q[:, :, None] * x[:, None, :]).flatten(1), q**2]
    found = share @ torch.cat([x, q, *products], dim=1).float()
    mean_x, mean_q, xx, qx, qq = found.double().split([r, m, r * r, m * r, m], dim=1)
    cov_xx = xx.unflatten(1, (r, r)) - mean_x[:, :, None] * mean_x[:, None, :]
    cov_qx = qx.unflatten(1, (m, r)) - mean_q[:, :, None] * mean_x[:, None, :]
    return mean_x, mean_q + drawn.quantities.mean(dim=0), cov_xx, cov_qx, (qq - mean_q**2).clamp_min(0.0)


def _told(mean: Float[Tensor, "n 6"], deviation: Float[Tensor, "n 6"]) -> tuple[Tensor, Tensor]:
    """Values and percent standard errors; no VT where most tissues that count are not at rest."""
    logs, residual = mean[:, :4], mean[:, 4:5]
    moves = mean[:, 5] > 0.5
    values = torch.cat([logs.exp(), residual], dim=1)
    errors = torch.cat([deviation[:, :4].clamp_max(_MOST), deviation[:, 4:5] / residual.abs().clamp_min(1e-9)], dim=1)
    values[moves, 3], errors[moves, 3] = torch.nan, torch.nan
    return values, 100.0 * errors
