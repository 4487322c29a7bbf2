"""The report says what frame averages change."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import torch

from petkin.fitting import Choices, Given
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs import analytic_input, feng_plasma
from petkin.io import RegionalCurves
from petkin.kinetics import compartment_model
from petkin.methods import find_method
from petkin.study.mid_frame import mid_frame_shift


def test_mid_frame_values_move_the_estimates_and_the_sentence_says_by_how_much() -> None:
    edges = np.cumsum([0.0, *[0.5] * 6, *[1.0] * 5, *[5.0] * 10])
    frames = FrameSchedule(edges[:-1], edges[1:])
    arterial, model = analytic_input(feng_plasma()), compartment_model("1TCM")
    truth = torch.tensor([[0.1, 0.08, 0.05], [0.3, 0.1, 0.04]], dtype=torch.float64)
    values = model.frame_values(truth, arterial, FrameObservation(frames)).numpy()
    curves = RegionalCurves(("a", "b"), values, frames)
    method, weights = find_method("1TCM"), np.ones(len(frames))
    given = Given(FrameObservation(frames), weights, arterial)
    averaged = method.fit(values, given, Choices(), False)
    sentence = mid_frame_shift(averaged, method, curves, given, Choices())
    moved = {s: float(v) for s, v in re.findall(r"(\w+) ([+-][\d.e-]+) %", sentence)}
    assert set(moved) == {"K1", "k2", "vB", "VT"}
    read = method.fit(values, replace(given, observation=FrameObservation(frames, mid_frame=True)), Choices(), False)
    expected = 100.0 * np.median(read["K1"] / truth[:, 0].numpy() - 1.0)
    assert abs(expected) > 0.05
    np.testing.assert_allclose(moved["K1"], expected, rtol=0.1)


def test_values_need_no_scrutiny() -> None:
    """What regions are asked besides adds columns and moves no estimate."""
    edges = np.cumsum([0.0, *[0.5] * 6, *[1.0] * 5, *[5.0] * 10])
    frames = FrameSchedule(edges[:-1], edges[1:])
    arterial, model = analytic_input(feng_plasma()), compartment_model("2TCM")
    truth = torch.tensor([[0.1, 0.1, 0.05, 0.03, 0.05], [0.3, 0.2, 0.02, 0.05, 0.04]], dtype=torch.float64)
    values = model.frame_values(truth, arterial, FrameObservation(frames)).numpy()
    values = values * (1.0 + 0.02 * np.random.default_rng(0).standard_normal(values.shape))
    given = Given(FrameObservation(frames), np.ones(len(frames)), arterial)
    full, bare = (find_method("2TCM").fit(values, given, Choices(scrutiny=s), False) for s in (True, False))
    assert len(bare.columns) < len(full.columns)
    for one, other in zip(full.estimates, bare.estimates, strict=True):
        np.testing.assert_array_equal(one.value, other.value)
