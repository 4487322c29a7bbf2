"""`petkin train`: what tissues of a population have in common, learned from simulated or from real curves."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from petkin import __version__
from petkin.errors import InputError
from petkin.fitting import Need
from petkin.hybrid import Settings
from petkin.imaging import FrameObservation
from petkin.io import RegionalCurves
from petkin.learning import (
    Conditions,
    Curves,
    Known,
    Measured,
    Population,
    conditions_of,
    drawn_curves,
    together,
    train_tracer,
    try_out,
)
from petkin.study.arterial import arterial_input
from petkin.study.reading import read_sources
from petkin.study.request import FitRequest
from petkin.study.series import regional_curves
from petkin.study.sources import Source
from petkin.study.whole_brain import frame_weights, shared_delay, whole_brain

Progress = Callable[[str, float], None]
#: Subjects that a simulated population is tried on.
_TRIED = 20


@dataclass(frozen=True)
class TrainRequest:
    """What to learn, and from what.

    Args:
        out: checkpoint to write, or to go on from.
        studies: PET-BIDS studies with regional curves and blood; none for a simulated population.
        seg: which table of curves.
        population: what is simulated.
        subjects: how many are simulated.
        half_life: of the simulated radionuclide, min.
        residual: what f_NN sees.
        settings: of the training.
    """

    out: Path
    studies: tuple[Path, ...]
    seg: str | None
    population: Population
    subjects: int
    half_life: float
    residual: str
    settings: Settings


def train_population(request: TrainRequest, progress: Progress) -> None:
    """Learn and write the checkpoint, with a CSV log of the misfit beside it; a run that was stopped goes on.

    Raises:
        InputError: nothing to learn from, scans that cannot be learned together, a checkpoint of another training.
    """
    progress("curves", 0.0)
    conditions, curves, half_life, card = _real(request) if request.studies else _simulated(request)

    def told(step: int, misfit: float) -> None:
        progress(f"misfit {misfit:.3g}", step / request.settings.steps)

    train_tracer(
        conditions,
        curves,
        request.out,
        request.settings,
        {**card, "version": __version__},
        residual=request.residual,
        half_life=half_life,
        progress=told,
    )
    if not request.studies:
        progress("against the truth", 1.0)
        try_out(request.out, request.population, _TRIED)


def _simulated(request: TrainRequest) -> tuple[Conditions, Curves, float, dict[str, Any]]:
    population, frames = request.population, request.population.observation.frames
    conditions, curves = drawn_curves(population, request.subjects, request.settings.seed)
    card = {
        "from": "simulation",
        "ranges": {symbol: list(pair) for symbol, pair in population.ranges.items()},
        "rise": list(population.rise),
        "noise_percent": population.noise,
        "frames_min": [frames.start.tolist(), frames.end.tolist()],
    }
    return conditions, curves, request.half_life, card


def _real(request: TrainRequest) -> tuple[Conditions, Curves, float, dict[str, Any]]:
    found: list[tuple[Source, Measured]] = []
    for folder in request.studies:
        fit = FitRequest(folder, level="region", seg=request.seg, models=("1TCM",))
        found += [(source, _measured(source, regional_curves(source), fit)) for source in read_sources(fit)[2]]
    decays = sorted({source.decay for source, _ in found})
    if decays[-1] > 1.01 * decays[0]:
        raise InputError("The scans are of several radionuclides; learn each tracer for itself.")
    scans = [scan for _, scan in found]
    card = {"from": sorted(source.label for source, _ in found), "tracer": found[0][0].nuclide}
    return conditions_of(scans), together(scans), math.log(2.0) / decays[0], card


def _measured(source: Source, curves: RegionalCurves, request: FitRequest) -> Measured:
    values = curves.values
    values = values[np.isfinite(values).all(axis=1) & (values.sum(axis=1) > 0)]
    observation = FrameObservation(curves.frames, source.decay)
    whole = whole_brain(None, curves)
    weights, _ = frame_weights(whole, source, request)
    arterial = arterial_input(source, request) if request.needs(Need.INPUT) else None
    assert arterial is not None
    _, (delay, _), _ = shared_delay(whole, arterial, observation, weights, request, curves)
    arrived = arterial.delayed(delay)
    known = Known(arrived.plasma, arrived.whole_blood, observation)
    return Measured(torch.tensor(values), torch.tensor(weights), known)
