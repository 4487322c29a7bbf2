"""Plasma curves as formulas: limits, areas, published peaks."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from petkin.errors import InputError
from petkin.inputs import analytic_input, exponentials, feng, feng_plasma, linear_rise, paper_plasma


def _feng_by_hand(t: float, A1: float, A2: float, A3: float, rates: tuple[float, float, float]) -> float:
    l1, l2, l3 = rates
    return (A1 * t - A2 - A3) * np.exp(l1 * t) + A2 * np.exp(l2 * t) + A3 * np.exp(l3 * t)


def _times(*t: float) -> torch.Tensor:
    return torch.tensor(t, dtype=torch.float64)


@pytest.mark.parametrize(
    ("curve", "height", "at"),
    [(paper_plasma(100.0), 42.5, 0.60), (paper_plasma(200.0), 48.8, 0.44), (feng_plasma(), 103.0, 0.29)],
)
def test_presets_peak_where_they_should(curve, height, at):
    t = torch.arange(0, 5, 1e-3, dtype=torch.float64)
    values = curve(t)
    assert float(values.max()) == pytest.approx(height, rel=0.005)
    assert float(t[values.argmax()]) == pytest.approx(at, abs=0.0101)


def test_feng_follows_the_printed_formula_after_its_onset():
    rates = (-4.1339, -0.1191, -0.0104)
    curve = feng(150.0, 21.8798, 20.8113, rates, onset=0.7)
    for t in (0.1, 1.0, 10.0, 80.0):
        assert float(curve(_times(t + 0.7))[0]) == pytest.approx(
            _feng_by_hand(t, 150.0, 21.8798, 20.8113, rates), rel=1e-12
        )
    assert curve(_times(0.0, 0.3, 0.7)).abs().max() < 1e-10


def test_plasma_starts_at_zero_and_stays_positive():
    t = torch.linspace(1e-4, 200, 20001, dtype=torch.float64)
    for A1 in (100.0, 200.0):
        assert abs(float(paper_plasma(A1)(_times(0.0))[0])) < 1e-12
        assert float(paper_plasma(A1)(t).min()) > 0


@pytest.mark.parametrize("until", [0.5, 5.0, 90.0])
def test_area_agrees_with_quadrature(until):
    curve = feng_plasma(onset=0.735)
    numbers = (851.1225, 21.8798, 20.8113, (-4.133859, -0.1190996, -0.01043449))
    area = quad(lambda t: _feng_by_hand(t, *numbers), 0, max(until - 0.735, 0), limit=200, epsabs=1e-12)[0]
    assert float(curve.integral(_times(until))[0]) == pytest.approx(area, rel=1e-9, abs=1e-12)


def test_a_tensor_of_rises_makes_a_batch_of_curves():
    rises = torch.tensor([[100.0, 150.0, 200.0]], dtype=torch.float64)
    t = _times(0.2, 1.0, 30.0)
    batch = paper_plasma(rises)(t)
    assert batch.shape == (1, 3, 3)
    for j, A1 in enumerate((100.0, 150.0, 200.0)):
        torch.testing.assert_close(batch[0, j], paper_plasma(A1)(t), rtol=1e-13, atol=0)


def test_factor_scales_the_whole_curve():
    t = _times(0.3, 3.0, 30.0)
    torch.testing.assert_close(feng_plasma(factor=37.0)(t), 37.0 * feng_plasma()(t), rtol=1e-13, atol=0)


def test_rates_with_the_printed_sign_are_refused():
    with pytest.raises(InputError, match="must be negative"):
        feng(100.0, 21.88, 20.81, (4.1339, -0.1191, -0.0104))


def test_exponentials_start_at_their_onset():
    curve = exponentials([3.0, 2.0], [-0.5, 0.0], onset=1.0)
    assert float(curve(_times(0.9))[0]) == 0.0
    assert float(curve(_times(3.0))[0]) == pytest.approx(3 * np.exp(-1.0) + 2, rel=1e-12)


def test_linear_rise_then_exponentials():
    curve = linear_rise([60.0, 20.0, 5.0], [-3.0, -0.3, -0.01], onset=0.4, peak=0.8, end=90.0)
    assert float(curve(_times(0.6))[0]) == pytest.approx(42.5, rel=1e-12)
    t = np.geomspace(0.81, 89.0, 300)
    true = sum(A * np.exp(r * (t - 0.8)) for A, r in ((60, -3), (20, -0.3), (5, -0.01)))
    np.testing.assert_allclose(curve(torch.as_tensor(t)).numpy(), true, rtol=2e-4)
    assert curve.knots.size < 400
    with pytest.raises(InputError, match="onset < peak < end"):
        linear_rise([1.0], [-1.0], onset=1.0, peak=0.5, end=2.0)


def test_input_from_a_formula_says_what_its_whole_blood_is():
    plasma, blood = paper_plasma(), paper_plasma(120.0)
    assert analytic_input(plasma, whole_blood=blood).whole_blood is blood
    alone = analytic_input(plasma)
    assert alone.whole_blood is plasma
    assert "Whole blood" in alone.remarks[0]
    assert alone.area(40.0) == pytest.approx(861.5, abs=4)
