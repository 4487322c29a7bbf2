"""One plain training loop: Adam, one cycle of the learning rate, clipping, checkpoints, and eyes open.

A run that has left the numbers, or whose predictions have left the picture (a blank observation, from which
no gradient leads back), is noticed, said, and begun again from other first weights.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from itertools import islice
from pathlib import Path

import torch

from petkin.errors import InputError, NumericalError
from petkin.hybrid.checkpoint import (
    below,
    load_tensors,
    optimiser_tensors,
    restore_optimiser,
    save_tensors,
    write_log,
)
from petkin.hybrid.episodes import Dataset, episodes
from petkin.hybrid.gradients import Gradients
from petkin.hybrid.metrics import measure
from petkin.hybrid.model import Identifier
from petkin.hybrid.optimiser import TurnedAdam
from petkin.hybrid.parallel import average, place, wait
from petkin.hybrid.schedule import Settings, learning_rate
from petkin.hybrid.strategies import find_strategy
from petkin.hybrid.validation import Validation
from petkin.hybrid.watch import Watch

#: Episodes that tell encoders what is usual.
_SETTLING = 8


@dataclass
class Run:
    """Where a training stands.

    Args:
        model: what is trained.
        step: steps done.
        losses: of every step so far.
        remarks: what went wrong on the way, a sentence each.
        checks: (step, error on the validation dynamics).
        earlier_s: processor time of runs that were stopped before, up to the checkpoint that this one goes on from.
    """

    model: Identifier
    step: int = 0
    losses: list[float] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    checks: list[tuple[int, float]] = field(default_factory=list)
    earlier_s: float = 0.0


#: Makes a model with fresh first weights from a seed.
Maker = Callable[[int], Identifier]


def train(
    make: Maker,
    data: Dataset,
    settings: Settings,
    *,
    checkpoint: Path | None = None,
    progress: Callable[[int, float], None] | None = None,
    validation: Dataset | None = None,
    log: Path | None = None,
    device: torch.device | str = "cpu",
) -> Run:
    """Train to the end of the steps, from the checkpoint where there is one.

    Args:
        make: gives the model for a seed.
        data: what to train on.
        settings: how.
        checkpoint: file to resume from and to save to; a run that is resumed goes on to the same losses.
        progress: told the step and its loss.
        validation: dynamics to check the run on (`check_every`): it ends with the best weights of its last part.
        log: CSV file of losses and checks, written with every checkpoint and at the end.
        device: where to train; the model of the run stays there.

    Raises:
        InputError: a checkpoint of another run; episodes that the processes cannot share evenly.
        NumericalError: the run died more often than it may begin again.
    """
    remarks: list[str] = []
    held = data.to(device)

    def placed(seed: int) -> Identifier:
        return make(seed).place_on(device)

    for attempt in range(settings.restarts + 1):
        trial = replace(settings, seed=settings.seed + 1000 * attempt)
        try:
            run = _attempt(placed, held, trial, validation, _Files(checkpoint, log, progress))
        except NumericalError as failure:
            remarks.append(f"Seed {trial.seed}: {failure} Begun again from other weights.")
            if checkpoint is not None and place()[0] == 0:
                checkpoint.unlink(missing_ok=True)
            wait()
            continue
        run.remarks = [*remarks, *run.remarks]
        return run
    raise NumericalError(f"Training died {settings.restarts + 1} times: {' '.join(remarks)}")


@dataclass(frozen=True)
class _Files:
    """Where a run is kept, if anywhere, who is told, and the processor time, s, when it began or went on."""

    checkpoint: Path | None
    log: Path | None
    progress: Callable[[int, float], None] | None
    since: float = field(default_factory=time.process_time)


def _attempt(make: Maker, data: Dataset, settings: Settings, validation: Dataset | None, files: _Files) -> Run:
    run, kept = Run(make(settings.seed)), Validation(settings.steps, settings.patience)
    optimiser = _optimiser(run.model, settings)
    generator = torch.Generator().manual_seed(settings.seed)
    if files.checkpoint is not None and files.checkpoint.is_file():
        _resume(files.checkpoint, run, kept, optimiser, generator, settings)
    batches = episodes(data, dynamics=settings.dynamics, series=settings.series, generator=generator)
    if run.step == 0:
        _settle(run.model, data, settings)
    watch, ended = Watch(), run.step >= settings.steps or kept.plateau
    run.model.train()
    gradients = Gradients(run.model, settings)
    while not ended:
        mine = _share(batches, settings, generator)
        run.losses.append(_step(run.model, optimiser, gradients, mine, settings, run.step, watch))
        run.step += 1
        if files.progress is not None:
            files.progress(run.step, run.losses[-1])
        if validation is not None and settings.check_every and run.step % settings.check_every == 0:
            kept.see(run.step, _check(run.model, validation, settings), run.model)
        ended = run.step >= settings.steps or kept.plateau
        if ended or run.step % settings.save_every == 0:
            _save(files, run, kept, optimiser, generator, settings)
    run.checks = kept.checks
    if kept.best:
        run.model.load_state_dict(kept.best)
    run.model.eval()
    return run


def _optimiser(model: Identifier, settings: Settings) -> torch.optim.Optimizer:
    if settings.axes:
        return TurnedAdam(model.parameters(), settings.rate, every=settings.axes)
    return torch.optim.Adam(model.parameters(), lr=settings.rate, betas=(0.9, 0.99))


def _settle(model: Identifier, data: Dataset, settings: Settings) -> None:
    """Let encoders that ask for it see what is usual: the same episodes in every process, drawn for this alone."""
    asking = [m for m in (model.context, model.first) if hasattr(m, "settle")]
    if not asking:
        return
    generator = torch.Generator().manual_seed(settings.seed)
    drawn = episodes(data, dynamics=settings.dynamics, series=settings.series, generator=generator)
    with torch.no_grad():
        series = [model.task.emission.observe(batch.states).flatten(0, 1) for batch in islice(drawn, _SETTLING)]
    for encoder in asking:
        encoder.settle(torch.cat(series))  # type: ignore[operator]


def _share(batches: Iterator[Dataset], settings: Settings, generator: torch.Generator) -> Iterator[tuple[Dataset, int]]:
    """This process's episodes of a step, each with its k. All are drawn by all processes, so that they stay in step."""
    rank, size = place()
    if settings.episodes % size:
        raise InputError(f"{settings.episodes} episodes a step cannot be shared evenly by {size} processes.")
    most = settings.context or settings.series - 1
    for i in range(settings.episodes):
        batch = next(batches)
        k = int(torch.randint(1, most + 1, (1,), generator=generator)) if settings.vary else most
        if i % size == rank:
            yield batch, k


