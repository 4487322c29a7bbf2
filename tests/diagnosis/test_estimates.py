"""Intervals of what is fitted beside an amplitude, and what is said of whom: an onset in its own unit, parts no surer
than the whole."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from petkin.diagnosis import Diagnosis, Term, diagnose
from petkin.diagnosis.where import PART

from .decaying_channels import AVERAGED, HYPOTHESES, DecayingChannels, hypothesis, measured

SIMULATOR = DecayingChannels()
STEP = replace(AVERAGED, settings=hypothesis("step").settings)
ONSETS = np.random.default_rng(5).uniform(2.0, 8.0, 30)


@cache
def stepped(seed: int) -> Diagnosis:
    data = measured(np.random.default_rng(seed), Term(STEP, 0.12, {"onset": float(ONSETS[seed])}))
    return diagnose(SIMULATOR, data, (STEP,), draws=100, seed=seed)


def test_intervals_of_onsets_hold_them() -> None:
    """0.9 of the time, where samples average over it; and are no wider than they must be."""
    found = [{e.symbol: e for e in stepped(seed).causes[0].estimates}["onset"] for seed in range(len(ONSETS))]
    held = [e.low <= onset <= e.high for e, onset in zip(found, ONSETS, strict=True)]
    assert np.mean(held) >= 0.77
    errors = [abs(e.value - onset) for e, onset in zip(found, ONSETS, strict=True)]
    assert np.quantile([e.high - e.low for e in found], 0.9) < 3.0 * np.quantile(errors, 0.9)


def test_an_onset_lies_within_its_bounds() -> None:
    shape = next(s for s in AVERAGED.shapes if s.symbol == "onset")
    for seed in range(len(ONSETS)):
        onset = {e.symbol: e for e in stepped(seed).causes[0].estimates}["onset"]
        assert shape.lower <= onset.low <= onset.value <= onset.high <= shape.upper


def test_of_a_pair_every_estimate_says_whose_it_is() -> None:
    step = Term(hypothesis("local step"), np.array([0.0, 0.0, 0.6, 0.0]), {"onset": 5.0})
    both = Term(hypothesis("offset"), 0.4, {}), step
    found = diagnose(SIMULATOR, measured(np.random.default_rng(2), *both), HYPOTHESES, draws=100)
    leader = next(c for c in found.causes if c.effects == ("local step", "offset"))
    sizes = {e.effect: e for e in leader.estimates if e.symbol == "amplitude"}
    assert list(sizes) == ["local step", "offset"]
    assert (sizes["local step"].channel, sizes["offset"].channel) == ("c", "")
    assert sizes["offset"].low < 0.4 < sizes["offset"].high


def test_no_part_is_claimed_where_the_whole_is_not() -> None:
    """Of noise alone one channel in twenty would be."""
    claimed = 0
    for seed in range(40):
        found = diagnose(SIMULATOR, measured(np.random.default_rng(seed)), HYPOTHESES, draws=200, seed=seed)
        parts = np.concatenate([found.claims(found.regions), found.claims(found.frames)])
        raw = np.concatenate([found.regions.q_values, found.frames.q_values])
        assert found.present or (parts > PART).all()
        claimed += int((raw <= PART).any())
        if found.present:
            np.testing.assert_array_equal(parts <= PART, raw <= PART)
    assert claimed > 0
