"""Ready input functions in and out."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from petkin.errors import InputError
from petkin.inputs import analytic_input, feng_plasma, from_table, input_table


def _bolus(t):
    return 100 * t * np.exp(-2 * t) + 4 * np.exp(-0.01 * t) * (t > 0)


def test_a_table_is_read_as_straight_lines():
    t = np.linspace(0, 90, 6000)
    found = from_table(t, _bolus(t), 0.8 * _bolus(t))
    between = (t[1:] + t[:-1]) / 2
    expected = (_bolus(t)[1:] + _bolus(t)[:-1]) / 2
    np.testing.assert_allclose(found.plasma(torch.as_tensor(between)).numpy(), expected, rtol=1e-9)
    assert found.area(90.0) == pytest.approx(np.trapezoid(_bolus(t), t), rel=1e-9)
    assert found.end == 90.0
    assert found.remarks == ()


def test_rows_in_line_go_and_a_tolerance_drops_more():
    t = np.linspace(0, 90, 6000)
    exact, loose = from_table(t, _bolus(t)), from_table(t, _bolus(t), tolerance=1e-4)
    assert loose.plasma.knots.size < 600 < exact.plasma.knots.size
    assert loose.area(90.0) == pytest.approx(exact.area(90.0), rel=2e-3)
    late = from_table(np.arange(100.0), np.maximum(np.arange(100.0) - 50, 0))
    assert late.plasma.knots.tolist() == [0.0, 50.0, 99.0]


def test_missing_whole_blood_is_the_plasma_with_a_remark():
    found = from_table([0, 1, 2], [0, 5, 3])
    assert "Whole blood" in found.remarks[0]
    assert float(found.whole_blood(torch.tensor([1.0], dtype=torch.float64))[0]) == 5.0


def test_a_table_goes_out_as_it_came_in():
    t = np.array([0.0, 1, 2, 5, 20])
    aif, blood, total = np.array([0.0, 50, 20, 6, 1]), np.array([0.0, 45, 22, 9, 5]), np.array([0.0, 51, 22, 8, 4])
    out = input_table(from_table(t, aif, blood, total_plasma=total), t)
    assert list(out.columns) == [
        "time",
        "whole_blood_radioactivity",
        "plasma_radioactivity",
        "metabolite_parent_fraction",
        "AIF",
    ]
    np.testing.assert_allclose(out.AIF, aif)
    np.testing.assert_allclose(out.plasma_radioactivity, total)
    np.testing.assert_allclose(out.whole_blood_radioactivity, blood)
    np.testing.assert_allclose(out.metabolite_parent_fraction[1:], (aif / np.maximum(total, 1))[1:])
    assert np.isnan(out.metabolite_parent_fraction[0])


def test_what_a_formula_does_not_know_is_nan():
    out = input_table(analytic_input(feng_plasma(onset=0.5)), [0.0, 1.0, 10.0])
    assert out[["plasma_radioactivity", "metabolite_parent_fraction"]].isna().all(axis=None)
    assert out.AIF[0] == 0.0
    assert out.AIF[1] > 10


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([0, 1, 2], [0, 5]), r"'AIF' has shape \(2,\)"),
        (([0, 1, 1], [0, 5, 3]), "appears twice"),
        (([0, 1, 2], [0, np.nan, 3]), "1 values of column 'AIF' are missing"),
        (([0, -1, 2], [0, 1, 3]), "before injection"),
        (([0, 1, 2], [0, 0, 0]), "nowhere positive"),
    ],
)
def test_bad_tables_are_refused(arguments, words):
    with pytest.raises(InputError, match=words):
        from_table(*arguments, where="input.tsv")
