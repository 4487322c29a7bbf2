"""How good a prediction is: errors of observations, states, parameters and f_NN, and how long it stays valid.

Valid prediction time: the share of a series before the first frame whose error, relative to the frame's own mean
square, exceeds a threshold (Botev A et al. Which priors matter? NeurIPS 2021, arXiv:2111.05458: 0.025). For states the
error is relative to their variance over the data, component by component.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from petkin.hybrid.episodes import Dataset
from petkin.hybrid.model import Encoded, Identifier
from petkin.hybrid.refine import refine
from petkin.hybrid.strategies import Strategy

VALID = 0.025
#: Numbers of observations that are refined side by side.
_TOGETHER = 1 << 25


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
    rows = []
    for part in _parts(data, 1, model.device):
        found = strategy(model.encode(model.task.emission.observe(part.states)), k, model.aggregate)
        rows.append(_score(model, found, part, data, physics))
    model.train(was)
    return _means(rows)


@torch.no_grad()
def measure_refined(
    model: Identifier, data: Dataset, k: int, first: int, *, physics: tuple[int, ...], steps: int = 6
) -> dict[str, float]:
    """The same metrics where c_p and c_n are refined on the first k series of each dynamics, and used for its others.

    Of a series that is predicted only z(0) is refined, on what is seen of its first frames.

    Args:
        model, data, physics: see `measure`.
        k: context series.
        first: frames of the others that are seen.
        steps: tried at most, each a look at all that is observed.
    """
    was, _ = model.training, model.eval()
    rows = []
    size = model.task.emission.observe(data.states[0, 0].to(model.device)).numel() * data.series
    for part in _parts(data, max(1, _TOGETHER // size), model.device):
        observed = model.task.emission.observe(part.states)
        said = model.encode(observed)
        context = Encoded(said.initial[:, :k], said.physics[:, :k], said.code[:, :k])
        learned = refine(model, context, observed[:, :k], steps=steps).found
        count = data.series - k
        physics_found, code = (x[:, :1].expand(-1, count, -1) for x in (learned.physics, learned.code))
        others = Encoded(said.initial[:, k:], physics_found, code)
        found = refine(model, others, observed[:, k:, :first], steps=steps, dynamics=False).found
        rows += [_score(model, found, Dataset(part.states[:, k:], part.truth), data, physics)] * part.dynamics
    model.train(was)
    return _means(rows)


def _parts(data: Dataset, size: int, device: torch.device) -> Iterator[Dataset]:
    """Some dynamics after others, where the model is."""
    for states, truth in zip(data.states.split(size), data.truth.split(size)):
        yield Dataset(states, truth).to(device)


def _means(rows: list[dict[str, float]]) -> dict[str, float]:
    return {name: sum(row[name] for row in rows) / len(rows) for name in rows[0]}


def _score(
    model: Identifier, found: Encoded, part: Dataset, data: Dataset, physics: tuple[int, ...]
) -> dict[str, float]:
    """Metrics of what is predicted of a part of the data."""
    task, states, truth = model.task, part.states, part.truth
    predicted = model.predict(found)
    error = model.squared_error(found, predicted, states)
    spread = data.states.flatten(0, 2).var(dim=0).clamp_min(1e-12).to(states)
    off = ((predicted - states) ** 2 / spread).mean(dim=-1)
    row = {
        "mse_x": float(error.mean()),
        "mse_z": float(((predicted - states) ** 2).mean()),
        "vpt_x": float(
            valid_share(error > VALID * task.emission.observe(states).square().flatten(3).mean(dim=-1)).mean()
        ),
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
