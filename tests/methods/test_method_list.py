"""The list of methods, and what its members owe."""

from __future__ import annotations

import pytest

from petkin.errors import InputError
from petkin.fitting import Choices
from petkin.methods import METHODS, check_choices, find_method


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.label)
def test_a_method_is_found_by_its_label_in_any_case_and_says_what_it_is(method):
    assert find_method(method.label.lower()) is method
    assert method.name
    assert method.equation
    assert method.how.endswith(".")
    assert "doi:" in method.reference


def test_labels_are_unique():
    assert len({m.label.lower() for m in METHODS}) == len(METHODS)


def test_an_unknown_label_is_refused_with_the_choices():
    with pytest.raises(InputError, match="There is no model '3TCM'; choose from 1TCM, 2TCM"):
        find_method("3TCM")


def test_choices_that_no_method_knows_are_refused():
    methods = (find_method("1TCM"), find_method("Patlak"))
    check_choices(methods, Choices(fixed={"vB": 0.05}, bounds={"K1": (0.0, 2.0)}))
    with pytest.raises(InputError, match="'k3' is no parameter of 1TCM, Patlak; these have K1, k2, vB"):
        check_choices(methods, Choices(fixed={"k3": 0.1}))
    with pytest.raises(InputError, match="Bounds of K1 are 2 to 1"):
        check_choices(methods, Choices(bounds={"K1": (2.0, 1.0)}))
