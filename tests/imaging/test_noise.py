"""Counting noise: its law, its share that frames have in common, its correlation in space."""

import math

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.imaging import CountingNoise, FrameObservation, FrameSchedule, blur, frame_schedule, reference_frame

FRAMES = frame_schedule("12x10,6x20,6x30,3x60,5x120,14x300", length=0)
LAMBDA = math.log(2) / 20.364


def test_reference_frame_holds_the_stated_percent() -> None:
    observation = FrameObservation(FRAMES, LAMBDA)
    sd = CountingNoise(5.0, reference=20.0).standard_deviation(np.full(len(FRAMES), 20.0), observation)
    k = reference_frame(observation)
    assert FRAMES.start[k] <= 45.0 <= FRAMES.end[k]
    assert sd[k] == pytest.approx(1.0, rel=1e-12)


def test_variance_law_by_hand() -> None:
    """var ~ C e^{lambda t} / d for short frames, and C / d where values are not decay-corrected."""
    frames = FrameSchedule(np.array([0.0, 10.0, 20.0]), np.array([0.01, 10.02, 20.01]))
    values = np.array([10.0, 40.0, 5.0])
    corrected = CountingNoise(1.0, 1.0).standard_deviation(values, FrameObservation(frames, LAMBDA))
    expected = np.sqrt(values * np.exp(LAMBDA * frames.mid) / frames.duration)
    np.testing.assert_allclose(corrected / corrected[0], expected / expected[0], rtol=1e-6)
    plain = CountingNoise(1.0, 1.0).standard_deviation(values, FrameObservation(frames, LAMBDA, corrected=False))
    np.testing.assert_allclose(
        plain / plain[0], np.sqrt(values / frames.duration) / np.sqrt(values[0] / 0.01), rtol=1e-9
    )


def test_a_long_frame_counts_its_decayed_exposure() -> None:
    """1 / var of a constant curve goes with int e^{-lambda t} dt over the frame."""
    frames = FrameSchedule(np.array([0.0, 30.0, 31.0]), np.array([30.0, 31.0, 60.0]))
    sd = CountingNoise(1.0, 1.0).standard_deviation(np.ones(3), FrameObservation(frames, LAMBDA))
    exposure = np.exp(-LAMBDA * frames.start) - np.exp(-LAMBDA * frames.end)
    np.testing.assert_allclose(sd**2 * exposure, sd[0] ** 2 * exposure[0], rtol=1e-12)


def test_empty_voxels_are_noisy_at_the_floor() -> None:
    observation = FrameObservation(FrameSchedule.uniform(3, 1.0))
    sd = CountingNoise(10.0, 8.0, floor_share=0.25).standard_deviation(np.array([0.0, 2.0, 8.0]), observation)
    np.testing.assert_allclose(sd, [0.4, 0.4, 0.8], rtol=1e-12)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_sampled_variance_and_common_share(share: float) -> None:
    observation = FrameObservation(FrameSchedule.uniform(4000, 0.5))
    noise = CountingNoise(5.0, 10.0, common_share=share)
    truth = np.full((6, 4000), 10.0)
    residual = noise.sample(truth, observation, np.random.default_rng(3)) - truth
    assert residual.std() == pytest.approx(0.5, rel=0.03)
    pairs = np.corrcoef(residual)[np.triu_indices(6, 1)]
    assert pairs.mean() == pytest.approx(share, abs=0.02)


def test_frames_are_independent_of_each_other() -> None:
    observation = FrameObservation(FrameSchedule.uniform(40, 0.5))
    noise = CountingNoise(5.0, 10.0, common_share=0.5)
    truth = np.full((2000, 40), 10.0)
    residual = noise.sample(truth, observation, np.random.default_rng(5)) - truth
    neighbours = np.corrcoef(residual.mean(0)[1:], residual.mean(0)[:-1])[0, 1]
    assert abs(neighbours) < 0.5


def test_correlated_noise_keeps_its_variance_and_takes_the_width() -> None:
    noise = CountingNoise(1.0, correlation=6.0)
    part = noise.voxel_part(np.random.default_rng(2), (48, 40, 32), (2.0, 2.0, 2.0))
    assert part.std() == pytest.approx(1.0, rel=0.03)
    assert part[0].std() == pytest.approx(1.0, rel=0.15)
    neighbour = np.corrcoef(part[1:].ravel(), part[:-1].ravel())[0, 1]
    sigma = 6.0 / math.sqrt(8 * math.log(2)) / 2.0
    assert neighbour == pytest.approx(math.exp(-1 / (4 * sigma**2)), abs=0.03)
    assert blur(part, 6.0, (2.0,) * 3).std() > 0.5 * part.std()


def test_no_noise_is_the_truth_itself_and_seeds_repeat() -> None:
    observation = FrameObservation(FrameSchedule.uniform(5, 1.0))
    truth = np.ones((2, 5))
    assert CountingNoise(0.0).sample(truth, observation, np.random.default_rng(0)) is truth
    first, second = (CountingNoise(5.0).sample(truth, observation, np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    "bad", [{"percent": -1.0}, {"percent": math.nan}, {"percent": 1.0, "common_share": 1.5},
            {"percent": 1.0, "correlation": -2.0}, {"percent": 1.0, "reference": 0.0}],
)  # fmt: skip
def test_impossible_noise_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(InputError):
        CountingNoise(**bad)
