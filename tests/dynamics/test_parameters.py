"""Parameters travel as one object."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from petkin.dynamics import Parameter, ParameterSet
from petkin.errors import InputError

RATES = ParameterSet((Parameter("k1", "1/min", 0.1, 0.0, 1.0), Parameter("k2", "1/min", 0.2, 0.01, 2.0, fixed=True)))


def test_order_symbols_and_lookup() -> None:
    assert RATES.symbols == ("k1", "k2")
    assert len(RATES) == 2
    assert [p.symbol for p in RATES] == ["k1", "k2"]
    assert RATES["k2"].upper == 2.0
    assert [p.symbol for p in RATES.free] == ["k1"]
    np.testing.assert_array_equal(RATES.start, [0.1, 0.2])


def test_a_fixed_parameter_has_its_start_for_both_bounds() -> None:
    np.testing.assert_array_equal(RATES.lower, [0.0, 0.2])
    np.testing.assert_array_equal(RATES.upper, [1.0, 0.2])


@settings(max_examples=30, deadline=None)
@given(st.floats(-5, 5), st.floats(0, 5))
def test_new_bounds_hold_the_start(low: float, width: float) -> None:
    changed = RATES.with_bounds({"k1": (low, low + width)})
    assert (changed["k1"].lower, changed["k1"].upper) == (low, low + width)
    assert changed["k1"].start == min(max(0.1, low), low + width)
    assert changed["k2"] == RATES["k2"]


@settings(max_examples=30, deadline=None)
@given(st.floats(-5, 5))
def test_fixing_holds_the_value_wherever_it_lies(value: float) -> None:
    held = RATES.with_fixed({"k1": value})
    assert held["k1"].fixed
    assert held.lower[0] == held.upper[0] == held.start[0] == value
    assert RATES["k1"].start == 0.1, "the original set is left as it is"


def test_what_cannot_be_used_is_refused() -> None:
    with pytest.raises(InputError, match=r"k1: start 3 lies outside its bounds \[0, 1\]"):
        Parameter("k1", "1/min", 3.0, 0.0, 1.0)
    with pytest.raises(InputError, match="no parameter 'k9'; this model has k1, k2"):
        RATES.with_fixed({"k9": 0.0})
    with pytest.raises(InputError, match="outside its bounds"):
        RATES.with_bounds({"k1": (1.0, 0.0)})
