"""Symmetries that every compartment model must have, for random parameters."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from petkin.dynamics import PiecewiseLinear, Shifted
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs.input_function import InputFunction
from petkin.kinetics import MODELS

from .compartment_cases import ARTERIAL, BOLUS, C11, KNOTS, SAMPLES, SCHEDULE, TIMES, VALUES, draw, frames, tissue

model_indices = st.integers(0, len(MODELS) - 1)
seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=12, deadline=None)


@few
@given(model_indices, seeds, st.floats(0.05, 30.0))
def test_linear_in_plasma_and_blood(index, seed, scale):
    model = MODELS[index]
    p = draw(model, 2, seed)
    other = np.random.default_rng(seed).uniform(0.0, 50.0, len(KNOTS))
    both = PiecewiseLinear(torch.tensor(KNOTS), torch.tensor(VALUES + scale * other))
    alone = PiecewiseLinear(torch.tensor(KNOTS), torch.tensor(other))
    observation = FrameObservation(SCHEDULE, C11)
    summed = frames(model, p, InputFunction(SAMPLES, SAMPLES), observation)
    summed = summed + scale * frames(model, p, InputFunction(alone, alone), observation)
    np.testing.assert_allclose(frames(model, p, InputFunction(both, both), observation), summed, rtol=1e-10, atol=1e-9)


@few
@given(model_indices, seeds, st.floats(-5.0, 20.0))
def test_a_later_input_gives_the_same_curve_later(index, seed, shift):
    model = MODELS[index]
    p = draw(model, 2, seed)
    for forcing in (SAMPLES, BOLUS):
        np.testing.assert_allclose(
            tissue(model, p, Shifted(forcing, shift), TIMES + shift),
            tissue(model, p, forcing),
            rtol=1e-9,
            atol=1e-9,
        )
    moved = FrameSchedule(SCHEDULE.start + shift, SCHEDULE.end + shift)
    np.testing.assert_allclose(
        frames(model, p, ARTERIAL.delayed(shift), FrameObservation(moved, C11)),
        frames(model, p, ARTERIAL, FrameObservation(SCHEDULE, C11)),
        rtol=1e-8,
        atol=1e-8,
    )


@few
@given(model_indices, seeds, st.floats(0.05, 0.95), st.sampled_from([0.0, C11]))
def test_a_frame_is_the_decay_weighted_mean_of_its_parts(index, seed, cut, decay):
    model = MODELS[index]
    p = draw(model, 2, seed)
    middle = SCHEDULE.start + cut * SCHEDULE.duration
    parts = FrameSchedule(np.stack([SCHEDULE.start, middle], 1).ravel(), np.stack([middle, SCHEDULE.end], 1).ravel())
    observation = FrameObservation(parts, decay)
    share = observation.mean_decay_times_duration.reshape(-1, 2)
    values = frames(model, p, ARTERIAL, observation).reshape(2, -1, 2)
    whole = (values * share).sum(axis=-1) / share.sum(axis=-1)
    np.testing.assert_allclose(
        frames(model, p, ARTERIAL, FrameObservation(SCHEDULE, decay)), whole, rtol=1e-9, atol=1e-10
    )


@few
@given(model_indices, seeds, st.floats(0.01, 100.0))
def test_another_unit_of_time_changes_nothing(index, seed, unit):
    model = MODELS[index]
    p = draw(model, 2, seed)
    faster = p.copy()
    faster[:, :-1] /= unit  # K1 and all rates are per time
    stretched = PiecewiseLinear(torch.tensor(KNOTS * unit), torch.tensor(VALUES))
    np.testing.assert_allclose(
        tissue(model, faster, stretched, TIMES * unit), tissue(model, p, SAMPLES), rtol=1e-9, atol=1e-10
    )


@few
@given(model_indices, seeds)
def test_curves_are_not_negative_and_hold_no_more_than_was_delivered(index, seed):
    model = MODELS[index]
    p = draw(model, 3, seed, slowest=1e-4, fastest=5.0)
    found = tissue(model, p, SAMPLES)
    assert (found >= 0).all()
    delivered = p[:, :1] * SAMPLES.integral(torch.tensor(TIMES)).numpy()
    assert (found <= delivered * (1 + 1e-12)).all()
