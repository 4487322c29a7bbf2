"""Kinetics: one file a model; `MODELS` is the list."""

from petkin.errors import InputError
from petkin.kinetics.compartment import BLOOD_VOLUME, CompartmentModel, Macro
from petkin.kinetics.one_tissue import ONE_TISSUE
from petkin.kinetics.ratio import with_ratio
from petkin.kinetics.two_tissue import TWO_TISSUE, TWO_TISSUE_TRAPPING
from petkin.kinetics.vascular_trapping import VASCULAR_TRAPPING

MODELS = (ONE_TISSUE, TWO_TISSUE, TWO_TISSUE_TRAPPING, VASCULAR_TRAPPING)


def compartment_model(label: str) -> CompartmentModel:
    """The compartment model with this label.

    Raises:
        InputError: there is none.
    """
    for model in MODELS:
        if model.label.lower() == label.lower():
            return model
    raise InputError(f"There is no compartment model {label!r}; choose one of {', '.join(m.label for m in MODELS)}.")


__all__ = [
    "BLOOD_VOLUME",
    "MODELS",
    "ONE_TISSUE",
    "TWO_TISSUE",
    "TWO_TISSUE_TRAPPING",
    "VASCULAR_TRAPPING",
    "CompartmentModel",
    "Macro",
    "compartment_model",
    "with_ratio",
]
