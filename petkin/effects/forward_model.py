"""The forward model of a scan, one field a stage: what an effect changes, and what gives the frame values.

blood record -> [input] C_P, C_B -> [tissue] C_T -> [vascular] (1 - vB) C_T + vB C_B -> [imaging] space, gain
             -> [clock] frames and decay -> [noise] counts
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from petkin.dynamics.arrays import library
from petkin.effects.course import Course
from petkin.effects.responses import Exact, Responses, alike
from petkin.errors import InputError
from petkin.imaging import CountingNoise, Exchange, FrameObservation, Motion
from petkin.inputs import InputFunction
from petkin.kinetics import BLOOD_VOLUME, CompartmentModel, compartment_model

#: Frame values (..., regions, frames) as they would be -> as the scanner has them. Given the clock.
Distortion = Callable[[Any, FrameObservation], Any]


@dataclass(frozen=True)
class Tissue:
    """Tissue stage: the compartment model and its rate constants in every region.

    Args:
        model: label, e.g. "2TCM".
        rates: by symbol, each (regions,), K1 in mL/cm3/min, others in 1/min.
        spread: relative spread of K1 and k2 within regions: half of each lies above by it, half below.
        metabolite: share of K1 at which metabolites enter, and their rate of return, 1/min.
        course: how the rates change over the scan.
    """

    model: str
    rates: Mapping[str, Any]
    spread: Any = 0.0
    metabolite: tuple[Any, float] | None = None
    course: Course | None = None

    def values(self, model: ForwardModel, seen: Responses) -> Any:
        """Frame values of C_T (..., regions, frames)."""
        compartments = compartment_model(self.model)
        rates = {symbol: self.rates[symbol] for symbol in compartments.parameters.symbols[: compartments.rates]}
        if present(self.spread):
            each = [self._halved(rates, half) for half in (1.0 + self.spread, 1.0 - self.spread)]
            total: Any = 0.5 * sum(_response(compartments, seen, half) for half in each)
        else:
            total = _response(compartments, seen, rates.values())
        if self.metabolite is not None:
            share, back = self.metabolite
            K1 = rates["K1"]
            total = total + (share * K1)[..., None] * seen.metabolites(0.0 * K1 + back)
        if self.course is not None:
            total = total + alike(self._departure(model, list(rates.values())), total)
        return total

    @staticmethod
    def _halved(rates: Mapping[str, Any], by: Any) -> list[Any]:
        """Of one half of the voxels."""
        return [rate * by if symbol in ("K1", "k2") else rate for symbol, rate in rates.items()]

    def _departure(self, model: ForwardModel, rates: list[Any]) -> Any:
        plain = [rate if isinstance(rate, np.ndarray) else torch.as_tensor(rate).detach().numpy() for rate in rates]
        missing = [np.zeros_like(plain[0])] * (4 - len(plain))
        assert self.course is not None
        return self.course.departure(np.stack([*plain, *missing], axis=-1), model.input.plasma, model.clock)


def _response(compartments: CompartmentModel, seen: Responses, rates: Iterable[Any]) -> Any:
    """Frame values of C_T at constant rates."""
    phi, a = zip(*compartments.impulse(*rates), strict=True)
    first, *rest = (p[..., None] * response for p, response in zip(phi, seen.plasma(library(a[0]).stack(a))))
    return sum(rest, first)


@dataclass(frozen=True)
class Vessels:
    """Vascular stage.

    Args:
        volume: vB, the share of each region that is blood (regions,).
        trapping: Kb, at which the walls of the vessels trap, 1/min.
        release: kr, at which they let go again, 1/min.
        lining: share of the region whose walls trap; None is vB.
    """

    volume: Any
    trapping: Any = 0.0
    release: Any = 0.0
    lining: float | None = None


@dataclass(frozen=True)
class Camera:
    """Imaging stage.

    Args:
        point_spread: FWHM of images, mm.
        distortions: what happens to the regions' values besides.
        motions: how the picture moves, given the clock.
        moves: what that adds to regions; None where there is a picture that moves itself, or where none tells.
    """

    point_spread: float = 0.0
    distortions: tuple[Distortion, ...] = ()
    motions: tuple[Callable[[FrameObservation], Motion], ...] = ()
    moves: Exchange | None = None


@dataclass(frozen=True)
class ForwardModel:
    """All that makes the frame values of a scan; fields other than `regions` are the stages, by their names.

    Args:
        regions: names.
        input: what arrives in the tissue, which effects may part from the blood record.
        vascular: blood in the regions.
        tissue: kinetics.
        imaging: the scanner in space.
        clock: frames and decay as they truly were.
        noise: counting noise.
    """

    regions: tuple[str, ...]
    input: InputFunction
    vascular: Vessels
    tissue: Tissue
    imaging: Camera
    clock: FrameObservation
    noise: CountingNoise

    @property
    def parameters(self) -> Float[Tensor, "regions P"]:
        """Parameters of the compartment model, in its order.

        Raises:
            InputError: a rate constant that the model needs is missing.
        """
        symbols = compartment_model(self.tissue.model).parameters.symbols
        known = {**self.tissue.rates, BLOOD_VOLUME.symbol: self.vascular.volume}
        missing = [s for s in symbols if s not in known]
        if missing:
            raise InputError(f"Model {self.tissue.model} needs {', '.join(missing)}, which the tissue does not have.")
        return torch.stack([known[s] for s in symbols], dim=-1)

    @property
    def is_plain(self) -> bool:
        """Whether values are compartments and blood alone, with nothing that changes, mixes or scales them besides."""
        tissue, added = self.tissue, (self.vascular.trapping, self.noise.bias)
        changed = present(tissue.spread) or tissue.metabolite is not None or tissue.course is not None
        return not (changed or self.imaging.distortions or any(map(present, added)))

    def frame_values(self) -> Float[Tensor, "regions frames"]:
        """Noise-free values that the frames report of each region, kBq/mL, before the point spread; differentiable."""
        _ = self.parameters
        return self.values(Exact(self.input, self.clock))

    def values(self, seen: Responses) -> Any:
        """The same from given responses; rates and volumes may have batch axes before that of the regions."""
        return self.shown(self.uptake(seen))

    def uptake(self, seen: Responses) -> Any:
        """What the regions hold, before the scanner changes it."""
        vB = self.vascular.volume
        values = (1.0 - vB)[..., None] * self.tissue.values(self, seen) + vB[..., None] * seen.blood
        if present(self.vascular.trapping):
            lining = vB if self.vascular.lining is None else 0.0 * vB + self.vascular.lining
            values = values + (lining * self.vascular.trapping)[..., None] * seen.trapped(self.vascular.release)
        return values

    def shown(self, values: Any) -> Any:
        """What the scanner makes of what the regions hold."""
        if self.imaging.moves is not None:
            for motion in self.imaging.motions:
                shares = alike(self.imaging.moves.by(motion(self.clock)), values)
                values = values + library(values).einsum("krs,...sk->...rk", shares, values)
        for distortion in self.imaging.distortions:
            values = distortion(values, self.clock)
        if self.noise.bias:
            values = values + alike(self.noise.excess(self.clock) * peak(values), values)
        return values


def present(amount: Any) -> bool:
    """Whether an amount, or one of several, is not zero."""
    return amount != 0 if isinstance(amount, float) else bool(np.any(amount))


def peak(values: Any) -> NDArray[np.float64]:
    """Highest mean over the regions (..., 1, 1), kBq/mL."""
    return highest(values.mean(axis=-2))[..., None]


def highest(course: Any) -> NDArray[np.float64]:
    """Highest of all frames (..., 1); each of a batch has its own, or slopes would be wrong."""
    return np.asarray(torch.as_tensor(course).detach(), np.float64).max(axis=-1, keepdims=True)


#: Names of the stages in the order of the chain.
STAGES = tuple(f.name for f in fields(ForwardModel) if f.name != "regions")
