"""How the benchmark trains: presets of data, encoders and steps, and the runs of every table."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import torch
from torch import nn

from petkin.errors import InputError
from petkin.hybrid import Identifier, Moments, RungeKutta, Settings, SpatioTemporal, Stack, Task
from petkin_bench.decoding import decoder_of
from petkin_bench.systems import DYNAMICS, SYSTEMS, Physics, find_system

#: Frames that tell the start of a series, and numbers in c_n.
FIRST, _CODE = 3, 8
_SPLITS = {"train": 1, "ID": 2, "OOD": 3}


@dataclass(frozen=True)
class Preset:
    """How much is spent on a run.

    Args:
        name: tiny, cpu or paper.
        share: of the paper's dynamics and starts that are drawn for training.
        test: dynamics x starts of each test set.
        filters: of the convolutions.
        encoder: of contexts: moments_straight, moments (without a straight path), stack (frames as channels) or
            spatio_temporal (the paper's).
        compiled: compile the steps of the rollout.
        settings: of the training, system by system where they differ from "".
        decoder: widths of a learned decoder.
        others: encoders of systems that have one of their own.
        refined: systems that are also measured with c_p, c_n and starts refined at test time.
    """

    name: str
    share: tuple[float, float]
    test: tuple[int, int]
    filters: int
    encoder: str
    compiled: bool
    settings: dict[str, Settings] = field(default_factory=dict)
    decoder: tuple[int, ...] = (32, 128)
    others: dict[str, str] = field(default_factory=dict)
    refined: tuple[str, ...] = ()

    def reads(self, system: str) -> str:
        """The encoder of a system."""
        return self.others.get(system, self.encoder)

    def of(self, system: str) -> Settings:
        return self.settings.get(system, self.settings[""])


_TINY = Settings(steps=60, dynamics=6, series=6)
_CPU = Settings(steps=3300, horizon=6, curriculum=0.3)
PRESETS = (
    Preset(
        "tiny",
        (0.2, 0.15),
        (6, 9),
        4,
        "moments_straight",
        False,
        {"": _TINY, "rigid_body": replace(_TINY, steps=6, series=3)},
        refined=("pendulum",),
    ),
    Preset(
        "cpu",
        (1.0, 1.0),
        (24, 16),
        16,
        "moments",
        True,
        {
            "": _CPU,
            "mass_spring": Settings(steps=4000, horizon=6, curriculum=0.5, axes=10),
            "double_pendulum": Settings(steps=5000, horizon=10, curriculum=0.3, norm=3e-5),
            "bouncing_ball": Settings(steps=4000, axes=10),
            "rigid_body": Settings(steps=3000, glimpse=8, norm=3e-5),
        },
        others={"bouncing_ball": "moments_straight"},
        refined=("pendulum", "mass_spring", "bouncing_ball", "rigid_body", "double_pendulum"),
    ),
    Preset(
        "paper",
        (1.0, 1.0),
        (38, 81),
        16,
        "spatio_temporal",
        True,
        {"": Settings(steps=48_000, rate=1e-3, clip=5.0, warm_up=0.0)},
        (32, 128, 512),
    ),
)


def find_preset(name: str) -> Preset:
    """The preset of this name.

    Raises:
        InputError: there is none.
    """
    for preset in PRESETS:
        if preset.name == name:
            return preset
    raise InputError(f"There is no preset {name!r}; choose one of {', '.join(p.name for p in PRESETS)}.")


@dataclass(frozen=True)
class Job:
    """One training.

    Args:
        table: hybrid or strategy.
        system: its name.
        dynamics: full_physics, purely_physics, purely_neural, global_hylad or meta_hylad.
        strategy: what a series is predicted from in training.
        k: context series in training; 0 for all others of an episode.
        seed: of weights and episodes.
        decoder: physics, neural_prior, neural or adaptive.
    """

    table: str
    system: str
    dynamics: str
    strategy: str
    k: int
    seed: int
    decoder: str = "physics"

    @property
    def label(self) -> str:
        seen = "" if self.decoder == "physics" else f"_{self.decoder}"
        return f"{self.table}_{self.system}_{self.dynamics}_{self.strategy}_k{self.k or 'all'}_seed{self.seed}{seen}"


def jobs(table: str, system: str | None, seeds: int, decoder: str = "physics") -> tuple[Job, ...]:
    """The runs of a table, seed after seed; with a learned decoder those of Meta-HyLaD alone, as published.

    Raises:
        InputError: no such table or system.
    """
    if table == "hybrid":
        systems = [find_system(system).name] if system else [s.name for s in SYSTEMS]
        ways = DYNAMICS if decoder == "physics" else ("meta_hylad",)
        plan = [(name, dynamics, "meta", 0) for name in systems for dynamics in ways]
    elif table == "strategy":
        name = find_system(system or "pendulum").name
        ways = (("reconstruct", 1), ("meta", 1), ("mixed", 1), ("meta", 7), ("mixed", 7))
        plan = [(name, "meta_hylad", strategy, k) for strategy, k in ways]
    else:
        raise InputError(f"There is no table {table!r} here; choose hybrid or strategy.")
    return tuple(Job(table, *row, seed, decoder) for seed in range(seeds) for row in plan)


def checkpoint_of(job: Job, preset: Preset, work: Path) -> Path:
    """Where a run is kept."""
    return work / f"{preset.name}_{job.label}.safetensors"


def settings_of(job: Job, preset: Preset) -> Settings:
    """Training settings of a run."""
    found = preset.of(job.system)
    return replace(found, strategy=job.strategy, context=min(job.k, found.series - 1), seed=job.seed)


def build(physics: Physics, dynamics: str, preset: Preset, seed: int, decoder: str = "physics") -> Identifier:
    """A model with fresh first weights."""
    torch.manual_seed(seed)
    task = physics.task(dynamics)
    if preset.compiled and isinstance(task.flow, RungeKutta):
        task = replace(task, flow=replace(task.flow, compiled=True))
    coded = _CODE if dynamics in ("purely_neural", "meta_hylad") else 0
    context = _encoder(task, preset, preset.reads(physics.name), len(task.times))
    first = _encoder(task, preset, preset.reads(physics.name), FIRST)
    generator = torch.Generator().manual_seed(seed)
    seen = decoder_of(decoder, task, preset.decoder)
    return Identifier(task, context, first, code=coded, generator=generator, decoder=seen)


def _encoder(task: Task, preset: Preset, name: str, frames: int) -> nn.Module:
    """Of a whole series, or of its first frames."""
    channels, size = _look(task)
    if name.startswith("moments"):
        return Moments(frames, channels, straight=name == "moments_straight")
    if name == "spatio_temporal" and frames > FIRST:
        return SpatioTemporal(frames, channels, size, filters=preset.filters)
    return Stack(frames, channels, size, filters=preset.filters, pool=_pool(task))


def _look(task: Task) -> tuple[int, int]:
    """Channels and edge of the pictures."""
    emission = task.emission
    return emission.channels, emission.size  # type: ignore[attr-defined]


def _pool(task: Task) -> int:
    """Colour pictures are averaged to 16 (32) pixels first: half the work at no cost in accuracy."""
    return 1 if _look(task)[0] == 1 else 2


def counts(physics: Physics, preset: Preset) -> tuple[int, int]:
    """Dynamics and starts of the training set."""
    return tuple(max(12, round(share * size)) for share, size in zip(preset.share, physics.sizes))  # type: ignore[return-value]
