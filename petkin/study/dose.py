"""Body weight over injected dose, as standardised uptake values need it: never from numbers that contradict."""

from __future__ import annotations

from petkin.errors import InputError
from petkin.fitting import Need
from petkin.io.checks import dose as doubts_of_dose
from petkin.io.sidecar import PetSidecar
from petkin.study.request import FitRequest

_GRAM_PER_KG = 1e3
_KBQ_PER_MBQ = 1e3


def suv_factor(label: str, sidecar: PetSidecar | None, body_weight: float | None, request: FitRequest) -> float | None:
    """Body weight / dose, g/kBq, so that SUV = C * factor in g/mL; None where no model needs it.

    Args:
        label: scan, for messages.
        sidecar: `_pet.json`, or None of an image outside BIDS.
        body_weight: kg as the study states it, or None.
        request: what was asked; `dose` and `body_weight` come before what the study states.

    Raises:
        InputError: one of the two is missing, or the sidecar's doses contradict each other or belief.
    """
    if not request.needs(Need.DOSE):
        return None
    weight = request.body_weight or body_weight
    if weight is None:
        raise InputError(
            f"{label}: an SUV needs the body weight, which neither participants.tsv (weight, kg) nor the sidecar "
            "(BodyWeight) states: give --body-weight KG."
        )
    return weight * _GRAM_PER_KG / (_dose_mbq(label, sidecar, request.dose) * _KBQ_PER_MBQ)


def _dose_mbq(label: str, sidecar: PetSidecar | None, chosen: str | float | None) -> float:
    """The dose, MBq: as given, as chosen of the sidecar's two, or as stated where nothing speaks against it."""
    if isinstance(chosen, float):
        return chosen
    if sidecar is None:
        raise InputError(f"{label}: an SUV needs the injected dose: give --dose MBQ.")
    if chosen is None:
        for doubt in doubts_of_dose(sidecar):
            raise InputError(
                f"{doubt.where}: {doubt.text.rstrip('.')}, or give --dose stated, --dose total, or --dose MBQ."
            )
    total = sidecar.radionuclide_total_dose
    dose = sidecar.dose_mbq if chosen != "total" else None if total is None else total * 1e-6
    if not dose or dose < 0:
        field = "RadionuclideTotalDose" if chosen == "total" else "InjectedRadioactivity"
        raise InputError(f"{label}: {field} states no dose, and an SUV needs one: give --dose MBQ.")
    return dose
