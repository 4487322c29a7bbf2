"""The list of models and how one is found."""

from __future__ import annotations

import pytest

from petkin.errors import InputError
from petkin.kinetics import MODELS, compartment_model


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.label)
def test_a_model_is_found_by_its_label_in_any_case(model):
    assert compartment_model(model.label) is model
    assert compartment_model(model.label.lower()) is model


def test_labels_are_unique_and_blood_volume_comes_last():
    assert len({m.label.lower() for m in MODELS}) == len(MODELS)
    for model in MODELS:
        assert model.parameters.symbols[-1] == "vB"
        assert model.parameters.symbols[0] == "K1"
        assert len(set(model.parameters.symbols) | {m.symbol for m in model.macros}) == len(model.parameters) + len(
            model.macros
        )


def test_an_unknown_label_is_refused_with_the_choices():
    with pytest.raises(InputError, match="no compartment model '3TCM'; choose one of 1TCM, 2TCM, 2TCM3k"):
        compartment_model("3TCM")
