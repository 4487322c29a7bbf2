"""One scan as forward models: as the laboratory recorded it, and as it was, with the effects in it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from torch import Tensor

from petkin.effects import Camera, ForwardModel, Tissue, Vessels
from petkin.errors import InputError
from petkin.imaging import reference_frame
from petkin.inputs import InputFunction
from petkin.kinetics import ONE_TISSUE, TWO_TISSUE, compartment_model
from petkin.phantoms import SYMBOLS, draw_kinetics, draw_voxels, random_stream
from petkin.study.simulation.arterial import Administration, arterial_input, injected
from petkin.study.simulation.planning import Plan

#: Curves computed at once, so that fine grids with kinetics of their own in every voxel stay within memory.
_CHUNK = 16384
#: Table of responses by rate: points, and what is added to a rate (1/min) before its logarithm, so that 0 has one.
_TABLE, _RATE_OFFSET = 400, 1e-3


@dataclass(frozen=True)
class Scene:
    """One scan.

    Args:
        subject: number, from 1.
        session: number, from 1.
        given: weight, dose and plasma curve.
        record: regions as the blood record, the frame times and the sidecar have them.
        truth: regions as they were, with the effects in them.
        voxels: the truth voxel by voxel within the mask, where voxels differ from their regions.
    """

    subject: int
    session: int
    given: Administration
    record: ForwardModel
    truth: ForwardModel
    voxels: ForwardModel | None = None


def scene(plan: Plan, subject: int, session: int) -> Scene:
    """Draw one scan; depends on the plan, the subject and the session alone.

    Raises:
        InputError: an effect that cannot be injected, or a tissue model that the population's kinetics do not suit.
    """
    draw = {"seed": plan.settings.seed, "subject": subject, "session": session}
    given = injected(plan.population, **draw)
    arterial = arterial_input(plan.population, given)
    kinetics = draw_kinetics(plan.population, plan.painted.regions, **draw)
    record = _with_noise_reference(plan, _forward(plan, arterial, kinetics))
    if not plan.settings.voxel_spread:
        return Scene(subject, session, given, record, _with_effects(plan, record))
    own = draw_voxels(plan.population, _of_voxels(plan, kinetics), random_stream(purpose="voxels", **draw))
    voxels = _with_effects(plan, replace(_forward(plan, arterial, own), noise=record.noise))
    if not voxels.is_plain:
        raise InputError("--voxel-spread goes with effects of input, clock, blood volume and compartments alone.")
    return Scene(subject, session, given, record, _with_effects(plan, record), voxels)


def voxel_values(model: ForwardModel) -> Float[NDArray, "voxels frames"]:
    """Noise-free frame values of many curves, kBq/mL, float32.

    A frame value is sum_i phi_i R_k(a_i) with R_k the frame's response to one exponential, smooth in its rate a:
    R is taken from a table in log(a + a0), whose cubic spline departs from it by less than float32 rounds.
    """
    compartments = compartment_model(model.tissue.model)
    phi, rate = (part.numpy() for part in compartments.exponentials(model.parameters))
    knots = np.linspace(np.log(_RATE_OFFSET), np.log(rate.max() + _RATE_OFFSET), _TABLE)
    table = model.clock.of_response(model.input.plasma, torch.from_numpy(np.exp(knots) - _RATE_OFFSET))
    response, blood = CubicSpline(knots, table.numpy()), model.clock.of_forcing(model.input.whole_blood).numpy()
    values = np.empty((len(phi), len(model.clock.frames)), np.float32)
    for start in range(0, len(phi), _CHUNK):
        few = slice(start, start + _CHUNK)
        vB = model.vascular.volume[few, None].numpy()
        tissue = np.einsum("vi,vik->vk", phi[few], response(np.log(rate[few] + _RATE_OFFSET)))
        values[few] = (1.0 - vB) * tissue + vB * blood
    return values


def _forward(plan: Plan, arterial: InputFunction, kinetics: Float[NDArray, "curves symbols"]) -> ForwardModel:
    columns: dict[str, Tensor] = dict(zip(SYMBOLS, torch.from_numpy(kinetics).unbind(-1)))
    volume = columns.pop("vB")
    return ForwardModel(
        regions=tuple(r.name for r in plan.painted.regions),
        input=arterial,
        vascular=Vessels(volume),
        tissue=_tissue(plan, columns),
        imaging=Camera(plan.settings.psf),
        clock=plan.observation,
        noise=plan.noise,
    )


def _tissue(plan: Plan, rates: dict[str, Tensor]) -> Tissue:
    """Two-tissue kinetics as those of the model asked for; one tissue keeps K1 and, where k4 > 0, VT."""
    reversible = bool((rates["k4"] > 0).all())
    if plan.model == TWO_TISSUE.label and not reversible:
        raise InputError(
            f"Population {plan.population.name!r} binds irreversibly (k4 = 0), so {plan.model} has no VT; use 2TCM3k."
        )
    if plan.model == ONE_TISSUE.label and reversible:
        return Tissue(plan.model, {"K1": rates["K1"], "k2": rates["k2"] / (1.0 + rates["k3"] / rates["k4"])})
    needed = plan.compartments.parameters.symbols
    return Tissue(plan.model, {symbol: rate for symbol, rate in rates.items() if symbol in needed})


def _with_noise_reference(plan: Plan, model: ForwardModel) -> ForwardModel:
    """Noise in percent speaks of the mean over the phantom in the reference frame."""
    if plan.noise.percent == 0:
        return model
    weights = plan.painted.fractions.sum(axis=(0, 1, 2))
    level = model.frame_values().numpy()[:, reference_frame(plan.observation)]
    return replace(model, noise=replace(plan.noise, reference=float(level @ weights / weights.sum())))


def _with_effects(plan: Plan, model: ForwardModel) -> ForwardModel:
    for injection in plan.effects:
        model = injection.into(model)
    return model


def _of_voxels(plan: Plan, values: Float[NDArray, "regions n"]) -> Float[NDArray, "voxels n"]:
    """A row a voxel of the mask, in the order of the flattened grid."""
    row = np.zeros(max(r.index for r in plan.painted.regions) + 1, int)
    row[[r.index for r in plan.painted.regions]] = np.arange(len(plan.painted.regions))
    return values[row[plan.painted.labels[plan.painted.mask]]]
