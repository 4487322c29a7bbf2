"""Pictures of trained runs: trajectories, frames, and the learned residual against the true one, on unseen dynamics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from petkin.errors import InputError
from petkin.hybrid import Encoded, Identifier, find_strategy, load_model
from petkin_bench.decoding import DECODERS
from petkin_bench.protocol import Job, Preset, build, checkpoint_of, jobs
from petkin_bench.systems import draw, find_system

_SEED, _DYNAMICS, _SERIES, _FRAMES = 2, 5, 8, 8


def write_pictures(work: Path, folder: Path, preset: Preset) -> list[Path]:
    """A PNG a run of seed 0 that has its checkpoint in `work`.

    Raises:
        InputError: there is none.
    """
    planned = [*jobs("strategy", None, 1), *(job for d in DECODERS for job in jobs("hybrid", None, 1, d))]
    there = [job for job in planned if checkpoint_of(job, preset, work).is_file()]
    if not there:
        raise InputError(f"{work}: no checkpoints of preset {preset.name!r}; keep those of petkin-bench run --work.")
    folder.mkdir(parents=True, exist_ok=True)
    return [_write(job, preset, work, folder) for job in there]


@torch.no_grad()
def _write(job: Job, preset: Preset, work: Path, folder: Path) -> Path:
    from matplotlib.figure import Figure

    physics = find_system(job.system)
    model = build(physics, job.dynamics, preset, job.seed, job.decoder)
    load_model(checkpoint_of(job, preset, work), model)
    data = draw(physics, _DYNAMICS, _SERIES, seed=_SEED)
    found = find_strategy("mixed" if job.strategy == "mixed" else "meta")(
        model.encode(physics.emission.observe(data.states)), _SERIES - 1, model.aggregate
    )
    predicted = model.predict(found)
    figure = Figure(figsize=(11, 7), layout="constrained")
    top, middle, bottom = np.asarray(figure.subfigures(3, 1))
    top.suptitle(f"{job.label}, preset {preset.name}: unseen dynamics, in distribution", fontsize=10)
    _draw_states(top, physics.states, physics.times, data.states[0, 0], predicted[0, 0])
    _draw_frames(middle, physics.emission.observe(data.states[0, 0]), model.observe(found, predicted)[0, 0])
    if model.task.residual is not None and model.task.missing is not None:
        _draw_residual(bottom, model, found, data.states, data.truth)
    path = folder / f"{preset.name}_{job.label}.png"
    figure.savefig(path, dpi=110, metadata={"Software": None})
    return path


def _draw_states(part: Any, names: tuple[str, ...], times: Tensor, actual: Tensor, predicted: Tensor) -> None:
    """Up to six states of one series against time."""
    axes = part.subplots(1, min(6, len(names)), squeeze=False)[0]
    for axis, name, truth, ours in zip(axes, names, actual.T.numpy(), predicted.T.numpy()):
        axis.plot(times.numpy(), truth, "k.", markersize=4, label="truth")
        axis.plot(times.numpy(), ours, color="tab:red", label="predicted")
        axis.set(title=name, xlabel="time")
    axes[0].legend(fontsize=8)


def _draw_frames(part: Any, actual: Tensor, predicted: Tensor) -> None:
    """Some frames of one series, those of the truth above."""
    axes = part.subplots(2, _FRAMES, squeeze=False)
    chosen = torch.linspace(0, len(actual) - 1, _FRAMES).round().long()
    for row, (name, images) in zip(axes, (("truth", actual), ("predicted", predicted))):
        row[0].set_ylabel(name)
        for axis, image in zip(row, images[chosen].clamp(0.0, 1.0)):
            axis.imshow(image.movedim(0, -1).squeeze(-1).numpy(), cmap="gray", vmin=0.0, vmax=1.0)
            axis.set(xticks=[], yticks=[])


def _draw_residual(part: Any, model: Identifier, found: Encoded, states: Tensor, truth: Tensor) -> None:
    """f_NN and what it should be along the series of some dynamics, against what it sees first."""
    residual, missing = model.task.residual, model.task.missing
    assert residual is not None
    assert missing is not None
    learned, actual = model.residual(found.code, states, found.physics), missing(states, truth[:, None, None])
    seen = residual.sees(states, None, found.physics[..., None, :].expand(*states.shape[:-1], -1))[0]
    axes = part.subplots(1, len(learned), squeeze=False)[0]
    for row, axis in enumerate(axes):
        for m in range(len(truth)):
            x, order = seen[m].flatten().sort()
            for values, way in ((actual, "-"), (learned, ".")):
                y = values[row, m].expand(seen[m].shape).flatten()[order]
                axis.plot(x.numpy(), y.numpy(), way, color=f"C{m}", linewidth=1, markersize=3)
        axis.set(xlabel="what f_NN sees first (scaled)", title=f"f_NN {row + 1}: line truth, dots learned")
