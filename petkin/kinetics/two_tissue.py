"""Two-tissue compartment model: reversible (2TCM) and with k4 = 0 (2TCM3k).

The 2TCM's rates are the roots of a^2 - (k2 + k3 + k4) a + k2 k4 = 0, and both amplitudes are non-negative with sum K1:

    phi_1 = K1 (a1 - k3 - k4) / (a1 - a2),   phi_2 = K1 (k3 + k4 - a2) / (a1 - a2),   a1 >= a2 >= 0,

where both amplitudes together are taken as K1 to the last digit: only so do values and derivatives survive a1 = a2.

Conversely K1 = phi_1 + phi_2, k2 = (phi_1 a1 + phi_2 a2) / K1, k4 = a1 a2 / k2, k3 = a1 + a2 - k2 - k4, so that
non-negative amplitudes and rates are exactly the non-negative rate constants.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from petkin.dynamics import Parameter, ParameterSet
from petkin.kinetics.compartment import BLOOD_VOLUME, CompartmentModel, Macro

if TYPE_CHECKING:
    from torch import Tensor

#: Added under the root (1/min^2): keeps its derivative finite where both rates meet, far below rounding elsewhere.
_ROOT_FLOOR = 1e-18
#: Added to a rate (1/min) that divides: where nothing leaves the tissue, the limit K1 stands and not 0/0.
_RATE_FLOOR = 1e-18

_REFERENCE = (
    "Mintun MA et al. Ann Neurol 1984;15:217-227, doi:10.1002/ana.410150302; "
    "Gunn et al. 2001, doi:10.1097/00004647-200106000-00002"
)
_K1 = Parameter("K1", "mL cm^-3 min^-1", 0.1, 0.0, 10.0, meaning="rate of transfer from plasma to tissue")
_k2 = Parameter("k2", "min^-1", 0.1, 0.0, 5.0, meaning="rate of return from tissue to plasma")
_k3 = Parameter("k3", "min^-1", 0.05, 0.0, 5.0, meaning="rate into the second compartment (binding, phosphorylation)")
_k4 = Parameter("k4", "min^-1", 0.05, 0.0, 5.0, meaning="rate out of the second compartment")


def _impulse(K1, k2, k3, k4):
    total = k2 + k3 + k4
    gap = ((k2 - k4) * (k2 - k4) + k3 * k3 + 2.0 * k3 * (k2 + k4) + _ROOT_FLOOR) ** 0.5  # a1 - a2, without cancellation
    fast = 0.5 * (total + gap)
    slow = (k2 * k4 - 0.25 * _ROOT_FLOOR) / fast  # the partner of the floored gap, or derivatives go wrong near gap = 0
    lasting = 0.5 * K1 * (1.0 + ((k4 - k2) + k3) / gap)
    return (K1 - lasting, fast), (lasting, slow)


def _invert(fast, slow):
    (phi_1, a1), (phi_2, a2) = fast, slow
    K1 = phi_1 + phi_2
    k2 = (phi_1 * a1 + phi_2 * a2) / K1
    k4 = a1 * a2 / k2
    return K1, k2, phi_1 * phi_2 * (a1 - a2) * (a1 - a2) / (K1 * K1 * k2), k4


def _field(state: Tensor, plasma: Tensor, rates: Tensor) -> Tensor:
    import torch

    K1, k2, k3, k4 = rates.unbind(-1)
    free, bound = state.unbind(-1)
    return torch.stack([K1 * plasma - (k2 + k3) * free + k4 * bound, k3 * free - k4 * bound], dim=-1)


def _impulse_trapping(K1, k2, k3):
    fast = k2 + k3
    lasting = K1 * k3 / (fast + _RATE_FLOOR)
    return (K1 - lasting, fast), (lasting, 0.0 * fast)


def _invert_trapping(fast, trapped):
    (phi_1, a1), (phi_2, _) = fast, trapped
    K1 = phi_1 + phi_2
    return K1, a1 * phi_1 / K1, a1 * phi_2 / K1


def _field_trapping(state: Tensor, plasma: Tensor, rates: Tensor) -> Tensor:
    import torch

    return _field(state, plasma, torch.cat([rates, torch.zeros_like(rates[..., :1])], dim=-1))


TWO_TISSUE = CompartmentModel(
    label="2TCM",
    name="two-tissue compartment model",
    equation="dC_1/dt = K1 C_P - (k2 + k3) C_1 + k4 C_2;  dC_2/dt = k3 C_1 - k4 C_2;  C_T = C_1 + C_2",
    reference=_REFERENCE,
    parameters=ParameterSet((_K1, _k2, _k3, _k4, BLOOD_VOLUME)),
    states=("C_1", "C_2"),
    free_rates=2,
    trapping=False,
    impulse=_impulse,
    invert=_invert,
    field=_field,
    macros=(
        Macro("VT", "mL cm^-3", lambda K1, k2, k3, k4: K1 / k2 * (1.0 + k3 / k4), "total distribution volume"),
        Macro("VND", "mL cm^-3", lambda K1, k2, k3, k4: K1 / k2, "non-displaceable distribution volume, K1/k2"),
        Macro("BPND", "1", lambda K1, k2, k3, k4: k3 / k4, "binding potential, k3/k4"),
        Macro("Ki", "mL cm^-3 min^-1", lambda K1, k2, k3, k4: K1 * k3 / (k2 + k3), "net influx rate, K1 k3/(k2 + k3)"),
    ),
)

TWO_TISSUE_TRAPPING = CompartmentModel(
    label="2TCM3k",
    name="irreversible two-tissue compartment model, k4 = 0",
    equation="dC_1/dt = K1 C_P - (k2 + k3) C_1;  dC_2/dt = k3 C_1;  C_T = C_1 + C_2",
    reference="Phelps ME et al. Ann Neurol 1979;6:371-388, doi:10.1002/ana.410060502",
    parameters=ParameterSet((_K1, _k2, _k3, BLOOD_VOLUME)),
    states=("C_1", "C_2"),
    free_rates=1,
    trapping=True,
    impulse=_impulse_trapping,
    invert=_invert_trapping,
    field=_field_trapping,
    macros=(
        Macro("Ki", "mL cm^-3 min^-1", lambda K1, k2, k3: K1 * k3 / (k2 + k3), "net influx rate, K1 k3/(k2 + k3)"),
        Macro("VND", "mL cm^-3", lambda K1, k2, k3: K1 / k2, "distribution volume of the exchangeable pool, K1/k2"),
    ),
)
