"""Effects of the tissue stage: kinetics beyond the base model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from petkin.dynamics import Parameter, ParameterSet
from petkin.effects.course import Course
from petkin.effects.effect import REGION, Change, Effect, placed
from petkin.effects.forward_model import ForwardModel, Tissue
from petkin.errors import InputError
from petkin.kinetics import ONE_TISSUE, TWO_TISSUE


def _bind(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    if model.tissue.model != ONE_TISSUE.label:
        raise InputError(f"second_tissue: model {model.tissue.model} has a second compartment already; use 1TCM.")
    for symbol, value in values.items():
        if np.min(value) < 0:
            raise InputError(f"second_tissue: {symbol} is {value:g} 1/min; a rate constant is never negative.")
    K1 = model.tissue.rates["K1"]
    added = {symbol: 0.0 * K1 + value for symbol, value in values.items()}
    return replace(model, tissue=replace(model.tissue, model=TWO_TISSUE.label, rates={**model.tissue.rates, **added}))


def _one_tissue(model: ForwardModel) -> bool:
    return model.tissue.model == ONE_TISSUE.label


def _binds(model: ForwardModel) -> bool:
    return model.tissue.model != ONE_TISSUE.label


def _leak(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    return replace(model, tissue=replace(model.tissue, metabolite=(values["share"], values["k2m"])))


def _has_metabolites(model: ForwardModel) -> bool:
    return model.input.total_plasma is not None and model.input.parent_fraction is not None


def _mix(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    if not np.max(np.abs(values["spread"])) < 1:
        raise InputError(f"tissue_heterogeneity={values['spread']}: a relative spread lies in 0 to below 1.")
    return replace(model, tissue=replace(model.tissue, spread=values["spread"]))


def _coursing(build: Callable[[ForwardModel, Mapping[str, Any]], dict[str, Any]]) -> Change:
    """The change that gives the tissue's course what it builds, beside what the course has."""

    def change(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
        tissue: Tissue = model.tissue
        return replace(model, tissue=replace(tissue, course=replace(tissue.course or Course(), **build(model, values))))

    return change


_ONSET = Parameter("onset", "min", 30.0, 0.0, 600.0, meaning="when it sets in")

SECOND_TISSUE = Effect(
    name="second_tissue",
    stage="tissue",
    parameters=ParameterSet(
        (
            Parameter("k3", "min^-1", 0.05, 0.0, 0.2, meaning="rate into the second compartment"),
            Parameter("k4", "min^-1", 0.03, 0.003, 0.3, meaning="rate out of it"),
        )
    ),
    meaning="tracer of a one-tissue region also passes into a second compartment and back",
    source="ranges of arXiv 2403.08194; Gunn RN et al. 2001, doi:10.1097/00004647-200106000-00002 (form)",
    change=_bind,
    split_by="a longer scan, or a scan after blocking",
    regional=("k3", "k4"),
    grid={"k4": (0.01, 0.03, 0.1)},
    suits=_one_tissue,
)
TISSUE_METABOLITE = Effect(
    name="tissue_metabolite",
    stage="tissue",
    parameters=ParameterSet(
        (
            Parameter("share", "1", 0.2, 0.0, 1.0, meaning="rate at which metabolites enter, as a share of K1"),
            Parameter("k2m", "min^-1", 0.1, 0.01, 1.0, meaning="rate of their return"),
        )
    ),
    meaning="labelled metabolites enter the tissue too: a K1 e^{-k2m t} * (C_total - C_P) is added",
    source="form of a one-tissue compartment; K1m of 0.01 to 0.05 mL/cm3/min",
    change=_leak,
    split_by="chromatography of tissue, or a longer scan",
    grid={"k2m": (0.03, 0.15)},
    suits=_has_metabolites,
)
TISSUE_HETEROGENEITY = Effect(
    name="tissue_heterogeneity",
    stage="tissue",
    parameters=ParameterSet((Parameter("spread", "1", 0.4, 0.0, 0.8, meaning="relative spread of K1 and k2"),)),
    meaning="regions are mixed tissue: half of each has K1 and k2 higher by a share, half lower",
    source="spread of 20 to 50 % within regions",
    change=_mix,
    split_by="curves of single voxels",
)
TIME_VARYING_KINETICS = Effect(
    name="time_varying_kinetics",
    stage="tissue",
    parameters=ParameterSet(
        (
            Parameter("release", "1", 0.5, -0.5, 2.0, meaning="relative change of k2 at its peak"),
            _ONSET,
            Parameter("width", "min", 10.0, 2.0, 40.0, meaning="time from the onset to the peak"),
            REGION,
        )
    ),
    meaning="k2 changes for a while in some regions, as when a transmitter is released: k2 (1 + a x e^{1 - x})",
    source="Normandin MD et al. NeuroImage 2012;59:947-960 (gamma-variate); 100 % and more",
    change=_coursing(
        lambda m, v: {"release": placed(m, v, "release"), "released": v["onset"], "width": v["width"]},
    ),
    split_by="a scan at rest, without what set it off",
    regional=("release",),
    grid={"width": (5.0, 15.0)},
)
FLOW_CHANGE = Effect(
    name="flow_change",
    stage="tissue",
    parameters=ParameterSet((Parameter("flow", "1", 0.2, -0.5, 0.5, meaning="relative change of K1 and k2"), _ONSET)),
    meaning="from `onset` on blood flow differs in all regions: K1 and k2 change by the same share",
    source="changes of 10 to 30 %",
    change=_coursing(lambda m, v: {"flow": v["flow"], "changed": v["onset"]}),
    split_by="a measurement of flow, or end-tidal CO2 over the scan",
)
SATURABLE_BINDING = Effect(
    name="saturable_binding",
    stage="tissue",
    parameters=ParameterSet((Parameter("occupancy", "1", 0.3, 0.0, 0.9, meaning="share of the sites that fill up"),)),
    meaning="binding sites fill up: k3 (1 - a C_2 / max C_2)",
    source="Delforge J et al. 1990 (k3 = kon (Bmax - B)); low molar activity",
    change=_coursing(lambda m, v: {"saturation": v["occupancy"]}),
    split_by="a second scan with less mass of tracer",
    suits=_binds,
)
