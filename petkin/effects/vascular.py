"""Effects of the vascular stage: blood within the regions, and what the walls of its vessels keep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from petkin.dynamics import Parameter, ParameterSet
from petkin.effects.effect import Effect
from petkin.effects.forward_model import ForwardModel, present
from petkin.errors import InputError

#: Share of vessels whose walls trap where a forward model has no blood volume.
_USUAL_VOLUME = 0.05
_RETURN = Parameter("kr", "min^-1", 0.0, 0.0, 0.1, meaning="rate at which they let go again")


def _fill(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    volume = values["vB"]
    if not (np.min(volume) >= 0 and np.max(volume) <= 1):
        raise InputError(f"blood_volume={volume}: a share of a volume lies in 0 to 1; 5 percent is 0.05.")
    return replace(model, vascular=replace(model.vascular, volume=0.0 * model.vascular.volume + volume))


def _trap(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    if np.min(values["Kb"]) < 0:
        raise InputError(f"vascular_trapping={values['Kb']}: a rate constant is never negative.")
    lining = None if bool((model.vascular.volume > 0).all()) else _USUAL_VOLUME
    return _release(replace(model, vascular=replace(model.vascular, trapping=values["Kb"], lining=lining)), values)


def _release(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    if np.min(values["kr"]) < 0:
        raise InputError(f"kr={values['kr']}: a rate constant is never negative.")
    return replace(model, vascular=replace(model.vascular, release=values["kr"]))


def _let_go(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    if not _traps(model):
        raise InputError("vascular_release: no vessel wall traps anything here; vascular_trapping must come before it.")
    return _release(model, values)


def _traps(model: ForwardModel) -> bool:
    return present(model.vascular.trapping)


BLOOD_VOLUME_EFFECT = Effect(
    name="blood_volume",
    stage="vascular",
    parameters=ParameterSet((Parameter("vB", "1", 0.05, 0.0, 0.2, meaning="share of the region that is blood"),)),
    meaning="regions hold (1 - vB) C_T + vB C_B; injected, vB is the same in all regions and replaces what they had",
    source="Innis RB et al. J Cereb Blood Flow Metab 2007;27:1533-1539, doi:10.1038/sj.jcbfm.9600493",
    change=_fill,
    split_by="early frames of 5 s or less, or a scan of labelled blood",
    regional=("vB",),
    alike=True,
)

VASCULAR_TRAPPING = Effect(
    name="vascular_trapping",
    stage="vascular",
    parameters=ParameterSet(
        (Parameter("Kb", "min^-1", 0.2, 0.0, 1.0, meaning="rate at which vessel walls trap"), _RETURN)
    ),
    meaning="the walls of the vessels trap tracer and may let it go: vB Kb e^{-kr t} * C_B is added",
    source="Rizzo G et al. J Cereb Blood Flow Metab 2014;34:1060-1069, doi:10.1038/jcbfm.2014.55",
    change=_trap,
    split_by="a scan after blocking, or a longer scan",
    regional=("Kb",),
    alike=True,
    grid={"kr": (0.005, 0.03)},
)
VASCULAR_RELEASE = Effect(
    name="vascular_release",
    stage="vascular",
    parameters=ParameterSet((replace(_RETURN, start=0.03),)),
    meaning="what vessel walls trap returns to the blood: vB Kb e^{-kr t} * C_B instead of vB Kb int_0^t C_B",
    source="a first-order return beside the trapping of Rizzo G et al. 2014, doi:10.1038/jcbfm.2014.55",
    change=_let_go,
    split_by="a scan after blocking, or a longer scan",
    suits=_traps,
)
