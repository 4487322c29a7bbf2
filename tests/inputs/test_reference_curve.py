"""The smoothest curve through frame values."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs import smoothest

DURATIONS = np.repeat([1 / 6, 0.5, 1.0, 2.0, 5.0, 10.0], [6, 6, 6, 5, 6, 3])
END = np.cumsum(DURATIONS)
FRAMES = FrameSchedule(END - DURATIONS, END)
LAMBDA = np.log(2) / 20.364
OBSERVATIONS = {
    "decay-weighted": FrameObservation(FRAMES, LAMBDA),
    "time average": FrameObservation(FRAMES, 0.0),
    "mid-frame": FrameObservation(FRAMES, mid_frame=True),
}


def tissue(t):
    """A one-tissue answer to an input of two exponentials that arrives at 0.5 min."""
    s = np.maximum(np.asarray(t) - 0.5, 0.0)
    terms = ((60.0, 1.5), (12.0, 0.015))
    return sum(0.1 * A * (np.exp(-b * s) - np.exp(-0.12 * s)) / (0.12 - b) for A, b in terms)


def averages(observation):
    """Frame values of `tissue` by sums over a fine grid."""
    frames, values = observation.frames, []
    for start, end in zip(frames.start, frames.end):
        t = start + (np.arange(4000) + 0.5) / 4000 * (end - start)
        weight = np.exp(-observation.decay * t)
        values.append((tissue(t) * weight).sum() / weight.sum())
    return np.array(values) if not observation.mid_frame else tissue(frames.mid)


def interpolant(observation):
    return smoothest(np.append(observation.frames.start, observation.frames.end), observation.of_forcing)


@pytest.mark.parametrize("observation", OBSERVATIONS.values(), ids=OBSERVATIONS)
@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_the_curve_reports_exactly_the_frame_values_noise_included(observation, seed):
    values = np.random.default_rng(seed).normal(10.0, 5.0, len(FRAMES))
    curve = interpolant(observation).through(values)
    np.testing.assert_allclose(observation.of_forcing(curve), values, atol=1e-10)


@pytest.mark.parametrize("observation", OBSERVATIONS.values(), ids=OBSERVATIONS)
def test_the_curve_starts_at_zero_and_follows_the_tissue(observation):
    curve = interpolant(observation).through(averages(observation))
    t = np.linspace(2.0, END[-1], 500)
    assert float(curve(torch.zeros(1, dtype=torch.float64))) == 0.0
    bound = 3e-3 if not observation.mid_frame else 2e-2
    assert np.abs(curve(torch.tensor(t)).numpy() / tissue(t) - 1).max() < bound


def test_what_passes_through_an_exponential_is_known_a_hundred_times_better_than_the_curve_itself():
    observation = OBSERVATIONS["decay-weighted"]
    curve = interpolant(observation).through(averages(observation))
    t, rate = np.linspace(0.0, END[-1], 400_001), 0.05
    grown = np.cumsum((tissue(t) * np.exp(rate * t))[:-1] + (tissue(t) * np.exp(rate * t))[1:]) / 2 * (t[1] - t[0])
    exact = np.interp(FRAMES.end[10:], t[1:], grown * np.exp(-rate * t[1:]))
    read = curve.response(torch.tensor(rate, dtype=torch.float64), torch.tensor(FRAMES.end[10:])).numpy()
    np.testing.assert_allclose(read, exact, rtol=2e-5)


def test_a_gap_between_frames_is_bridged_smoothly():
    kept = np.r_[0:20, 25:32]
    frames = FrameSchedule(FRAMES.start[kept], FRAMES.end[kept])
    observation = FrameObservation(frames, LAMBDA)
    curve = interpolant(observation).through(averages(observation))
    inside = np.linspace(FRAMES.start[20], FRAMES.end[24], 50)
    assert np.abs(curve(torch.tensor(inside)).numpy() / tissue(inside) - 1).max() < 0.03


def test_the_curve_is_linear_in_the_values_and_so_are_the_unit_responses():
    found = interpolant(OBSERVATIONS["decay-weighted"])
    values = averages(OBSERVATIONS["decay-weighted"])
    t = torch.tensor(FRAMES.mid)
    summed = (torch.tensor(values)[:, None] * found.responses(t)).sum(dim=0)
    np.testing.assert_allclose(found.through(values)(t).numpy(), summed.numpy(), rtol=1e-12)


def test_three_hundred_frames_are_met_as_exactly():
    frames = FrameSchedule.uniform(300, 0.2)
    observation = FrameObservation(frames, LAMBDA)
    values = np.random.default_rng(1).normal(1.0, 1.0, 300)
    curve = smoothest(np.append(frames.start, frames.end), observation.of_forcing).through(values)
    np.testing.assert_allclose(observation.of_forcing(curve), values, atol=1e-6)
