"""The state map of a diagnosis: what a learned residual finds missing in the law of the tissue, frame by frame.

Each member of an ensemble of hybrids (one tissue compartment and f_NN) reads the regions' curves under the plasma
input of the simulator, its delay and all else that regions share refitted beside a second compartment. What effects
included in the simulator add besides is taken off the curves first. The law lacks f (see `petkin.learning.flux`); where
that is claimed (see `petkin.diagnosis.state_map`), its course is held against what each tissue effect of the catalogue,
refitted alone, would add to the same derivative: the cosine over all regions and frames, in units of the map's spread.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from petkin.diagnosis import (
    ALIKE,
    Base,
    Fit,
    Hypothesis,
    Noise,
    State,
    StateMap,
    Witness,
    draws_left,
    each_alone,
    map_states,
)
from petkin.effects import Camera, Tabulated, Vessels, effect_named
from petkin.imaging import CountingNoise, FrameObservation, FrameSchedule
from petkin.inputs import InputFunction
from petkin.learning import Course, Known, Measured, Members, Read, Scene, lacking
from petkin.study.diagnosis.hypotheses import hypothesis_of
from petkin.study.diagnosis.regional import RegionalSimulator

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Draws of noise behind the claims.
_DRAWS = 1000
#: Half the length of what stands for a moment, min.
_MOMENT = 1e-3
#: Decay that is none but lets tables divide by it, 1/min.
_NO_DECAY = 1e-6
#: Effect beside which the input is refitted, even where it is no candidate.
_ROOM = "second_tissue"
#: Errors below this share of f's root mean square weigh no more in a cosine: before the tracer is there, nothing errs.
_LEAST_ERROR = 0.05
#: A cosine below which nothing is said to be near.
NEAR = 0.5


@dataclass(frozen=True)
class StatesRead:
    """The state map of a scan.

    Args:
        regions: names (R).
        frames: schedule.
        state: mean C_T of the members (R, K), kBq/mL.
        found: f with its bands and claims (R, K), kBq/mL/min.
        nearest: tissue effects and the cosine of what each would add with f, nearest first.
        alike: of these, the ones whose courses have a cosine of `ALIKE` or more with that of the nearest.
        members: how many.
        remarks: what the members have not seen, a sentence each.
    """

    regions: tuple[str, ...]
    frames: FrameSchedule
    state: Array
    found: StateMap
    nearest: tuple[tuple[str, float], ...]
    alike: tuple[str, ...]
    members: int
    remarks: tuple[str, ...]


def read_states(
    members: Members,
    simulator: RegionalSimulator,
    values: Array,
    based: Base,
    candidates: Sequence[Hypothesis],
    *,
    seed: int,
    progress: Progress,
) -> StatesRead:
    """What an ensemble finds missing in a scan.

    Args:
        members: the ensemble.
        simulator: of one tissue compartment.
        values: regional curves (R, K), kBq/mL.
        based: what `base_fit` found of them.
        candidates: effects that may be missing.
        seed: of the draws.
        progress: told what is being done.
    """
    base, noise, *_ = based
    here = _with_room(simulator, values, noise, base)
    plain, input = _plain(simulator, here)
    data = values - (simulator.predict(here.own, here.shared) - plain)
    known = Known(input.plasma, input.whole_blood, simulator.clock)
    scan = Measured(torch.tensor(data), torch.ones(data.shape[1]), known)
    scene = members.scene(scan)
    variances, near = torch.tensor(noise.variance), _near(simulator, here)
    witnesses, tissue = [], []
    for i, reader in enumerate(members.readers(scene)):
        progress(f"reading states, member {i + 1} of {len(members.paths)}", i / len(members.paths))
        both = np.concatenate([data, plain])
        read = reader.read(torch.tensor(both), variances.repeat(2, 1), near.repeat(2, 1))
        witnesses.append(_witness(read, both, len(data)))
        tissue.append(read.tissue[: len(data)].numpy())
    rng = np.random.default_rng((seed, 53))
    drawn = noise.coloured(draws_left(rng, _DRAWS, based))
    found = map_states(witnesses, values - base.values, drawn, noise, rng)
    nearest: tuple[tuple[str, float], ...] = ()
    alike: tuple[str, ...] = ()
    if found.claimed.any():
        progress("what tissue effects would add", 1.0)
        courses = _courses(simulator, values, noise, base, candidates, scene, here)
        nearest, alike = _nearest(found, courses)
    return StatesRead(
        simulator.channels,
        simulator.clock.frames,
        np.mean(tissue, axis=0),
        found,
        nearest,
        alike,
        len(witnesses),
        members.remarks(scan),
    )


def _with_room(simulator: RegionalSimulator, values: Array, noise: Noise, base: Fit) -> State:
    """The simulator's fit with the input that it would have beside a second compartment.

    What all regions share, as the delay of blood, bends to what their tissue lacks, and would hide it.
    """
    if not len(simulator.shared):
        return base.state
    fits = each_alone(simulator, values, noise, base, [hypothesis_of(effect_named(_ROOM), simulator)])
    return replace(base.state, shared=fits[_ROOM].state.shared)


def _plain(simulator: RegionalSimulator, state: State) -> tuple[Array, InputFunction]:
    """The fit's tissue and blood alone (R, K), under the stated clock, and the input that it has."""
    model = simulator.model(state.own, state.shared)
    plain = replace(
        model,
        vascular=Vessels(model.vascular.volume),
        imaging=Camera(),
        clock=simulator.clock,
        noise=CountingNoise(0.0),
    )
    return plain.values(Tabulated(plain.input, plain.clock, simulator.nodes)), model.input


