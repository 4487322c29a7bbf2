"""Any two-tissue model with VND = K1/k2 in place of K1: what regions may share where nothing specific binds."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from petkin.dynamics import Parameter, ParameterSet
from petkin.kinetics.compartment import CompartmentModel, Macro

if TYPE_CHECKING:
    from torch import Tensor

_VND = Parameter("VND", "mL cm^-3", 1.0, 0.0, 100.0, meaning="non-displaceable distribution volume, K1/k2")


def with_ratio(model: CompartmentModel) -> CompartmentModel:
    """The same model and curves, its parameters VND, k2, ... for K1, k2, ...: VND scales the curve as K1 did."""

    def impulse(VND: Any, k2: Any, *others: Any):
        return model.impulse(VND * k2, k2, *others)

    def invert(*pairs: Any):
        K1, k2, *others = model.invert(*pairs)
        return K1 / k2, k2, *others

    def field(state: Tensor, plasma: Tensor, rates: Tensor) -> Tensor:
        import torch

        return model.field(state, plasma, torch.cat([rates[..., :1] * rates[..., 1:2], rates[..., 1:]], dim=-1))

    def follows(macro: Macro) -> Macro:
        return replace(macro, formula=lambda VND, k2, *others: macro.formula(VND * k2, k2, *others))

    K1 = model.parameters["K1"]
    macros = tuple(follows(m) for m in model.macros if m.symbol != _VND.symbol)
    return replace(
        model,
        parameters=ParameterSet((_VND, *model.parameters.members[1:])),
        impulse=impulse,
        invert=invert,
        field=field,
        macros=(*macros, Macro("K1", K1.unit, lambda VND, k2, *others: VND * k2, K1.meaning)),
    )
