"""One plain training loop: Adam, one cycle of the learning rate, clipping, checkpoints, and eyes open.

A run that has left the numbers, or whose predictions have left the picture (the loss of a blank observation, from which
no gradient leads back), is noticed, said, and begun again from other first weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import torch
from torch import Tensor

from petkin.errors import InputError, NumericalError
from petkin.hybrid.checkpoint import load_tensors, optimiser_tensors, restore_optimiser, save_tensors
from petkin.hybrid.episodes import Dataset, episodes
from petkin.hybrid.model import Encoded, Identifier
from petkin.hybrid.strategies import find_strategy

#: A window's mean loss above this share of a blank observation's counts as dead, after so many steps.
_BLANK, _WINDOW, _PATIENCE = 0.95, 50, 300
#: Steps in a row that may be skipped for numbers that are not finite.
_SKIPS = 20


@dataclass(frozen=True)
class Settings:
    """How to train.

    Args:
        steps: how many.
        strategy: reconstruct, meta or mixed.
        dynamics, series: of an episode.
        context: k, series that identify for another; 0 for all others of the episode.
        rate: highest learning rate, reached after `warm_up` of the steps and annealed to `final` of itself.
        clip: largest norm of a gradient.
        horizon, curriculum: predict only the first `horizon` times at first, all after this share of the steps.
        norm, orthogonality: weights of the penalties on f_NN's mean square and on its overlap with f_PHY.
        seed: of first weights and episodes.
        save_every: steps between checkpoints.
        restarts: how often a dead run may begin again.
    """

    steps: int
    strategy: str = "meta"
    dynamics: int = 8
    series: int = 8
    context: int = 0
    rate: float = 3e-3
    warm_up: float = 0.1
    final: float = 1e-3
    clip: float = 1.0
    horizon: int = 0
    curriculum: float = 0.0
    norm: float = 0.0
    orthogonality: float = 0.0
    seed: int = 0
    save_every: int = 500
    restarts: int = 2


@dataclass
class Run:
    """Where a training stands.

    Args:
        model: what is trained.
        step: steps done.
        losses: of every step so far.
        remarks: what went wrong on the way, a sentence each.
    """

    model: Identifier
    step: int = 0
    losses: list[float] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


#: Makes a model with fresh first weights from a seed.
Maker = Callable[[int], Identifier]


def train(
    make: Maker,
    data: Dataset,
    settings: Settings,
    *,
    checkpoint: Path | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> Run:
    """Train to the end of the steps, from the checkpoint where there is one.

    Args:
        make: gives the model for a seed.
        data: what to train on.
        settings: how.
        checkpoint: file to resume from and to save to; a run that is resumed goes on to the same losses.
        progress: told the step and its loss.

    Raises:
        InputError: a checkpoint of another run.
        NumericalError: the run died more often than it may begin again.
    """
    remarks: list[str] = []
    for attempt in range(settings.restarts + 1):
        trial = replace(settings, seed=settings.seed + 1000 * attempt)
        try:
            run = _attempt(make, data, trial, checkpoint, progress)
        except NumericalError as failure:
            remarks.append(f"Seed {trial.seed}: {failure} Begun again from other weights.")
            if checkpoint is not None:
                checkpoint.unlink(missing_ok=True)
            continue
        run.remarks = [*remarks, *run.remarks]
        return run
    raise NumericalError(f"Training died {settings.restarts + 1} times: {' '.join(remarks)}")


def learning_rate(step: int, settings: Settings) -> float:
    """One cycle: up in a straight line, down along half a cosine."""
    rise = max(1, round(settings.warm_up * settings.steps))
    if step < rise:
        return settings.rate * (step + 1) / rise
    share = (step - rise) / max(1, settings.steps - rise)
    low = settings.final * settings.rate
    return low + 0.5 * (settings.rate - low) * (1.0 + math.cos(math.pi * share))


def _attempt(
    make: Maker,
    data: Dataset,
    settings: Settings,
    checkpoint: Path | None,
    progress: Callable[[int, float], None] | None,
) -> Run:
    run = Run(make(settings.seed))
    optimiser = torch.optim.Adam(run.model.parameters(), lr=settings.rate, betas=(0.9, 0.99))
    generator = torch.Generator().manual_seed(settings.seed)
    if checkpoint is not None and checkpoint.is_file():
        _resume(checkpoint, run, optimiser, generator, settings)
    batches = episodes(data, dynamics=settings.dynamics, series=settings.series, generator=generator)
    watch = _Watch()
    run.model.train()
    while run.step < settings.steps:
        loss = _step(run.model, optimiser, next(batches), settings, run.step, watch)
        run.losses.append(loss)
        run.step += 1
        if progress is not None:
            progress(run.step, loss)
        if checkpoint is not None and (run.step % settings.save_every == 0 or run.step == settings.steps):
            _save(checkpoint, run, optimiser, generator, settings)
    run.model.eval()
    return run


@dataclass
class _Watch:
    """Notices runs that died."""

    skipped: int = 0
    blank: int = 0
    recent: float = 0.0

    def skip(self) -> None:
        self.skipped += 1
        if self.skipped > _SKIPS:
            raise NumericalError(f"{self.skipped} steps in a row held numbers that are not finite.")

    def see(self, loss: float, blank: float) -> None:
        self.skipped = 0
        self.recent += (loss / blank - self.recent) / _WINDOW
        self.blank = self.blank + 1 if self.recent > _BLANK else 0
        if self.blank > _PATIENCE:
            raise NumericalError(
                f"The loss stayed at {self.recent:.2f} of a blank observation's for {self.blank} steps: nothing of the "
                "predictions is left in sight."
            )


def _step(
    model: Identifier, optimiser: torch.optim.Optimizer, batch: Dataset, settings: Settings, step: int, watch: _Watch
) -> float:
    with torch.no_grad():
        observed = model.task.emission.observe(batch.states)
    found = find_strategy(settings.strategy)(model.encode(observed), settings.context or settings.series - 1)
    count = _frames(step, settings, len(model.task.times))
    predicted = model.predict(found, model.task.times[:count])
    error = model.task.emission.squared_error(predicted, batch.states[..., :count, :]).mean()
    loss = error + _penalty(model, found, predicted, settings)
    optimiser.zero_grad(set_to_none=True)
    if not bool(torch.isfinite(loss)):
        watch.skip()
        return float("nan")
    loss.backward()
    size = torch.nn.utils.clip_grad_norm_(model.parameters(), settings.clip)
    if not bool(torch.isfinite(size)):
        watch.skip()
        return float("nan")
    for group in optimiser.param_groups:
        group["lr"] = learning_rate(step, settings)
    optimiser.step()
    watch.see(float(error.detach()), float(observed[:, :, :count].square().mean()))
    return float(error.detach())


def _frames(step: int, settings: Settings, frames: int) -> int:
    """How many times are predicted at this step."""
    if not settings.horizon or step >= settings.curriculum * settings.steps:
        return frames
    share = step / (settings.curriculum * settings.steps)
    return min(frames, settings.horizon + round(share * (frames - settings.horizon)))


def _penalty(model: Identifier, found: Encoded, predicted: Tensor, settings: Settings) -> Tensor:
    """What keeps f_NN from saying what f_PHY could have said."""
    task, none = model.task, predicted.new_zeros(())
    if task.residual is None or task.known is None or not (settings.norm or settings.orthogonality):
        return none
    learned = model.residual(found.code, predicted, found.physics)
    penalty = settings.norm * learned.square().mean()
    if settings.orthogonality:
        seen = found.physics[..., None, :].expand(*predicted.shape[:-1], -1)
        known, added = task.known(none, predicted, None, seen), task.residual.acts(learned, predicted)
        overlap = (known * added).mean() ** 2 / (known.square().mean() * added.square().mean() + 1e-12)
        penalty = penalty + settings.orthogonality * overlap
    return penalty


def _save(
    path: Path, run: Run, optimiser: torch.optim.Optimizer, generator: torch.Generator, settings: Settings
) -> None:
    tensors = {f"model.{name}": value for name, value in run.model.state_dict().items()}
    tensors |= {f"adam.{name}": value for name, value in optimiser_tensors(optimiser).items()}
    tensors["generator"] = generator.get_state()
    tensors["losses"] = torch.tensor(run.losses, dtype=torch.float64)
    save_tensors(path, tensors, {"settings": asdict(settings), "task": run.model.task.name, "step": run.step})


def _resume(
    path: Path, run: Run, optimiser: torch.optim.Optimizer, generator: torch.Generator, settings: Settings
) -> None:
    tensors, card = load_tensors(path)
    if card["settings"] != asdict(settings) or card["task"] != run.model.task.name:
        raise InputError(f"{path}: a checkpoint of another run ({card['task']}); give another file or remove it.")
    run.model.load_state_dict(dict(_below("model.", tensors)))
    restore_optimiser(optimiser, dict(_below("adam.", tensors)))
    generator.set_state(tensors["generator"])
    run.step, run.losses = int(card["step"]), tensors["losses"].tolist()


def _below(prefix: str, tensors: dict[str, Tensor]) -> Iterator[tuple[str, Tensor]]:
    return ((name.removeprefix(prefix), value) for name, value in tensors.items() if name.startswith(prefix))
