"""The plan of a study: settings with everything looked up, painted and checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from petkin import units
from petkin.effects import Injection, read_injection
from petkin.errors import InputError
from petkin.imaging import (
    CountingNoise,
    FrameObservation,
    FrameSchedule,
    frame_schedule,
    half_life,
    in_seconds,
    nuclide,
)
from petkin.io import read_schedule
from petkin.kinetics import CompartmentModel, compartment_model
from petkin.phantoms import PaintedPhantom, Phantom, Population, paint, phantom_with, read_phantom, read_population
from petkin.study.simulation.settings import PRESETS, SimulationSettings

#: Minutes over which a count of frames spreads where a tracer's own frames are a count too.
_USUAL_LENGTH = 60.0


@dataclass(frozen=True)
class Plan:
    """What all scans of the study share."""

    settings: SimulationSettings
    phantom: Phantom
    painted: PaintedPhantom
    population: Population
    compartments: CompartmentModel
    radionuclide: str
    observation: FrameObservation
    noise: CountingNoise
    effects: tuple[Injection, ...]

    @property
    def frames(self) -> FrameSchedule:
        return self.observation.frames

    @property
    def model(self) -> str:
        """Label of the tissue model."""
        return self.compartments.label

    @property
    def half_life_s(self) -> float:
        """Half-life behind the decay that the frames hold, s."""
        return math.log(2.0) / self.observation.decay * units.SECONDS_PER_MINUTE


def plan(settings: SimulationSettings) -> Plan:
    """Look up what the settings name.

    Raises:
        InputError: a name that is not known, or options that contradict each other.
    """
    preset, population = PRESETS[settings.preset], _population(settings)
    radionuclide = nuclide(settings.isotope or population.radionuclide).symbol
    tau = preset.mean_life if settings.isotope is None else None
    decay = 1.0 / tau if tau else units.decay_constant(half_life(radionuclide))
    phantom = _phantom(settings)
    if settings.voxel_spread and settings.subsamples > 1:
        raise InputError("Voxels of their own kinetics cannot be shared between regions; use one subsample.")
    return Plan(
        settings=settings,
        phantom=phantom,
        painted=paint(phantom, voxel_size=settings.voxel_size, subsamples=settings.subsamples),
        population=population,
        compartments=tissue_model(settings),
        radionuclide=radionuclide,
        observation=FrameObservation(_frames(settings.frames, population.frames), decay, corrected=preset.corrected),
        noise=CountingNoise(
            preset.noise if settings.noise is None else settings.noise,
            common_share=settings.noise_common,
            correlation=settings.noise_fwhm,
        ),
        effects=tuple(read_injection(text, imaged=True) for text in settings.effects),
    )


def tissue_model(settings: SimulationSettings) -> CompartmentModel:
    """The tissue model that the settings ask for, or the tracer's own.

    Raises:
        InputError: no such model or tracer, or vessel walls, of which populations of kinetics know nothing.
    """
    model = compartment_model(settings.model or _population(settings).model)
    if model.wall:
        raise InputError(f"{model.label} cannot be simulated: there is no Kb in any population; use 2TCM.")
    return model


def _population(settings: SimulationSettings) -> Population:
    return read_population(settings.tracer or PRESETS[settings.preset].tracer)


def _phantom(settings: SimulationSettings) -> Phantom:
    if settings.phantom is None:
        return phantom_with(5 if settings.roi is None else settings.roi)
    phantom = read_phantom(settings.phantom)
    if settings.roi is not None and settings.roi != len(phantom.regions):
        raise InputError(
            f"--roi {settings.roi} but phantom {phantom.name!r} has {len(phantom.regions)} regions; drop one."
        )
    return phantom


def _frames(choice: str | None, usual: str) -> FrameSchedule:
    """The schedule asked for, at the precision that a sidecar keeps."""
    own = frame_schedule(usual, length=_USUAL_LENGTH)
    if choice is None:
        found = own
    elif Path(choice).suffix.lower() in {".tsv", ".json"}:
        found = read_schedule(Path(choice))
    else:
        found = frame_schedule(choice, length=float(own.end[-1]))
    if found.start[0] < 0:
        raise InputError(
            f"{found.where}: the first frame starts before injection; a simulated scan starts at 0 s or later."
        )
    return FrameSchedule.from_seconds(*in_seconds(found), where=found.where)
