"""The PET table: tissue curves of which one tissue compartment is known, identified from other scans of the tissue.

60 subjects of five regions to learn from and 20 unseen ones, 20 scans each with other inputs (the paper's split without
its validation subjects); the last four scans of the training subjects are not trained on. A scan is predicted from what
k = 7 others of its subject tell, and judged by the truth. Beside the learned models stand the fits that they compete
with: of the scan itself, and of the mean of the same seven others, each on data with and without noise.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

import pandas as pd
import torch

from petkin.errors import InputError
from petkin.hybrid import Dataset, Settings, train
from petkin.learning import PAPER, Conditions, Population, curve_errors, draw, predict, tissue_model
from petkin_bench.classical import fit_errors
from petkin_bench.provenance import RESULTS, append_rows

_SEED_TRAIN, _SEED_TEST, _CONTEXT = 1, 2, 7
#: Regions of a subject, all drawn together: eight subjects an episode.
_EPISODE = {"dynamics": 40, "series": 8, "rate": 1e-2, "clip": 100.0}
FILE = "learning_pet"
_KEY = ("model", "sees", "noise_train", "seed", "preset")
#: Percent noise of the noisy half of the table.
NOISE = 5.0
#: (way of modelling, what f_NN sees, noise in training, steps of preset cpu); classical fits take no steps.
MODELS = (
    ("full_physics", "", 0.0, 4000),
    ("purely_physics", "", 0.0, 1000),
    ("meta_hylad", "C_T,C_P", 0.0, 2000),
    ("purely_neural", "C_T", 0.0, 1000),
    ("global_hylad", "C_T", 0.0, 1000),
    ("meta_hylad", "C_T", 0.0, 6000),
    ("meta_hylad", "hidden", 0.0, 2000),
    ("meta_hylad", "held", 0.0, 2000),
    ("meta_hylad", "C_T,C_P", NOISE, 1500),
    ("full_physics", "", NOISE, 2000),
    ("purely_physics", "", NOISE, 1000),
    ("fit_1TCM", "", 0.0, 0),
    ("fit_2TCM", "", 0.0, 0),
    ("fit_1TCM", "", NOISE, 0),
    ("fit_2TCM", "", NOISE, 0),
)


@dataclass(frozen=True)
class PetPreset:
    """How much is spent.

    Args:
        subjects: for training and for each test.
        scans: of every subject; those that are trained on.
        steps: share of the steps.
        fitted: scans of every test subject that are fitted one by one.
    """

    name: str
    subjects: tuple[int, int]
    scans: tuple[int, int]
    steps: float
    fitted: int


PRESETS = (PetPreset("tiny", (10, 4), (10, 8), 0.004, 1), PetPreset("cpu", (60, 20), (20, 16), 1.0, 4))


@dataclass(frozen=True)
class PetJob:
    """One row of the table."""

    model: str
    sees: str
    noise: float
    steps: int
    seed: int

    @property
    def label(self) -> str:
        parts = ("pet", self.model, self.sees.replace(",", "_"), f"noise{self.noise:g}", f"seed{self.seed}")
        return "_".join(part for part in parts if part)

    def key(self, preset: PetPreset) -> tuple[str, ...]:
        """How `finished` knows it."""
        return (self.model, self.sees, f"{self.noise:g}", str(self.seed), preset.name)


def find_preset(name: str) -> PetPreset:
    """The preset of this name.

    Raises:
        InputError: there is none.
    """
    for preset in PRESETS:
        if preset.name == name:
            return preset
    raise InputError(f"The pet table has no preset {name!r}; choose one of {', '.join(p.name for p in PRESETS)}.")


def pet_jobs(seeds: int, model: str | None = None) -> tuple[PetJob, ...]:
    """All rows, seed after seed; fits do not depend on a seed and are done once."""
    return tuple(
        PetJob(*row, seed)
        for seed in range(seeds)
        for row in MODELS
        if model in (None, row[0]) and (seed == 0 or row[3])
    )


def finished(results: Path = RESULTS) -> set[tuple[str, ...]]:
    """Rows that are there."""
    path = results / f"{FILE}.csv"
    if not path.is_file():
        return set()
    table = pd.read_csv(path, dtype=str, keep_default_na=False)
    return set(table[list(_KEY)].itertuples(index=False, name=None))


def run_pet_job(
    job: PetJob,
    preset: PetPreset,
    *,
    work: Path,
    results: Path = RESULTS,
    progress: Callable[[float], None] = lambda share: None,
) -> list[dict[str, object]]:
    """Train or fit one model, judge it, append its rows.

    Args:
        job: which.
        preset: how much is spent.
        work: folder for checkpoints: a run that was stopped goes on.
        results: folder of the result files.
        progress: told the share that is done.
    """
    start = time.process_time()
    if job.steps:
        found, more = _learned(job, preset, work, progress)
    else:
        found, more = _fitted(job, preset), {}
    head = dict(zip(_KEY, job.key(preset))) | {"cpu_s": time.process_time() - start} | more
    rows = [head | row for row in found]
    append_rows(FILE, rows, results)
    return rows


@cache
def _conditions() -> Conditions:
    """Inputs and frames, the same for all rows."""
    return PAPER.conditions


def _learned(
    job: PetJob, preset: PetPreset, work: Path, progress: Callable[[float], None]
) -> tuple[list[dict[str, object]], dict[str, object]]:
    population = replace(PAPER, noise=job.noise)
    conditions = _conditions()
    _, measured = draw(population, preset.subjects[0], preset.scans[0], _SEED_TRAIN)
    trained = Dataset(measured.states[:, : preset.scans[1]], measured.truth)
    settings = Settings(steps=max(10, round(preset.steps * job.steps)), seed=job.seed, **_EPISODE)
    run = train(
        lambda seed: tissue_model(
            job.model, conditions, population.bounds, trained.states[..., 1], residual=job.sees or "C_T", seed=seed
        ),
        trained,
        settings,
        checkpoint=work / f"{preset.name}_{job.label}.safetensors",
        progress=lambda step, loss: progress(step / settings.steps),
    )
    rows = []
    for noise in sorted({job.noise, NOISE}):
        seen = draw(replace(PAPER, noise=noise), preset.subjects[0], preset.scans[0], _SEED_TRAIN)
        unseen = draw(replace(PAPER, noise=noise), preset.subjects[1], preset.scans[0], _SEED_TEST)
        for split, (truth, told) in (("unseen", unseen), ("seen", seen)):
            predicted, physics = predict(run.model, told, min(_CONTEXT, told.series - 1))
            symbols = run.model.task.parameters.symbols
            errors = curve_errors(predicted, truth.states) | _parameter_errors(physics, truth, symbols, population)
            rows.append({"split": split, "noise_test": noise, "test": "others", **errors})
    told = {"steps": settings.steps, "settings": str(asdict(settings)), "remarks": "; ".join(run.remarks)}
    return rows, told


def _parameter_errors(
    physics: torch.Tensor, truth: Dataset, symbols: tuple[str, ...], population: Population
) -> dict[str, float]:
    """Mean squared error of c_p where all of it is there to be found, and median percent error of each number."""
    places = [population.model.parameters.symbols.index(symbol) for symbol in symbols]
    true = truth.truth[:, None, places]
    off = {f"off_{s}": 100.0 * float(o.abs().median()) for s, o in zip(symbols, (physics / true - 1.0).unbind(-1))}
    if len(places) < population.model.rates:
        return off
    return {"mse_cp": float(((physics - true) ** 2).mean()), **off}


def _fitted(job: PetJob, preset: PetPreset) -> list[dict[str, object]]:
    population = replace(PAPER, noise=job.noise)
    truth, told = draw(population, preset.subjects[1], preset.scans[0], _SEED_TEST)
    label = job.model.removeprefix("fit_")
    rows: list[dict[str, object]] = []
    for test, k in (("itself", 0), ("others", min(_CONTEXT, told.series - 1))):
        errors = fit_errors(label, population, truth, told, preset.fitted, k)
        rows.append({"split": "unseen", "noise_test": job.noise, "test": test, **errors})
    return rows
