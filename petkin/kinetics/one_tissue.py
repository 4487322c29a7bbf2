"""One-tissue compartment model (1TCM)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from petkin.dynamics import Parameter, ParameterSet
from petkin.kinetics.compartment import BLOOD_VOLUME, CompartmentModel, Macro

if TYPE_CHECKING:
    from torch import Tensor


def _impulse(K1, k2):
    return ((K1, k2),)


def _invert(only):
    return only


def _field(state: Tensor, plasma: Tensor, rates: Tensor) -> Tensor:
    K1, k2 = rates.unbind(-1)
    return (K1 * plasma - k2 * state[..., 0])[..., None]


ONE_TISSUE = CompartmentModel(
    label="1TCM",
    name="one-tissue compartment model",
    equation="dC_T/dt = K1 C_P - k2 C_T",
    reference="Kety SS. Pharmacol Rev 1951;3:1-41; Gunn et al. 2001, doi:10.1097/00004647-200106000-00002",
    parameters=ParameterSet(
        (
            Parameter("K1", "mL cm^-3 min^-1", 0.1, 0.0, 10.0, meaning="rate of transfer from plasma to tissue"),
            Parameter("k2", "min^-1", 0.1, 0.0, 5.0, meaning="rate of return from tissue to plasma"),
            BLOOD_VOLUME,
        )
    ),
    states=("C_T",),
    free_rates=1,
    trapping=False,
    impulse=_impulse,
    invert=_invert,
    field=_field,
    macros=(Macro("VT", "mL cm^-3", lambda K1, k2: K1 / k2, "total distribution volume, K1/k2"),),
)
