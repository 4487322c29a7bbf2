"""Derivatives of every compartment model: autograd against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction
from petkin.kinetics import CompartmentModel

from .compartment_cases import ARTERIAL, BLOOD, BOLUS, C11, EVERY_MODEL, SCHEDULE, Array, draw, frames, nearly_equal


@EVERY_MODEL
class TestGradients:
    """The curve is smooth in every parameter, equal rates or not; so must its derivative be."""

    @pytest.mark.parametrize("mid_frame", [False, True])
    def test_match_finite_differences(self, model, mid_frame):
        observation = FrameObservation(SCHEDULE, C11, mid_frame=mid_frame)
        rows = draw(model, 6, seed=11, slowest=0.01, fastest=1.0)
        for arterial in (ARTERIAL, InputFunction(BOLUS, BLOOD)):
            expected = differences(model, rows, arterial, observation)
            np.testing.assert_allclose(jacobian(model, rows, arterial, observation), expected, rtol=1e-6, atol=1e-8)

    def test_match_finite_differences_where_rates_meet(self, model):
        observation = FrameObservation(SCHEDULE, C11)
        rows = nearly_equal(model)
        found = jacobian(model, rows, ARTERIAL, observation)
        assert np.isfinite(found).all()
        np.testing.assert_allclose(found, differences(model, rows, ARTERIAL, observation), rtol=1e-6, atol=1e-6)


def jacobian(model: CompartmentModel, rows: Array, arterial: InputFunction, observation: FrameObservation) -> Array:
    """d frame value / d parameter by autograd, (N, K, P)."""
    p = torch.tensor(rows, requires_grad=True)
    values = model.frame_values(p, arterial, observation).sum(dim=0)
    return torch.stack([torch.autograd.grad(v, p, retain_graph=True)[0] for v in values], dim=1).numpy()


def differences(model: CompartmentModel, rows: Array, arterial: InputFunction, observation: FrameObservation) -> Array:
    """The same by six-point central differences with a step of 1 percent, far from rounding."""
    h = 0.01 * rows[:, None, :] * np.eye(rows.shape[1])  # (N, P, P)
    moved = rows[None, :, None, :] + np.array([-3, -2, -1, 1, 2, 3])[:, None, None, None] * h
    at = frames(model, moved, arterial, observation)  # (6, N, P, K)
    change = np.tensordot(np.array([-1, 9, -45, 45, -9, 1]) / 60.0, at, axes=1)
    return np.swapaxes(change / (0.01 * rows[:, :, None]), 1, 2)