def _step(
    model: Identifier,
    optimiser: torch.optim.Optimizer,
    gradients: Gradients,
    mine: Iterator[tuple[Dataset, int]],
    settings: Settings,
    step: int,
    watch: Watch,
) -> float:
    means = gradients(mine, step)
    average([means, *(p.grad for p in model.parameters() if p.grad is not None)])
    size = torch.nn.utils.clip_grad_norm_(model.parameters(), settings.clip)
    if not bool(torch.isfinite(means).all() and torch.isfinite(size)):
        watch.skip()
        return float("nan")
    for group in optimiser.param_groups:
        group["lr"] = learning_rate(step, settings)
    optimiser.step()
    watch.see(float(means[2]))
    return float(means[1])


def _check(model: Identifier, validation: Dataset, settings: Settings) -> float:
    """Error on dynamics that are not trained on."""
    _share_statistics(model)
    k = min(settings.context or settings.series - 1, validation.series - 1)
    return measure(model, validation, find_strategy(settings.strategy), k, physics=())["mse_x"]


def _share_statistics(model: Identifier) -> None:
    """The running statistics of normalisations as means over the processes."""
    average(buffer for buffer in model.buffers() if buffer.is_floating_point())


def _save(
    files: _Files,
    run: Run,
    kept: Validation,
    optimiser: torch.optim.Optimizer,
    generator: torch.Generator,
    settings: Settings,
) -> None:
    _share_statistics(run.model)
    if place()[0] > 0:
        return
    if files.log is not None:
        write_log(files.log, run.losses, kept.checks)
    if files.checkpoint is None:
        return
    tensors = {f"model.{name}": value for name, value in run.model.state_dict().items()}
    tensors |= {f"best.{name}": value for name, value in kept.best.items()}
    tensors |= {f"adam.{name}": value for name, value in optimiser_tensors(optimiser).items()}
    tensors["generator"] = generator.get_state()
    tensors["losses"] = torch.tensor(run.losses, dtype=torch.float64)
    tensors["checks"] = torch.tensor(kept.checks, dtype=torch.float64).reshape(-1, 2)
    spent = run.earlier_s + time.process_time() - files.since
    card = {"settings": asdict(settings), "task": run.model.task.name, "step": run.step, "cpu_s": spent}
    save_tensors(files.checkpoint, tensors, card)


def _resume(
    path: Path,
    run: Run,
    kept: Validation,
    optimiser: torch.optim.Optimizer,
    generator: torch.Generator,
    settings: Settings,
) -> None:
    tensors, card = load_tensors(path)
    if asdict(Settings(steps=0)) | card["settings"] != asdict(settings) or card["task"] != run.model.task.name:
        raise InputError(f"{path}: a checkpoint of another run ({card['task']}); give another file or remove it.")
    run.model.load_state_dict(dict(below("model.", tensors)))
    restore_optimiser(optimiser, dict(below("adam.", tensors)))
    generator.set_state(tensors["generator"])
    run.step, run.losses = int(card["step"]), tensors["losses"].tolist()
    run.earlier_s = float(card.get("cpu_s", 0.0))
    checks = tensors.get("checks", torch.zeros(0, 2)).tolist()
    kept.checks, kept.best = [(int(step), error) for step, error in checks], dict(below("best.", tensors))
