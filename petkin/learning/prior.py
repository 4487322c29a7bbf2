"""What the tissues of a population have in common: the network that writes f_NN, and the spread of c_p and c_n.

Where there are few scans, each with frames and an input of its own, an encoder has too little to learn from. Here every
curve has its own u = (logits of c_p in their bounds, c_n), found together with the hypernetwork that all share, by

    sum_curves [ sum_k w_k (y_k - x_k(u))^2 / (2 s^2) + (u - m)' P (u - m) / 2 ],

with a wide prior while the hypernetwork is learned; the mean m and spread of what was found are then the prior under
which the u of another curve is found, from as much of it as there is. s^2 is the variance that the training left.

Reference: for priors from a population, Sheiner LB, Beal SL. Bayesian individualization of pharmacokinetics. J Pharm
Sci 1982;71:1344-1348, doi:10.1002/jps.2600711209.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from petkin.dynamics import VectorField
from petkin.errors import InputError, NumericalError
from petkin.hybrid import HybridField, HyperNetwork, Settings, Task, learning_rate, load_tensors, save_tensors
from petkin.hybrid.checkpoint import below, optimiser_tensors, restore_optimiser, write_log

#: Standard deviations of the wide prior, of logits and of c_n; smallest variance of the narrow one.
_WIDE, _LEAST = (2.0, 1.0), 0.02
#: Numbers in c_n, and the spread of its first values.
CODE, _START = 3, 0.3
#: Rates of u and of the weights, in units of the setting.
_SCALES = (3.0, 1.0)
#: What a card says of how far from the truth it is; not a choice of the training.
TRIAL = "trial"
#: Pace below which a training that leaves the numbers is given up.
_SLOWEST = 0.01


@dataclass(frozen=True)
class Curves:
    """Curves under known inputs.

    Args:
        values: frame values (n, K).
        weights: relative inverse variances (n, K); 0 for frames that are not to be looked at.
        amounts: of the known inputs (n, J).
    """

    values: Float[Tensor, "n K"]
    weights: Float[Tensor, "n K"]
    amounts: Float[Tensor, "n J"]


class TissuePrior(nn.Module):
    """The hypernetwork and the prior.

    Args:
        task: tissue known in part; without a residual only the prior of c_p is learned.
        seed: of the first weights.
    """

    def __init__(self, task: Task, seed: int = 0) -> None:
        super().__init__()
        torch.manual_seed(seed)
        self.task, count = task, len(task.parameters)
        self.code = CODE if task.residual is not None else 0
        generator = torch.Generator().manual_seed(seed)
        self.hyper = HyperNetwork(CODE, task.residual.network, generator) if task.residual is not None else None
        self.lower: Tensor
        self.register_buffer("lower", torch.tensor(task.parameters.lower, dtype=torch.float32))
        self.span: Tensor
        self.register_buffer("span", torch.tensor(task.parameters.upper, dtype=torch.float32) - self.lower)
        wide = torch.tensor([_WIDE[0]] * count + [_WIDE[1]] * self.code)
        self.mean: Tensor
        self.register_buffer("mean", torch.zeros(count + self.code))
        self.precision: Tensor
        self.register_buffer("precision", torch.diag(wide**-2))
        self.variance: Tensor
        self.register_buffer("variance", torch.ones(()))

    def physics(self, u: Float[Tensor, "n v"]) -> Float[Tensor, "n p"]:
        """c_p."""
        return self.lower + self.span * torch.sigmoid(u[:, : len(self.lower)])

    def predict(self, u: Float[Tensor, "n v"], amounts: Float[Tensor, "n J"]) -> Float[Tensor, "n K d"]:
        """States at the frames' ends, see `TissueFlow`."""
        initial = torch.nn.functional.pad(amounts, (2, 0))
        return self.task.flow(self.field(u), initial, self.physics(u), self.task.times)

    def field(self, u: Float[Tensor, "n v"]) -> VectorField:
        """The derivative that u stands for."""
        assert self.task.known is not None
        if self.task.residual is None or self.hyper is None:
            return self.task.known
        return HybridField(self.task.known, self.task.residual, self.hyper(u[:, len(self.lower) :]))

    def misfit(self, u: Float[Tensor, "n v"], curves: Curves) -> Float[Tensor, " n"]:
        """sum_k w_k (y_k - x_k)^2."""
        return (curves.weights * (curves.values - self.predict(u, curves.amounts)[..., 1]) ** 2).sum(dim=-1)

    def strangeness(self, u: Float[Tensor, "n v"]) -> Float[Tensor, " n"]:
        """(u - m)' P (u - m)."""
        off = u - self.mean
        return ((off @ self.precision) * off).sum(dim=-1)


