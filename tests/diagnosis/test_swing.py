"""What all channels swing by together, against noise that they share."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.effect import Profiles
from petkin.diagnosis.evidence import WIDTHS
from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.swing import Swing
from petkin.diagnosis.unknown import Smooth

SAMPLES, TIMES = 36, np.cumsum(np.repeat([0.5, 2.0, 5.0], 12))


def swing(noise: Noise, jacobian: np.ndarray | None = None) -> tuple[Swing, np.ndarray]:
    """Around values that rise and fall, and those values."""
    profile = np.linspace(0.6, 1.4, len(noise.size))[:, None]
    values = 10.0 * profile * np.exp(-0.5 * ((np.arange(SAMPLES) - 14.0) / 14.0) ** 2)
    none = np.zeros((values.size, 1)) if jacobian is None else jacobian
    found = Swing.around([values], TIMES, noise, Projection.of(none, np.full(none.shape[1], 1e-12)))
    assert found is not None
    return found, values


def plain(channels: int, share: float = 0.0) -> Noise:
    return Noise(np.ones((channels, SAMPLES)), np.ones(channels), share)


@pytest.mark.parametrize("channels", [1, 5])
def test_evidence_is_the_mean_over_sizes_of_noise(channels: int) -> None:
    """One rhythm band and width at a time, sizes of noise integrated by quadrature."""
    found, values = swing(plain(channels))
    data = np.random.default_rng(0).standard_normal(values.shape)
    data = 2.0 * np.clip(data, -1.5, 1.5)  # nothing that is cut, but for what a cut takes from all
    common = (data / 0.957).sum(axis=0) / np.sqrt(channels)
    places = np.arange(SAMPLES) / (SAMPLES - 1)
    profile = values.sum(axis=0) / np.sqrt(channels)
    for first in (3, 21, 33):
        columns = np.cos(np.pi * np.arange(first, first + 3)[:, None] * places) * profile
        precision = np.eye(3) * np.trace(columns @ columns.T) / 3.0
        i = (33 - first) // 2
        one = Swing(found.axis, found.root, found.columns[i : i + 1], found.size[i : i + 1])
        logs = []
        for width in WIDTHS:
            covariance = np.eye(SAMPLES) + columns.T @ np.linalg.inv(precision) @ columns * width**2
            logs.append(_over_sizes(common, covariance) - _over_sizes(common, np.eye(SAMPLES)))
        expected = np.logaddexp.reduce(logs) - np.log(len(logs))
        assert float(one.log_evidence(data.ravel())) == pytest.approx(expected, abs=2e-3)


def _over_sizes(values: np.ndarray, covariance: np.ndarray) -> float:
    """ln of the density of values, N(0, s^2 covariance), over ln s, but for what any covariance has."""
    square, count = float(values @ np.linalg.solve(covariance, values)), values.size
    peak = 0.5 * np.log(square / count)
    top = -count * peak - 0.5 * count

    def density(log_size: float) -> float:
        return float(np.exp(-count * log_size - 0.5 * square * np.exp(-2.0 * log_size) - top))

    area = quad(density, peak - 3.0, peak + 3.0, epsabs=0.0, epsrel=1e-10)[0]
    return float(np.log(area) + top - 0.5 * np.linalg.slogdet(covariance)[1])


@pytest.mark.parametrize("share", [0.0, 0.6])
@pytest.mark.parametrize("channels", [1, 5, 20])
@pytest.mark.parametrize("heavy", [False, True])
def test_noise_of_any_size_shows_none(channels: int, share: float, heavy: bool) -> None:
    """Whatever it has in common, its tails and what is refitted, odds are no more than even, but for a few draws."""
    rng, noise = np.random.default_rng(1), plain(channels, share)
    courses = np.exp(-np.linspace(0.0, 3.0, SAMPLES) * np.array([0.3, 1.0, 4.0])[:, None])
    refitted = np.einsum("cd,pk->cpdk", np.eye(channels), courses).reshape(-1, channels, SAMPLES)
    jacobian = noise.whiten(refitted).T
    found, _ = swing(noise, jacobian)
    shape = (2000, channels, SAMPLES)
    alone = rng.standard_t(4, shape) / np.sqrt(2.0) if heavy else rng.standard_normal(shape)
    draws = noise.whiten(3.0 * noise.mixed(alone, rng.standard_normal((2000, 1, SAMPLES))))
    axes = np.linalg.qr(jacobian)[0]
    logs = found.log_evidence(draws - (draws @ axes) @ axes.T)
    assert np.exp(np.minimum(logs, 3.0)).mean() < 1.0
    assert np.quantile(logs, 0.985) < 1.0


@pytest.mark.parametrize("size", [1.0, 30.0])
def test_what_alternates_is_seen_though_noise_is_taken_for_as_large(size: float) -> None:
    """Gains of all channels up in one sample and down in the next, with noise that took all of it for its own."""
    rng = np.random.default_rng(2)
    found, values = swing(plain(5))
    gain = values * np.where(np.arange(SAMPLES) % 2, -1.0, 1.0)
    gain *= 10.0 / np.linalg.norm(gain)
    logs = [
        float(found.log_evidence(size * (gain + each).ravel())) for each in rng.standard_normal((60, *values.shape))
    ]
    assert np.mean(np.array(logs) > 5.0) > 0.9


@pytest.mark.parametrize(("samples", "told"), [(1, False), (2, False), (5, False), (6, True)])
def test_few_samples_show_no_swing(samples: int, told: bool) -> None:
    noise = Noise(np.ones((2, samples)), np.ones(2), 0.0)
    projection = Projection.of(np.zeros((2 * samples, 1)), np.ones(1))
    found = Swing.around([np.ones((2, samples))], TIMES[:samples], noise, projection)
    assert (found is not None) == told
    if found is not None:
        assert np.isfinite(found.log_evidence(np.random.default_rng(0).standard_normal((9, 2 * samples)))).all()


@pytest.mark.parametrize("period", [2.0, 2.7, 4.5])
def test_a_gap_of_no_name_may_swing_from_sample_to_sample(period: float) -> None:
    rng = np.random.default_rng(3)
    noise = plain(5)
    _, values = swing(noise)
    smooth = Smooth.around(
        [Profiles.of_values(values)], TIMES, noise, Projection.of(np.zeros((values.size, 1)), np.ones(1))
    )
    gain = values * np.cos(2.0 * np.pi * np.arange(SAMPLES) / period)
    gain *= 10.0 / np.linalg.norm(gain)
    data = (gain + rng.standard_normal(values.shape)).ravel()
    assert smooth.likeliest(data) == "swings alike"
    assert float(smooth.evidence(data)) > 4.0
