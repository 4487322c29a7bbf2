"""Errors of what drives the channels: part of the noise where they are known to be there, a gap where they are not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from petkin.diagnosis import Diagnosis, Term, detect, diagnose
from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.detect import noise_draws

from .decaying_channels import HYPOTHESES, TRUTH, DecayingChannels, hypothesis

Array = NDArray[np.float64]
TRIALS, SD, SIZE = 30, 0.05, 0.04


@dataclass(frozen=True)
class Shaken(DecayingChannels):
    """All channels swing with what drives them, by errors of which two are known."""

    def unsure(self, own: Array, shared: Array) -> Array:
        return SIZE * swings(self.times)[:, None] * self.predict(own, shared)


def swings(t: Array) -> Array:
    return np.exp(-0.5 * ((t - np.array([[3.0], [6.0]])) / 0.7) ** 2)


def shaken(rng: np.random.Generator, *terms: Term) -> Array:
    """Data whose drive erred by twice the noise and more."""
    simulator = Shaken()
    clean = simulator.predict(TRUTH, np.zeros(0), terms)
    errors = SIZE * np.sqrt(2.0) * rng.choice([-1.0, 1.0], 2) @ swings(simulator.times)
    return clean * (1.0 + errors) + SD * rng.standard_normal(clean.shape)


@dataclass(frozen=True)
class Unsure(DecayingChannels):
    """How the noise goes with time is known within a standard deviation, or taken for known."""

    error: float = 0.5

    def uneven(self, values: Array) -> Array:
        tilt = self.error * np.linspace(-1.0, 1.0, len(self.times))
        return np.broadcast_to(tilt, (1, *values.shape)) if self.error else np.zeros((0, *values.shape))


def judged(simulator: DecayingChannels, seed: int, *terms: Term) -> Diagnosis:
    return diagnose(simulator, shaken(np.random.default_rng(seed), *terms), HYPOTHESES, seed=seed, draws=200)


def noise(rng: np.random.Generator) -> Noise:
    spread = rng.uniform(0.5, 2.0, (3, 20))
    return Noise(spread, np.array([0.1, 0.2, 0.15]), 0.4, errors=rng.standard_normal((4, 3, 20)))


def test_whitening_makes_noise_and_errors_white_together() -> None:
    given = noise(np.random.default_rng(0))
    scale = given.size[:, None] * given.spread
    alone = np.einsum("ck,dl,kl,cd->ckdl", scale, scale, np.eye(20), 0.6 * np.eye(3) + 0.4)
    covariance = (alone + np.einsum("mck,mdl->ckdl", given.errors, given.errors)).reshape(60, 60)
    matrix = given.whiten(np.eye(60).reshape(60, 3, 20)).T
    np.testing.assert_allclose(matrix @ covariance @ matrix.T, np.eye(60), atol=1e-9)


def test_colouring_undoes_it() -> None:
    rng = np.random.default_rng(1)
    given, values = noise(rng), rng.standard_normal((2, 3, 20))
    np.testing.assert_allclose(given.coloured(given.whiten(values)), values, atol=1e-10)


def test_errors_are_taken_out_as_the_mean_of_normals_given_their_sum() -> None:
    rng = np.random.default_rng(2)
    given, values = noise(rng), rng.standard_normal((3, 20))
    columns = given.errors.reshape(4, -1).T
    beside = Noise(given.spread, given.size, given.share)
    root = beside.whiten(np.eye(60).reshape(60, 3, 20)).T
    precision = root.T @ root
    mean = np.linalg.solve(np.eye(4) + columns.T @ precision @ columns, columns.T @ precision @ values.ravel())
    expected = values - (columns @ mean).reshape(3, 20)
    np.testing.assert_allclose(given.without_errors(values), expected, atol=1e-9)


def test_without_errors_nothing_changes() -> None:
    given, values = Noise(np.ones((3, 20)), np.ones(3), 0.2), np.random.default_rng(3).standard_normal((3, 20))
    assert given.without_errors(values) is values
    assert not given.erring(np.random.default_rng(0), 5).any()


def test_draws_hold_errors_as_large_as_they_may_be() -> None:
    given = noise(np.random.default_rng(4))
    drawn = noise_draws(np.random.default_rng(5), 4000, given, {np.inf: 1.0}, [np.zeros((20, 0))] * 3, np.ones((3, 1)))
    along = drawn @ given._errors[0]
    np.testing.assert_allclose(along.std(axis=0), 1.0, atol=0.1)


def test_known_errors_are_no_gap_and_unknown_ones_are() -> None:
    """Where they are known two of 30 at most are taken for a gap; where not, most."""

    def claimed(simulator: DecayingChannels, seed: int) -> bool:
        return detect(simulator, shaken(np.random.default_rng(seed)), HYPOTHESES, seed=seed, draws=200).present

    known = [claimed(Shaken(), seed) for seed in range(TRIALS)]
    blind = [claimed(DecayingChannels(), seed) for seed in range(TRIALS)]
    assert sum(known) <= 2
    assert sum(blind) >= 0.8 * TRIALS


def test_draws_are_as_uneven_as_the_law_may_be() -> None:
    given = Noise(np.ones((2, 9)), np.ones(2), 0.0, uneven=np.tile(np.linspace(-1.0, 1.0, 9), (1, 2, 1)) / 2.0)
    logs = np.log(given.sizes(np.random.default_rng(6), 4000))
    np.testing.assert_allclose(logs.std(axis=0), np.abs(given.uneven[0]), atol=0.02)
    assert given.sizes(np.random.default_rng(6), 7).shape == (7, 2, 9)
    assert Noise(np.ones((2, 9)), np.ones(2), 0.0).sizes(np.random.default_rng(6), 7) == 1.0


def test_noise_of_a_law_that_is_not_known_for_sure_is_no_gap() -> None:
    """Its tilts are as likely as the simulator takes them for; taken for known, they make gaps."""
    clean = DecayingChannels().predict(TRUTH, np.zeros(0))

    def present(simulator: DecayingChannels, seed: int) -> bool:
        rng = np.random.default_rng(seed)
        tilt = np.exp(rng.standard_normal() * np.linspace(-1.0, 1.0, 50))
        data = clean + SD * tilt * rng.standard_normal(clean.shape)
        return detect(simulator, data, HYPOTHESES, seed=seed, draws=200).present

    known, blind = (sum(present(Unsure(error=e), seed) for seed in range(2 * TRIALS)) for e in (1.0, 0.0))
    assert known <= 5
    assert blind >= 3 * max(known, 2)


def test_what_is_known_before_is_not_looked_for_again() -> None:
    data = shaken(np.random.default_rng(3))
    detected = detect(Shaken(), data, HYPOTHESES, seed=3, draws=200)
    given = diagnose(Shaken(), data, HYPOTHESES, seed=3, draws=200, detected=detected)
    assert given.p_value == detected.p_value
    assert given.causes == judged(Shaken(), 3).causes


@pytest.mark.parametrize("name", ["step", "offset"])
def test_what_errors_cannot_do_is_still_named(name: str) -> None:
    present = {"step": Term(hypothesis("step"), 0.15, {"onset": 4.0}), "offset": Term(hypothesis("offset"), 0.25, {})}
    answer = judged(Shaken(), 1, present[name])
    assert answer.chosen[:1] == (name,)