def _near(simulator: RegionalSimulator, state: State) -> torch.Tensor:
    """K1, k2 and vB of the simulator's fit (R, 3)."""
    model = simulator.model(state.own, state.shared)
    parts = (model.tissue.rates["K1"], model.tissue.rates["k2"], model.vascular.volume)
    return torch.tensor(np.stack([np.asarray(part, np.float64) for part in parts], axis=-1))


def _witness(read: Read, both: Array, count: int) -> Witness:
    """A member's reading of the data, the first so many curves, and of the fit, the others."""
    frames, flux, by_u, flux_by_u, covariance, gain = (
        part.numpy() for part in (read.frames, read.flux, read.frames_by_u, read.flux_by_u, read.covariance, read.gain)
    )
    mine, fitted, left = slice(0, count), slice(count, None), both - frames
    return Witness(
        term=flux[mine],
        root=flux_by_u[mine] @ np.linalg.cholesky(covariance[mine]),
        left=left[mine],
        gain=flux_by_u[fitted] @ gain[fitted],
        follows=by_u[fitted] @ gain[fitted],
        beside=left[fitted],
    )


def _courses(
    simulator: RegionalSimulator,
    values: Array,
    noise: Noise,
    base: Fit,
    candidates: Sequence[Hypothesis],
    scene: Scene,
    here: State,
) -> dict[str, Array]:
    """f of every tissue effect, refitted alone and under the one input (R, K), by name."""
    tissue = [h for h in candidates if h.stage == "tissue"]
    if not tissue:
        return {}
    fits = each_alone(simulator, values, noise, base, tissue)
    states = {name: replace(fit.state, shared=here.shared) for name, fit in fits.items()}
    return {name: _added(simulator, state, noise, scene) for name, state in states.items()}


def _added(simulator: RegionalSimulator, state: State, noise: Noise, scene: Scene) -> Array:
    """What a fit with a tissue effect adds to one compartment (R, K)."""
    model = simulator.model(state.own, state.shared, state.terms)
    steps = scene.edges.schedule
    moments = FrameObservation(FrameSchedule(steps.end - _MOMENT, steps.end + _MOMENT), mid_frame=True)

    def tissue(clock: FrameObservation) -> Array:
        return model.tissue.values(replace(model, clock=clock), Tabulated(model.input, clock, simulator.nodes))

    frames, at_ends, over_steps = map(tissue, (simulator.clock, moments, FrameObservation(steps, _NO_DECAY)))
    vB = np.asarray(model.vascular.volume)[:, None]
    frames = (1.0 - vB) * frames + vB * Tabulated(model.input, simulator.clock, simulator.nodes).blood
    course = Course(*(torch.tensor(part) for part in (frames, at_ends, over_steps)))
    variances = torch.tensor(noise.variance)
    return lacking(course, scene, variances, _near(simulator, state)).double().numpy()


def _nearest(found: StateMap, courses: dict[str, Array]) -> tuple[tuple[tuple[str, float], ...], tuple[str, ...]]:
    """Effects by the cosine of their courses with f, and those that look like the nearest."""
    spread = np.maximum(found.spread, _LEAST_ERROR * float(np.sqrt((found.term**2).mean())))
    cosines = {name: _cosine(found.term, course, spread) for name, course in courses.items()}
    ranked = tuple(sorted(cosines.items(), key=lambda entry: -entry[1]))
    if not ranked:
        return (), ()
    first = courses[ranked[0][0]]
    alike = tuple(name for name, _ in ranked[1:] if _cosine(first, courses[name], spread) >= ALIKE)
    return ranked, alike


def _cosine(one: Array, two: Array, spread: Array) -> float:
    a, b = one / spread, two / spread
    return float((a * b).sum() / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300))
