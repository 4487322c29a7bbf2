"""Effects of the tissue stage: kinetics beyond the base model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import torch

from petkin.dynamics import Parameter, ParameterSet
from petkin.effects.effect import Effect
from petkin.effects.forward_model import ForwardModel, Tissue
from petkin.errors import InputError
from petkin.kinetics import ONE_TISSUE, TWO_TISSUE


def _bind(model: ForwardModel, values: Mapping[str, float]) -> ForwardModel:
    if model.tissue.model != ONE_TISSUE.label:
        raise InputError(f"second_tissue: model {model.tissue.model} has a second compartment already; use 1TCM.")
    for symbol, value in values.items():
        if value < 0:
            raise InputError(f"second_tissue: {symbol} is {value:g} 1/min; a rate constant is never negative.")
    K1 = model.tissue.rates["K1"]
    added = {symbol: torch.full_like(K1, value) for symbol, value in values.items()}
    return replace(model, tissue=Tissue(TWO_TISSUE.label, {**model.tissue.rates, **added}))


SECOND_TISSUE = Effect(
    name="second_tissue",
    stage="tissue",
    parameters=ParameterSet(
        (
            Parameter("k3", "min^-1", 0.05, 0.01, 0.1, meaning="rate into the second compartment"),
            Parameter("k4", "min^-1", 0.03, 0.01, 0.05, meaning="rate out of it"),
        )
    ),
    meaning="tracer of a one-tissue region also passes into a second compartment and back, at shared rates",
    source="ranges of arXiv 2403.08194; Gunn RN et al. 2001, doi:10.1097/00004647-200106000-00002 (form)",
    change=_bind,
)
