"""How good a prediction is: errors of observations, states, parameters and f_NN, and how long it stays valid.

Valid prediction time: the share of a series before the first frame whose error, relative to the frame's own mean
square, exceeds a threshold (Botev A et al. Which priors matter? NeurIPS 2021, arXiv:2111.05458: 0.025). For states the
error is relative to their variance over the data, component by component.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from petkin.hybrid.episodes import Dataset
from petkin.hybrid.model import Identifier
from petkin.hybrid.strategies import Strategy

VALID = 0.025


def valid_share(exceeded: Bool[Tensor, "*b T"]) -> Float[Tensor, "*b"]:
    """Share of the frames before the first that exceeds the threshold; 1 where none does."""
    return (exceeded.to(torch.int64).cumsum(dim=-1) == 0).float().mean(dim=-1)


def signal_to_noise(mean_square_error: Float[Tensor, "*b"], peak: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Peak signal-to-noise ratio 10 log10(peak^2 / MSE), dB."""
    return 10.0 * torch.log10(peak**2 / mean_square_error)


@torch.no_grad()
def measure(
    model: Identifier,
    data: Dataset,
    strategy: Strategy,
    k: int,
    *,
    physics: tuple[int, ...],
) -> dict[str, float]:
    """Metrics of predictions over a dataset, dynamics by dynamics.

    Args:
        model: in whatever mode; it is evaluated with its running statistics.
        data: true states and parameters.
        strategy: what every series is predicted from, with k context series.
        physics: which of the full parameters c_p stands for, in its order; empty where it has no counterpart.

    Returns:
        mse_x, mse_z, vpt_x, vpt_z, and where they are defined mse_q (of the states that are seen), mse_cp and mse_f
        (f_NN against what is missing).
    """
    was, _ = model.training, model.eval()
    rows = [_one(model, data, strategy, k, physics, m) for m in range(data.dynamics)]
    model.train(was)
    return {name: sum(row[name] for row in rows) / len(rows) for name in rows[0]}


def _one(
    model: Identifier,
    data: Dataset,
    strategy: Strategy,
    k: int,
    physics: tuple[int, ...],
    m: int,
) -> dict[str, float]:
    task, states, truth = model.task, data.states[m : m + 1], data.truth[m : m + 1]
    observed = task.emission.observe(states)
    found = strategy(model.encode(observed), k, model.aggregate)
    predicted = model.predict(found)
    error = model.squared_error(found, predicted, states)
    spread = data.states.flatten(0, 2).var(dim=0).clamp_min(1e-12)
    off = ((predicted - states) ** 2 / spread).mean(dim=-1)
    row = {
        "mse_x": float(error.mean()),
        "mse_z": float(((predicted - states) ** 2).mean()),
        "vpt_x": float(valid_share(error > VALID * observed.square().flatten(3).mean(dim=-1)).mean()),
        "vpt_z": float(valid_share(off > VALID).mean()),
    }
    if task.seen:
        row["mse_q"] = float(((predicted - states) ** 2)[..., list(task.seen)].mean())
    if physics:
        acting = found.physics if task.meant is None else task.meant(found.physics)
        row["mse_cp"] = float(((acting - truth[:, None, list(physics)]) ** 2).mean())
    if task.residual is not None and task.missing is not None:
        learned = model.residual(found.code, states, found.physics)
        row["mse_f"] = float(((learned - task.missing(states, truth[:, None, None])) ** 2).mean())
    return row
