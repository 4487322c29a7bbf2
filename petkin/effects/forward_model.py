"""The forward model of a scan, one field a stage: what an effect changes, and what gives the frame values.

blood record -> [input] C_P, C_B -> [tissue] C_T -> [vascular] (1 - vB) C_T + vB C_B -> [imaging] space
             -> [clock] frames and decay -> [noise] counts
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import torch
from jaxtyping import Float
from torch import Tensor

from petkin.errors import InputError
from petkin.imaging import CountingNoise, FrameObservation
from petkin.inputs import InputFunction
from petkin.kinetics import BLOOD_VOLUME, compartment_model


@dataclass(frozen=True)
class Tissue:
    """Tissue stage: the compartment model and its rate constants in every region.

    Args:
        model: label, e.g. "2TCM".
        rates: by symbol, each (regions,), K1 in mL/cm3/min, others in 1/min.
    """

    model: str
    rates: Mapping[str, Float[Tensor, " regions"]]


@dataclass(frozen=True)
class Vessels:
    """Vascular stage: vB, the fraction of each region that is blood (regions,)."""

    volume: Float[Tensor, " regions"]


@dataclass(frozen=True)
class Camera:
    """Imaging stage, in space: FWHM of the point spread, mm."""

    point_spread: float = 0.0


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

    def frame_values(self) -> Float[Tensor, "regions frames"]:
        """Noise-free values that the frames report of each region, kBq/mL, before the point spread."""
        return compartment_model(self.tissue.model).frame_values(self.parameters, self.input, self.clock)


#: Names of the stages in the order of the chain.
STAGES = tuple(f.name for f in fields(ForwardModel) if f.name != "regions")
