"""The runs of the learning tables: trained, measured, kept as rows; what is there already is not done again."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import torch

from petkin.hybrid import Identifier, find_strategy, measure, measure_refined, place, train
from petkin_bench.learning_tables import read_rows
from petkin_bench.protocol import FIRST, Job, Preset, build, checkpoint_of, counts, settings_of
from petkin_bench.provenance import RESULTS, append_rows
from petkin_bench.systems import Physics, draw, find_system

_SEED_TRAIN, _SEED_TEST, _SEED_VALIDATION = 1, 2, 4
#: Dynamics x starts that a run is checked on, where its settings ask for it.
_VALIDATION = (24, 8)
_KEY = ("table", "system", "dynamics", "strategy", "k_train", "seed", "preset", "decoder")


def run_job(
    job: Job,
    preset: Preset,
    *,
    work: Path,
    results: Path = RESULTS,
    progress: Callable[[float], None] = lambda share: None,
    episodes: int = 1,
    device: str = "cpu",
) -> list[dict[str, object]]:
    """Train one model, measure it on both test sets, append the rows.

    Args:
        job: what to train.
        preset: how.
        work: folder for checkpoints, from which a stopped run goes on, and for logs of the losses.
        results: folder of the result files.
        progress: told the share that is done.
        episodes: of a step, shared by the processes that torchrun started; the first measures and keeps the rows.
        device: where to train and to measure.
    """
    physics, settings = find_system(job.system), replace(settings_of(job, preset), episodes=episodes)
    data = draw(physics, *counts(physics, preset), seed=_SEED_TRAIN)
    checkpoint = checkpoint_of(job, preset, work)
    torch.compiler.reset()  # one process compiles only so many forms of a function, and each run has its own
    start = time.process_time()
    run = train(
        lambda seed: _rough(build(physics, job.dynamics, preset, seed, job.decoder), physics, preset),
        data,
        settings,
        checkpoint=checkpoint,
        progress=lambda step, loss: progress(step / settings.steps),
        validation=draw(physics, *_VALIDATION, seed=_SEED_VALIDATION) if settings.check_every else None,
        log=checkpoint.with_suffix(".csv"),
        device=device,
    )
    if place()[0] > 0:
        return []
    run.model.task = replace(run.model.task, emission=physics.emission)
    spent = run.earlier_s + time.process_time() - start
    rows = [row | {"cpu_s": spent} for row in _measured(job, preset, run.model, "; ".join(run.remarks))]
    append_rows(
        "learning",
        [
            row | {"encoder": preset.reads(job.system), "settings": str(asdict(settings)), "device": device}
            for row in rows
        ],
        results,
    )
    return rows


def _rough(model: Identifier, physics: Physics, preset: Preset) -> Identifier:
    """To be trained on cheaper pictures, where the encoder reads pictures of any size."""
    if physics.rough is not None and preset.reads(physics.name).startswith("moments") and model.decoder is None:
        model.task = replace(model.task, emission=physics.rough)
    return model


def done(results: Path = RESULTS) -> set[tuple[str, ...]]:
    """Runs that have their rows."""
    if not (results / "learning.csv").is_file():
        return set()
    table = read_rows(results).astype(str)
    return set(table[list(_KEY)].itertuples(index=False, name=None))


def key(job: Job, preset: Preset) -> tuple[str, ...]:
    """How `done` knows a run."""
    return (job.table, job.system, job.dynamics, job.strategy, str(job.k), str(job.seed), preset.name, job.decoder)


def _measured(job: Job, preset: Preset, model, remarks: str) -> list[dict[str, object]]:
    """A row a test set and way of testing: prediction from others; for strategies reconstruction of itself; refined."""
    physics, rows = find_system(job.system), []
    symbols = model.task.parameters.symbols
    ways = [("prediction", "mixed" if job.strategy == "mixed" else "meta", job.k or preset.test[1] - 1)]
    ways += [("reconstruction", "reconstruct", 1)] if job.table == "strategy" else []
    for split, outside in (("ID", False), ("OOD", True)):
        data = draw(physics, *preset.test, seed=_SEED_TEST + int(outside), outside=outside)
        head = {**dict(zip(_KEY, key(job, preset))), "split": split, "remarks": remarks}
        meant = physics.places(symbols)
        for what, strategy, k in ways:
            k = min(k, 7)
            found = measure(model, data, find_strategy(strategy), k, physics=meant)
            rows.append({**head, "test": what, "k_test": k, **found})
        if job.table == "hybrid" and job.system in preset.refined:
            found = measure_refined(model, data, 7, FIRST, physics=meant)
            rows.append({**head, "test": "refined", "k_test": 7, **found})
    return rows
