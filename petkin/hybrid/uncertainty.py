"""How far off an identification may be: a head that is taught the size of a trained model's own errors.

The model is left as it is. On dynamics that it was not trained on, whose truth is known (simulated ones are), a small
network learns the standard deviation of its errors by their Gaussian likelihood,

    min mean( log s + e^2 / (2 s^2) ),

from what the context series say together, how far they disagree, and how many they are: few series that disagree are
trusted less. An interval for another series of other dynamics is the prediction +- 1.645 s (90 %).

Reference: Nix DA, Weigend AS. Estimating the mean and variance of the target probability distribution. ICNN 1994.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from petkin.hybrid.episodes import Dataset, of_others
from petkin.hybrid.model import Encoded, Identifier
from petkin.hybrid.strategies import meta

#: Disagreement of codes below which series count as one voice; e-folds by which a spread may leave the usual one.
_AGREED, _FOLDS = 1e-3, 3.0


@dataclass(frozen=True)
class Spread:
    """Standard deviations of errors, or errors.

    Args:
        physics: of c_p (*b, p), in its units; p = 0 where c_p has no known truth.
        states: of predicted states (*b, T, d).
        residual: of f_NN along the series (*b, r) or (*b, T, r); r = 0 where its truth is not known.
    """

    physics: Float[Tensor, "*b p"]
    states: Float[Tensor, "*b T d"]
    residual: Float[Tensor, "... r"]


class ErrorBars(nn.Module):
    """Standard deviations from contexts; made by `teach_error_bars`.

    Args:
        model: whose errors they are; it is not part of what is trained or kept.
        usual: root mean squares over the dynamics that it was taught on.
    """

    def __init__(self, model: Identifier, usual: Spread, *, width: int = 16) -> None:
        super().__init__()
        self.sizes = [part.numel() for part in (usual.physics, usual.states, usual.residual)]
        self.frames = usual.states.shape[0]
        inputs = 2 * (len(model.task.parameters) + _codes(model)) + 1
        last = nn.Linear(width, sum(self.sizes))
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.layers = nn.Sequential(nn.Linear(inputs, width), nn.SiLU(), last)
        self.usual: Tensor
        flat = torch.cat([part.flatten() for part in (usual.physics, usual.states, usual.residual)])
        self.register_buffer("usual", flat.clamp_min(1e-9).log())

    def forward(self, features: Float[Tensor, "*b f"]) -> Spread:
        spread = torch.exp(self.usual + _FOLDS * torch.tanh(self.layers(features) / _FOLDS))
        physics, states, residual = spread.split(self.sizes, dim=-1)
        return Spread(physics, states.unflatten(-1, (self.frames, -1)), residual)


def context_features(model: Identifier, said: Encoded, k: int) -> Float[Tensor, "D S f"]:
    """What k others say together, how far they disagree, and how many they are."""
    level = (said.physics - model.lower) / model.span
    codes = torch.cat([level, said.code], dim=-1)
    apart = of_others(codes, k, lambda several: several.var(dim=-2, correction=0).sqrt())
    count = torch.full_like(codes[..., :1], k).log()
    return torch.cat([of_others(codes, k), torch.log(apart + _AGREED) / 2.0, count], dim=-1)


def errors_of(model: Identifier, data: Dataset, said: Encoded, k: int, physics: Sequence[int]) -> Spread:
    """Errors of predictions from k others, (M, S), as `measure` counts them."""
    found = meta(said, k, model.aggregate)
    predicted, truth = model.predict(found), data.truth[:, None]
    off = found.physics - truth[..., list(physics)] if physics else found.physics[..., :0]
    missing = model.task.missing
    learned = predicted[..., :0]
    if missing is not None and model.task.residual is not None:
        value = model.residual(found.code, data.states, found.physics) - missing(data.states, truth[:, :, None])
        learned = value.movedim(0, -1)
    return Spread(off, predicted - data.states, learned)


def teach_error_bars(
    model: Identifier,
    data: Dataset,
    *,
    contexts: Sequence[int],
    physics: Sequence[int],
    steps: int = 400,
    rate: float = 1e-2,
    seed: int = 0,
) -> ErrorBars:
    """Learn the spread of a model's errors.

    Args:
        model: trained, set to be evaluated.
        data: dynamics that it was not trained on.
        contexts: numbers of context series k to learn for.
        physics: which of the full parameters c_p stands for; empty where it has no counterpart.
        steps, rate: of Adam over all of the data.
        seed: of the first weights.
    """
    with torch.no_grad():
        said = model.encode(model.task.emission.observe(data.states))
        features = torch.stack([context_features(model, said, k) for k in contexts])
        found = [errors_of(model, data, said, k, physics) for k in contexts]
        errors = Spread(*(torch.stack([getattr(e, name) for e in found]) for name in ("physics", "states", "residual")))
        usual = Spread(_rms(errors.physics, 1), _rms(errors.states, 2), _rms(errors.residual, 1))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        bars = ErrorBars(model, usual)
    optimiser = torch.optim.Adam(bars.parameters(), lr=rate)
    for _ in range(steps):
        optimiser.zero_grad()
        _surprise(bars(features), errors).backward()
        optimiser.step()
    return bars


def _surprise(spread: Spread, errors: Spread) -> Tensor:
    """Mean negative log likelihood, each kind counting the same."""
    pairs = ((spread.physics, errors.physics), (spread.states, errors.states))
    pairs = (*pairs, (spread.residual[..., None, :], errors.residual))
    told = [(torch.log(s) + 0.5 * (e / s) ** 2).mean() for s, e in pairs if e.numel()]
    return torch.stack(told).sum()


def _rms(errors: Tensor, last: int) -> Tensor:
    return errors.square().flatten(0, errors.ndim - last - 1).mean(dim=0).sqrt()


def _codes(model: Identifier) -> int:
    return model.to_code.out_features if model.to_code is not None else 0
