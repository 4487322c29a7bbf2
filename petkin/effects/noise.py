"""Effects of the noise stage: how frame values scatter, and what a reconstruction without negative values adds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from petkin.dynamics import Parameter, ParameterSet
from petkin.effects.effect import Effect
from petkin.effects.forward_model import ForwardModel


def _flatten(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    return replace(model, noise=replace(model.noise, flatness=values["flatness"]))


def _lift(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    return replace(model, noise=replace(model.noise, bias=values["excess"]))


NOISE_VARIANCE = Effect(
    name="noise_variance",
    stage="noise",
    parameters=ParameterSet(
        (Parameter("flatness", "1", 1.0, 0.0, 1.0, meaning="0: as counts; 1: the same sd always"),)
    ),
    meaning="values do not scatter as counts do: their variance is more even over frames and regions",
    source="smoothing and post-processing; no mean changes",
    change=_flatten,
    split_by="replicate reconstructions of the list-mode record",
)
NONNEGATIVITY_BIAS = Effect(
    name="nonnegativity_bias",
    stage="noise",
    parameters=ParameterSet(
        (Parameter("excess", "1", 0.05, 0.0, 0.2, meaning="excess in the noisiest frame, share of the peak"),)
    ),
    meaning="a reconstruction that allows no negative values lifts noisy frames by var / value",
    source="Jian Y et al. Med Phys 2014 (bias of few counts); range a judgement",
    change=_lift,
    split_by="a reconstruction by filtered back-projection",
)
