"""Which channels an effect is in: one alone, some, or all, each told by what the fit changes there."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from petkin.diagnosis import Diagnosis, Term, diagnose, evidence

from .decaying_channels import HYPOTHESES, DecayingChannels, hypothesis, measured

CLAIMED = 0.05


def found_in(jumps: list[float], seed: int, share: float = 0.0) -> Diagnosis:
    """Jumps of the channels a to d at 4, one noise each."""
    there = Term(hypothesis("local step"), np.array(jumps), {"onset": 4.0})
    return diagnose(DecayingChannels(), measured(np.random.default_rng(seed), there, share=share), HYPOTHESES)


def claimed(found: Diagnosis) -> list[int]:
    assert found.causes[0].effects == ("local step",)
    return np.flatnonzero(found.regions.q_values <= CLAIMED).tolist()


@pytest.mark.parametrize("share", [0.0, 0.6])
def test_one_channel_is_claimed_and_no_other(share: float) -> None:
    right = wrong = 0
    for seed, channel in product(range(5), range(4)):
        jumps = [0.0] * 4
        jumps[channel] = 0.25
        told = claimed(found_in(jumps, seed, share))
        right += channel in told
        wrong += len(set(told) - {channel})
    assert right == 20
    assert wrong <= 1  # 20 claims; 60 other channels


def test_two_channels_of_four_are_claimed() -> None:
    told = [claimed(found_in([0.3, 0.0, -0.25, 0.0], seed)) for seed in range(12)]
    assert sum({0, 2} <= set(each) for each in told) >= 11
    assert sum(len(set(each) - {0, 2}) for each in told) <= 3


def test_all_channels_are_claimed() -> None:
    told = [claimed(found_in([0.3, 0.2, -0.25, 0.3], seed)) for seed in range(6)]
    assert sum(len(each) == 4 for each in told) >= 5


def test_the_chance_of_one_channel_alone_follows_from_the_evidence() -> None:
    rng = np.random.default_rng(3)
    look = rng.standard_normal((9, 4))
    spread = evidence.Spread.of(look.T @ look)
    score = look.T @ rng.normal(scale=3.0, size=9)
    alone = spread.alone(score, True)
    lone = np.exp(evidence.two_sided(score / np.sqrt(spread.diagonal)))
    np.testing.assert_allclose(alone, lone / 4 / (lone.mean() + np.exp(float(spread.together(score)))), rtol=1e-9)
    several = spread.alone(np.stack([score, 2.0 * score]), True)
    np.testing.assert_allclose(several[0], alone, rtol=1e-12)


def test_amplitudes_apart_are_those_of_least_squares_over_their_errors() -> None:
    rng = np.random.default_rng(4)
    look, values = rng.standard_normal((12, 3)), rng.standard_normal(12)
    information = look.T @ look
    amplitude = np.linalg.lstsq(look, values, rcond=None)[0]
    expected = amplitude / np.sqrt(np.diag(np.linalg.inv(information)))
    np.testing.assert_allclose(evidence.Spread.of(information).apart(look.T @ values), expected, rtol=1e-9)