def learn(
    prior: TissuePrior,
    curves: Curves,
    settings: Settings,
    progress: Callable[[int, float], None] = lambda step, misfit: None,
    keep: Keep | None = None,
) -> Tensor:
    """Learn the hypernetwork from curves, then take mean and spread of their u as the prior.

    Args:
        prior: is changed.
        curves: of the population.
        settings: steps, rate, clip, seed.
        progress: told the step and the mean squared misfit.
        keep: where to keep it: a run that was stopped goes on to the same numbers.

    Returns:
        u of the curves (n, v).

    Raises:
        InputError: what is kept is of another run.
        NumericalError: it left the numbers.
    """
    generator = torch.Generator().manual_seed(settings.seed)
    spread = _START * torch.randn(len(curves.values), prior.code, generator=generator)
    u = prior.mean + torch.nn.functional.pad(spread, (len(prior.lower), 0))
    frames = curves.weights.count_nonzero()

    def cost(u: Tensor) -> tuple[Tensor, Tensor]:
        misfit = prior.misfit(u, curves).sum()
        return 0.5 * frames * torch.log(misfit) + 0.5 * prior.strangeness(u).sum(), misfit / frames

    descent = _Descent.of(u, list(prior.parameters()), settings)
    if keep is not None and keep.path.is_file():
        keep.resume(prior, descent)
    while descent.step < settings.steps:
        misfit = descent.move(cost, settings)
        progress(descent.step, misfit)
        if keep is not None and descent.step % settings.save_every == 0:
            keep.save(prior, descent)
    u = descent.u.detach()
    if not keep or not keep.complete:
        _take_prior(prior, u, cost(u)[1].detach())
    if keep is not None:
        keep.save(prior, descent)
    return u


def _take_prior(prior: TissuePrior, u: Tensor, left: Tensor) -> None:
    prior.variance.copy_(left)
    prior.mean.copy_(u.mean(dim=0))
    spread = torch.atleast_2d(torch.cov(u.T)) + _LEAST * torch.eye(u.shape[1])
    prior.precision.copy_(torch.linalg.inv(spread))


def identify(prior: TissuePrior, curves: Curves, settings: Settings) -> Tensor:
    """u of curves (n, v) under the prior, each for itself."""

    def cost(u: Tensor) -> tuple[Tensor, Tensor]:
        misfit = prior.misfit(u, curves)
        return (0.5 * misfit / prior.variance + 0.5 * prior.strangeness(u)).sum(), misfit.mean()

    with torch.enable_grad():
        descent = _Descent.of(prior.mean.expand(len(curves.values), -1).clone(), [], settings)
        for _ in range(settings.steps):
            descent.move(cost, settings)
    return descent.u.detach()


@dataclass
class _Descent:
    """Adam over u, and over weights where there are any, along one cycle of the rate."""

    u: Tensor
    weights: list[nn.Parameter]
    optimiser: torch.optim.Adam
    step: int = 0
    misfits: list[float] = field(default_factory=list)
    pace: float = 1.0
    before: list[Tensor] = field(default_factory=list)

    @classmethod
    def of(cls, u: Tensor, weights: list[nn.Parameter], settings: Settings) -> _Descent:
        u = u.detach().requires_grad_()
        groups = [{"params": [u]}, *([{"params": weights}] if weights else [])]
        return cls(u, weights, torch.optim.Adam(groups, lr=settings.rate, betas=(0.9, 0.99)))

    def move(self, cost: Callable[[Tensor], tuple[Tensor, Tensor]], settings: Settings) -> float:
        for group, scale in zip(self.optimiser.param_groups, _SCALES):
            group["lr"] = self.pace * scale * learning_rate(self.step, settings)
        self.optimiser.zero_grad(set_to_none=True)
        total, misfit = cost(self.u)
        self.step += 1
        if not bool(torch.isfinite(total)):
            return self.back()
        total.backward()
        if self.weights:
            torch.nn.utils.clip_grad_norm_(self.weights, settings.clip)
        self.before = [p.detach().clone() for p in (self.u, *self.weights)]
        self.optimiser.step()
        self.misfits.append(float(misfit.detach()))
        return self.misfits[-1]

    def back(self) -> float:
        """One step back, and on at half the pace: the last one left the numbers."""
        if not self.before or self.pace < _SLOWEST:
            raise NumericalError(f"Step {self.step} held numbers that are not finite; try another seed.")
        with torch.no_grad():
            for parameter, before in zip((self.u, *self.weights), self.before):
                parameter.copy_(before)
        self.pace *= 0.5
        self.optimiser.state.clear()
        self.misfits.append(self.misfits[-1])
        return self.misfits[-1]


@dataclass
class Keep:
    """A training on disk.

    Args:
        path: the checkpoint; a CSV log lies beside it.
        card: what was learned from, and how.
        complete: whether what was found there was learned to its end.
    """

    path: Path
    card: Mapping[str, Any]
    complete: bool = False

    def save(self, prior: TissuePrior, descent: _Descent) -> None:
        tensors = {f"prior.{name}": value for name, value in prior.state_dict().items()}
        tensors |= {f"adam.{name}": value for name, value in optimiser_tensors(descent.optimiser).items()}
        tensors |= {"u": descent.u, "misfits": torch.tensor(descent.misfits, dtype=torch.float64)}
        tensors["pace"] = torch.tensor(descent.pace, dtype=torch.float64)
        save_tensors(self.path, tensors, {**self.card, "step": descent.step})
        write_log(self.path.with_suffix(".csv"), descent.misfits, [])

    def resume(self, prior: TissuePrior, descent: _Descent) -> None:
        tensors, card = load_tensors(self.path)
        step, _ = int(card.pop("step", -1)), card.pop(TRIAL, None)
        if card != json.loads(json.dumps(dict(self.card))):
            raise InputError(f"{self.path}: a checkpoint of another training; give another file or remove it.")
        prior.load_state_dict(dict(below("prior.", tensors)))
        restore_optimiser(descent.optimiser, dict(below("adam.", tensors)))
        descent.u.data.copy_(tensors["u"])
        descent.step, descent.misfits, descent.pace = step, tensors["misfits"].tolist(), float(tensors["pace"])
        self.complete = step >= int(self.card["steps"])
