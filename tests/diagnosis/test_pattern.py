"""A gap with one pattern over the channels and any course in time."""

from __future__ import annotations

import numpy as np
import pytest

from petkin.diagnosis.covariance import Noise, loads
from petkin.diagnosis.effect import Profiles
from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.pattern import _over_directions, apart, log_evidence
from petkin.diagnosis.unknown import PATTERN, Smooth

SAMPLES = 36


def plain(channels: int) -> Noise:
    return Noise(np.ones((channels, SAMPLES)), np.ones(channels), 0.0)


def up_and_down(channels: int, size: float, rng: np.random.Generator) -> np.ndarray:
    """Values (C, K) of length `size`: channels up and down together, on a course that no sample tells of the next."""
    pattern = np.where(np.arange(channels) % 2, -1.0, 1.0) + 0.3 * rng.standard_normal(channels)
    pattern -= pattern.mean()
    values = np.outer(pattern, rng.standard_normal(SAMPLES))
    return size * values / np.linalg.norm(values)


@pytest.mark.parametrize("size", [(0.0, 0.0, 0.0, 0.0), (0.3, 1.0, 2.0, 9.0), (1.0, 6.0, 6.0, 6.5), (0.0, 40.0)])
def test_the_mean_over_directions_is_that_of_draws(size: tuple[float, ...]) -> None:
    drawn = np.random.default_rng(0).standard_normal((400_000, len(size)))
    squares = drawn**2 / (drawn**2).sum(axis=1, keepdims=True)
    expected = float(np.log(np.exp(squares @ np.array(size)).mean()))
    assert float(_over_directions(np.array([size]))[0]) == pytest.approx(expected, abs=0.12)


@pytest.mark.parametrize("channels", [3, 5, 20])
@pytest.mark.parametrize("heavy", [False, True])
def test_noise_shows_none(channels: int, heavy: bool) -> None:
    """Odds beside it are no more than even on average, whatever its tails, and never much more."""
    rng, shape = np.random.default_rng(1), (2000, channels * SAMPLES)
    noise = rng.standard_t(4, shape) / np.sqrt(2.0) if heavy else rng.standard_normal(shape)
    found = log_evidence(apart(noise, plain(channels)))
    assert np.exp(found).mean() < 1.0
    assert found.max() < 4.0


@pytest.mark.parametrize("channels", [5, 20])
def test_a_pattern_is_seen_on_any_course(channels: int) -> None:
    rng = np.random.default_rng(2)
    clear, faint = (
        [
            float(log_evidence(apart((up_and_down(channels, size, rng) + noise).ravel(), plain(channels))))
            for noise in rng.standard_normal((60, channels, SAMPLES))
        ]
        for size in (16.0, 3.0)
    )
    assert np.mean(np.array(clear) > 3.0) > 0.9
    assert np.mean(np.array(faint) > 1.0) < 0.1


@pytest.mark.parametrize("loaded", [False, True])
def test_what_samples_have_in_common_is_no_pattern(loaded: bool) -> None:
    rng = np.random.default_rng(4)
    level = np.exp(rng.standard_normal((5, SAMPLES)))
    noise = Noise(np.ones((5, SAMPLES)), np.ones(5), 0.0, loads(level) if loaded else None)
    values = rng.standard_normal((5, SAMPLES))
    axis = loads(level) if loaded else np.ones((5, 1))
    jumping = values + 2.0 * axis * rng.standard_normal(SAMPLES)
    between = [apart(each.ravel(), noise) for each in (values, jumping)]
    across = [each / np.linalg.norm(each) for each in between]
    assert np.abs((across[0] * axis).sum(axis=0)).max() < 0.2
    assert abs(float(log_evidence(between[1]) - log_evidence(between[0]))) < 1.5


def test_a_gap_of_no_name_may_be_such_a_pattern() -> None:
    rng = np.random.default_rng(5)
    values, times, noise = np.full((5, SAMPLES), 10.0), np.linspace(1.0, 90.0, SAMPLES), plain(5)
    smooth = Smooth.around(
        [Profiles.of_values(values)], times, noise, Projection.of(np.zeros((values.size, 1)), np.ones(1))
    )
    data = (up_and_down(5, 16.0, rng) + rng.standard_normal((5, SAMPLES))).ravel()
    assert smooth.likeliest(data) == PATTERN
    assert float(smooth.evidence(data)) > 3.0
    assert float(smooth.evidence(rng.standard_normal(data.size))) < 2.0
