"""Effects of the vascular stage: blood within the regions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import torch

from petkin.dynamics import Parameter, ParameterSet
from petkin.effects.effect import Effect
from petkin.effects.forward_model import ForwardModel, Vessels
from petkin.errors import InputError


def _fill(model: ForwardModel, values: Mapping[str, float]) -> ForwardModel:
    volume = values["vB"]
    if not 0 <= volume <= 1:
        raise InputError(f"blood_volume={volume:g}: a share of a volume lies in 0 to 1; 5 percent is 0.05.")
    return replace(model, vascular=Vessels(torch.full_like(model.vascular.volume, volume)))


BLOOD_VOLUME_EFFECT = Effect(
    name="blood_volume",
    stage="vascular",
    parameters=ParameterSet((Parameter("vB", "1", 0.05, 0.0, 0.2, meaning="share of the region that is blood"),)),
    meaning="regions hold (1 - vB) C_T + vB C_B; injected, vB is the same in all regions and replaces what they had",
    source="Innis RB et al. J Cereb Blood Flow Metab 2007;27:1533-1539, doi:10.1038/sj.jcbfm.9600493",
    change=_fill,
)
