"""Covariances of one exponential's numbers, and the two-rate reference model's derivatives, against differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from petkin.fitting.one_rate_errors import ENTRIES, one_rate_covariances
from petkin.fitting.sensitivity import read_basis
from petkin.fitting.table import RATE_OFFSET, build_table, compress
from petkin.fitting.two_rate_reference import curve_jacobian, curve_values
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs import InputFunction, feng_plasma

FRAMES = FrameSchedule.uniform(30, 2.0)
WEIGHTS = np.linspace(2.0, 0.5, 30)


@pytest.fixture(scope="module")
def packed():
    plasma = feng_plasma()
    table = build_table(
        InputFunction(plasma, plasma), FrameObservation(FRAMES, 0.03), rate_bounds=(1e-3, 5.0), nodes=160
    )
    return compress(table, WEIGHTS, tolerance=1e-12)


def curve(packed, x0, x1, a):
    values = x1[:, None] * read_basis(packed, a)[0]
    values[:, 0] += x0 * packed.blood
    return values


@pytest.mark.parametrize("axis", [True, False])
def test_covariances_are_the_inverse_of_the_normal_matrix(packed, axis):
    rng = np.random.default_rng(0)
    x0, x1, a = rng.uniform(0.5, 1.5, 20), rng.uniform(-0.2, 0.2, 20), rng.uniform(0.01, 1.0, 20)
    step = 1e-5
    columns = [
        (curve(packed, x0 + step, x1, a) - curve(packed, x0 - step, x1, a)) / (2 * step),
        (curve(packed, x0, x1 + step, a) - curve(packed, x0, x1 - step, a)) / (2 * step),
        (curve(packed, x0, x1, a * (1 + step)) - curve(packed, x0, x1, a * (1 - step))) / (2 * step * a)[:, None],
    ]
    jacobian = np.stack(columns[0 if axis else 1 :], axis=2)
    inverse = np.linalg.inv(np.einsum("nrp,nrq->npq", jacobian, jacobian))
    u = np.log(a + RATE_OFFSET)
    found = one_rate_covariances(packed, u, x1, np.zeros(20, bool), axis=axis)
    for (i, j), entry in zip(ENTRIES, found):
        wanted = inverse[:, i, j] if axis else inverse[:, i - 1, j - 1] if i > 0 else np.zeros(20)
        np.testing.assert_allclose(entry, wanted, rtol=1e-5)


def test_a_rate_that_is_held_or_not_felt_has_no_part_in_the_others(packed):
    u = np.log(np.array([0.1, 0.1]) + RATE_OFFSET)
    held, unfelt = one_rate_covariances(packed, u, np.array([0.1, 0.0]), np.array([True, False]), axis=True).T
    assert held[5] == 0.0
    assert unfelt[5] == np.inf
    np.testing.assert_allclose(held[:4], unfelt[:4])


def test_derivatives_of_the_two_rate_model_are_its_differences(packed):
    rng = np.random.default_rng(1)
    theta = np.column_stack([rng.uniform(lo, hi, 10) for lo, hi in ((0.5, 1.5), (0.05, 0.3), (0.02, 0.2), (0.02, 0.2))])
    values, jacobian = curve_jacobian(packed, theta)
    np.testing.assert_allclose(values, curve_values(packed, theta), rtol=1e-12, atol=1e-12)
    for p in range(4):
        step = np.zeros(4)
        step[p] = 1e-6
        numeric = (curve_values(packed, theta + step) - curve_values(packed, theta - step)) / 2e-6
        np.testing.assert_allclose(jacobian[:, :, p], numeric, rtol=1e-4, atol=1e-5 * np.abs(numeric).max())


def test_the_table_of_a_reference_curve_is_exact(packed):
    rate = torch.tensor([0.07], dtype=torch.float64)
    exact = FrameObservation(FRAMES, 0.03).of_response(feng_plasma(), rate)[0].numpy()
    np.testing.assert_allclose(read_basis(packed, rate.numpy())[0][0], packed.project @ exact, rtol=1e-6, atol=1e-5)
