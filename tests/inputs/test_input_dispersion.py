"""Dispersion: exact forth, back again, and refusals."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from petkin.dynamics import PiecewiseLinear, Shifted
from petkin.errors import InputError
from petkin.inputs import dispersed, exponentials, feng_plasma, undispersed

TAU = 2.6 / 60


def test_dispersed_exponential_matches_its_closed_form():
    rate, A = 0.8, 12.0
    curve = dispersed(exponentials([A], [-rate]), TAU, end=10.0, tolerance=1e-5)
    t = np.linspace(0.01, 9.9, 400)
    closed = A * (np.exp(-rate * t) - np.exp(-t / TAU)) / (1 - rate * TAU)
    np.testing.assert_allclose(curve(torch.as_tensor(t)).numpy(), closed, rtol=5e-5)


def test_dispersion_keeps_the_area_and_delays_by_tau():
    blood = feng_plasma()
    smeared = dispersed(blood, TAU, end=60.0, tolerance=1e-6)
    until = torch.tensor([60.0], dtype=torch.float64)
    last = float(blood(until)[0])
    # what is still in the line at the end is tau times the concentration there, to first order
    assert float(blood.integral(until) - smeared.integral(until)) == pytest.approx(TAU * last, rel=0.02)


def test_a_step_rises_to_63_percent_within_tau():
    step = PiecewiseLinear(torch.tensor([1.0, 5.0], dtype=torch.float64), torch.tensor([1.0, 1.0], dtype=torch.float64))
    smeared = dispersed(step, 0.1, end=5.0)
    assert float(smeared(torch.tensor([1.1], dtype=torch.float64))[0]) == pytest.approx(1 - np.exp(-1), rel=1e-3)
    assert float(smeared(torch.tensor([0.9], dtype=torch.float64))[0]) == 0.0


def test_a_late_bolus_is_not_overlooked():
    smeared = dispersed(Shifted(feng_plasma(), 30.0), TAU, end=60.0)
    t = torch.linspace(29, 35, 2000, dtype=torch.float64)
    # the peak value of the dispersed curve from a finely stepped first-order filter
    fine = np.arange(0, 6, 1e-4)
    source = feng_plasma()(torch.as_tensor(fine)).numpy()
    y = np.zeros_like(fine)
    keep = np.exp(-1e-4 / TAU)
    for i in range(1, fine.size):
        y[i] = keep * y[i - 1] + (1 - keep) * (source[i] + source[i - 1]) / 2
    assert float(smeared(t).max()) == pytest.approx(y.max(), rel=1e-3)


@pytest.mark.parametrize("uneven", [False, True])
def test_round_trip_recovers_the_curve(uneven):
    blood = feng_plasma(onset=0.5)
    t = np.arange(0, 10, 1 / 60)
    if uneven:
        t = np.sort(np.concatenate([t[::2], t[1::6] + 0.2 / 60]))
    measured = dispersed(blood, TAU, end=11.0, tolerance=1e-6)(torch.as_tensor(t)).numpy()
    corrected = undispersed(t, measured, TAU)
    true = blood(torch.as_tensor(t)).numpy()
    before, after = np.abs(measured - true).max(), np.abs(corrected - true)[t > 0.6].max()
    assert after < 0.25 * before
    true_area = np.trapezoid(true, t)
    assert np.trapezoid(corrected, t) == pytest.approx(true_area, rel=4e-3)
    assert corrected[t > 2] == pytest.approx(true[t > 2], rel=2e-3)


def test_noise_grows_as_stated_and_leaves_the_area_alone():
    rng = np.random.default_rng(3)
    t = np.arange(0, 10, 1 / 60)
    noise = rng.standard_normal(t.size)
    corrected = undispersed(t, noise, TAU)
    assert corrected[5:-5].std() / noise[5:-5].std() == pytest.approx(np.sqrt(1 + 2.6**2 / 2), rel=0.1)
    gained = np.trapezoid(corrected, t) - np.trapezoid(noise, t)
    assert abs(gained) <= TAU * 2 * np.abs(noise).max()


def test_a_window_tames_the_noise_and_is_exact_for_a_parabola():
    t = np.sort(np.random.default_rng(1).uniform(0, 5, 200))
    parabola = 3 - 2 * t + 0.7 * t**2
    exact = parabola + TAU * (-2 + 1.4 * t)
    np.testing.assert_allclose(undispersed(t, parabola, TAU), exact, atol=1e-9)
    np.testing.assert_allclose(undispersed(t, parabola, TAU, half_window=0.3), exact, atol=1e-9)
    even, noise = np.arange(0, 10, 1 / 60), np.random.default_rng(2).standard_normal(600)
    assert undispersed(even, noise, TAU, half_window=5 / 60).std() < 0.6 * undispersed(even, noise, TAU).std()


@pytest.mark.parametrize("tau", [0.0, -0.1, 2.6])
def test_a_dispersion_out_of_range_is_refused(tau):
    with pytest.raises(InputError, match=r"2\.6 s as 2\.6 / 60"):
        undispersed(np.arange(5.0), np.ones(5), tau)
    with pytest.raises(InputError, match="out of range"):
        dispersed(feng_plasma(), tau, end=10.0)


def test_other_misuse_is_refused():
    with pytest.raises(InputError, match="at least three samples"):
        undispersed(np.arange(2.0), np.ones(2), TAU)
    with pytest.raises(InputError, match="cannot be negative"):
        undispersed(np.arange(5.0), np.ones(5), TAU, half_window=-1.0)
    with pytest.raises(InputError, match="starts at 3 min"):
        dispersed(feng_plasma(onset=3.0), TAU, end=2.0)
