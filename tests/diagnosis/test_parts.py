"""The pieces: whitening, floors, projection, evidence, closure, sets; each against its own definition."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from petkin.diagnosis import evidence
from petkin.diagnosis.covariance import Noise, inverse_root, loads
from petkin.diagnosis.detect import noise_draws, p_value, statistic, tails
from petkin.diagnosis.effect import Hypothesis, Profiles, Term, foreknown
from petkin.diagnosis.estimates import _amplitude
from petkin.diagnosis.noise import (
    common_share,
    from_flexible,
    levels,
    outlying,
    pooled,
    second_differences,
    with_factor,
)
from petkin.diagnosis.nominal import base_fit
from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.refit import Fit, State
from petkin.diagnosis.sets import probabilities, smallest_set
from petkin.diagnosis.unknown import Smooth
from petkin.diagnosis.where import benjamini_hochberg

from .decaying_channels import DecayingChannels


@given(share=st.floats(0.0, 0.89), count=st.integers(1, 8))
@settings(max_examples=20, deadline=None)
def test_whitening_undoes_the_common_share(share: float, count: int) -> None:
    covariance = (1 - share) * np.eye(count) + share
    (mixing,) = Noise(np.ones((count, 3)), np.ones(count), share).mixing
    np.testing.assert_allclose(mixing @ covariance @ mixing.T, np.eye(count), atol=1e-10)


#: A factor of the values of five channels, two of which are small and noisy.
LOADS = np.array([1.4, 1.2, 1.0, 0.5, 0.5]) / np.sqrt(np.mean(np.square([1.4, 1.2, 1.0, 0.5, 0.5])))


def test_whitening_undoes_a_factor_of_the_values() -> None:
    rng = np.random.default_rng(3)
    noise = Noise(np.ones((5, 20000)), np.ones(5), 0.4, LOADS[:, None])
    drawn = noise.mixed(rng.standard_normal((5, 20000)), rng.standard_normal((1, 20000)))
    kappa = 0.4 / 0.6
    np.testing.assert_allclose(np.cov(drawn), kappa * np.outer(LOADS, LOADS) + np.eye(5), atol=0.03)
    np.testing.assert_allclose(noise.variance[:, 0], 1.0 + kappa * LOADS**2)
    np.testing.assert_allclose(np.cov(noise.whiten(drawn).reshape(5, -1)), np.eye(5), atol=0.03)
    np.testing.assert_allclose(noise.coloured(noise.whiten(drawn)), drawn)


def test_common_share_is_recovered() -> None:
    rng = np.random.default_rng(0)
    for share in (0.0, 0.3, 0.45):
        noise = Noise(np.ones((5, 4000)), np.ones(5), share)
        r = noise.mixed(rng.standard_normal((5, 4000)), rng.standard_normal((1, 4000)))
        assert float(common_share(r)) == pytest.approx(share, abs=0.04)


@pytest.mark.parametrize("load", [np.ones(5), LOADS])
def test_a_factor_and_what_is_beside_it_are_recovered(load: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    every = np.tile(load[:, None], 4000)
    for share in (0.0, 0.3, 0.55):
        noise = Noise(np.ones((5, 4000)), np.full(5, 0.7), share, every)
        r = 0.7 * noise.mixed(rng.standard_normal((5, 4000)), rng.standard_normal((1, 4000)))
        size, found = with_factor(r, 4000.0, every)
        assert float(size) == pytest.approx(0.7, rel=0.02)
        assert float(found) == pytest.approx(share, abs=0.04)


def test_a_factor_that_all_channels_show_alike_is_a_share() -> None:
    """Of the same residuals both laws find one covariance."""
    residuals = 0.3 * np.random.default_rng(4).standard_normal((7, 5, 30))
    residuals += 0.4 * np.random.default_rng(5).standard_normal((7, 1, 30))
    share = common_share(residuals)
    size, found = with_factor(residuals, 30.0, np.ones((5, 30)))
    np.testing.assert_allclose(found, np.minimum(share, 0.6), atol=1e-12)
    under = np.array([0.2, 0.5])
    alike, plain = inverse_root(5, under, np.ones((5, 1))), inverse_root(5, under)
    np.testing.assert_allclose(alike / np.sqrt(1.0 - under)[:, None, None, None], plain, atol=1e-12)
    free = share < 0.6
    own = (residuals**2).mean(axis=(-2, -1)) * (1.0 - share)
    np.testing.assert_allclose(size[free] ** 2, own[free], rtol=1e-9)


def test_one_channel_has_no_factor() -> None:
    residuals = 3.0 * np.random.default_rng(1).standard_normal((1, 5000))
    size, share = with_factor(residuals, 5000.0, np.ones((1, 5000)))
    assert float(share) == 0.0
    assert float(size) == pytest.approx(3.0, rel=0.04)


def test_loads_go_as_the_values_over_the_noise_in_every_sample() -> None:
    found = loads(np.array([[10.0, 5.0], [2.5, 2.5], [10.0, 2.5]]))
    np.testing.assert_allclose(found / found[0], [[1.0, 1.0], [0.25, 0.5], [1.0, 0.5]])
    np.testing.assert_allclose(np.mean(found**2, axis=0), 1.0)


def test_a_factor_of_the_values_weighs_as_they_do_in_every_sample() -> None:
    """Two channels that cross: whitened by their values at the time, a factor leaves nothing besides its own size."""
    rng = np.random.default_rng(5)
    values = np.stack([np.linspace(4.0, 0.5, 3000), np.linspace(0.5, 4.0, 3000), np.full(3000, 2.0)])
    factor = 0.8 / np.sqrt((values**2).mean(axis=0))
    data = values * (1.0 + factor * rng.standard_normal(3000)) + rng.standard_normal(values.shape)
    size, share = with_factor(data - values, 3000.0, loads(values))
    assert float(share) == pytest.approx(0.64 / 1.64, abs=0.03)
    white = Noise(np.ones(values.shape), np.full(3, size), float(share), loads(values)).whiten(data - values)
    for part in (slice(0, 500), slice(2500, 3000)):
        assert np.linalg.norm(np.cov(white.reshape(values.shape)[:, part]) - np.eye(3), 2) < 0.25


def test_only_a_simulator_that_says_so_has_loads() -> None:
    rng = np.random.default_rng(8)
    simulator = DecayingChannels()
    truth = simulator.predict(np.tile(simulator.own.mean, (4, 1)), np.zeros(0))
    noise = 0.01 * truth * rng.standard_normal((1, truth.shape[1])) + 0.02 * rng.standard_normal(truth.shape)
    assert base_fit(simulator, truth + noise)[1].load is None
    found = base_fit(replace(simulator, common_factor=True), truth + noise)[1]
    assert found.load is not None
    np.testing.assert_allclose(found.load, loads(levels(truth, found.spread)), rtol=0.05)
    assert np.ptp(found.size) == 0.0


def test_second_differences_see_noise_through_drifts_and_steps() -> None:
    rng = np.random.default_rng(1)
    k = np.arange(400)
    noise = rng.standard_normal((1, 400))
    with_gap = noise + 0.05 * k + 30.0 * (k > 200) + 20 * np.sin(k / 100.0)
    assert np.sqrt((second_differences(noise) ** 2).mean()) == pytest.approx(1.0, abs=0.12)
    assert np.sqrt((second_differences(with_gap) ** 2).mean()) == pytest.approx(1.0, abs=0.12)


def test_flexible_fit_counts_what_it_took() -> None:
    t = np.linspace(0, 5, 60)
    dictionary = np.exp(-np.array([0.1, 0.5, 2.0])[:, None] * t)
    curves = np.stack([2 * dictionary[0] + dictionary[2], dictionary[1]])
    residuals, freedom, bases = from_flexible(curves, np.ones_like(curves), dictionary)
    np.testing.assert_allclose(residuals, 0, atol=1e-9)
    assert freedom.tolist() == [60 - b.shape[1] for b in bases]


def test_one_wild_value_is_set_aside_and_a_wild_sample_is_not() -> None:
    r = np.random.default_rng(2).standard_normal((5, 40))
    r[2, 7] = 25.0
    r[:, 20] += 25.0
    factor = outlying(r)
    assert factor[2, 7] > 4
    assert (factor[:, 20] < 2).all()
    assert (outlying(r[:2]) == 1).all()


def test_projection_is_the_refit() -> None:
    rng = np.random.default_rng(3)
    J, g, penalty = rng.standard_normal((40, 6)), rng.standard_normal((40, 2)), rng.uniform(0.1, 2.0, 6)
    plain = np.eye(40) - J @ np.linalg.solve(J.T @ J + np.diag(penalty), J.T)
    projection = Projection.of(J, penalty)
    np.testing.assert_allclose(projection.inner(g, g), g.T @ plain @ g, rtol=1e-10)
    np.testing.assert_allclose(projection.norms(g), np.sqrt(np.diag(g.T @ plain @ g)), rtol=1e-10)
    assert float(Projection.of(J, np.full(6, 1e-14)).norms(J[:, :1])[0]) < 1e-5


@pytest.mark.parametrize("t", [-1.0, 0.0, 2.0, 6.0, 15.0])
def test_evidence_is_the_average_over_log_uniform_sizes(t: float) -> None:
    def average(sign: float) -> float:
        integrand = lambda u: np.exp(sign * np.exp(u) * t - np.exp(2 * u) / 2 - 0.5 * t**2)  # noqa: E731
        low, high = np.log(0.8), np.log(80.0)
        return quad(integrand, low, high, points=[np.log(max(abs(t), 1.0))], limit=200)[0] / (high - low)

    assert float(evidence.one_sided(np.array(t))) == pytest.approx(0.5 * t**2 + np.log(average(1.0)), abs=0.03)
    both = 0.5 * (average(1.0) + average(-1.0))
    assert float(evidence.two_sided(np.array(t))) == pytest.approx(0.5 * t**2 + np.log(both), abs=0.03)


def test_evidence_of_many_amplitudes_is_a_ratio_of_normals() -> None:
    rng = np.random.default_rng(4)
    G, y = rng.standard_normal((12, 3)), rng.standard_normal(12) * 2
    information = G.T @ G
    size = np.linalg.eigvalsh(information).mean()
    ratios = []
    for width in evidence.WIDTHS:
        covariance = np.eye(12) + width**2 / size * G @ G.T
        ratios.append(multivariate_normal(cov=covariance).logpdf(y) - multivariate_normal(cov=np.eye(12)).logpdf(y))
    expected = np.logaddexp.reduce(ratios) - np.log(len(ratios))
    assert float(evidence.Spread.of(information).together(G.T @ y)) == pytest.approx(float(expected), rel=1e-9)


def test_evidence_of_many_at_once_is_that_of_each() -> None:
    rng = np.random.default_rng(14)
    G, scores = rng.standard_normal((2, 9, 3)), rng.standard_normal((4, 2, 3)) * 5
    information = G.transpose(0, 2, 1) @ G
    each = [[float(evidence.Spread.of(i).together(s)) for i, s in zip(information, row)] for row in scores]
    np.testing.assert_allclose(evidence.Spread.of(information).together(scores), each, rtol=1e-12)
    t = np.array([[-90.0, -12.0, -3.1], [0.0, 70.0, 95.0]])
    both = np.logaddexp(evidence.one_sided(t), evidence.one_sided(-t)) - np.log(2.0)
    np.testing.assert_allclose(evidence.two_sided(t), both, rtol=1e-12)
    sides = np.logaddexp(evidence.one_sided(0.4 * t), evidence.one_sided(-t)) - np.log(2.0)
    np.testing.assert_allclose(evidence.two_sided(t, 0.4 * t), sides, rtol=1e-12)
    assert evidence.one_sided(t)[1, 1] == pytest.approx(0.5 * 70.0**2 + evidence._OCCAM[-1])


def test_draws_have_the_size_and_share_that_were_asked_for() -> None:
    rng = np.random.default_rng(5)
    noise = Noise(np.ones((5, 36)), np.ones(5), 0.4)
    draws = noise_draws(rng, 300, noise, {np.inf: 1.0}, [np.zeros((36, 0))] * 5, np.ones((5, 1)))
    assert draws.shape == (300, 180)
    assert float((draws**2).mean()) == pytest.approx(1.0, abs=0.06)


def test_draws_with_a_factor_are_white_where_both_numbers_are_found_in_them() -> None:
    """Along the factor, whose variance K values tell, a draw over what it finds of it has K / (K - 2) on average."""
    rng = np.random.default_rng(5)
    noise = Noise(np.ones((5, 36)), np.full(5, 0.3), 0.5, np.tile(LOADS[:, None], 36))
    draws = noise_draws(rng, 600, noise, {np.inf: 1.0}, [np.zeros((36, 0))] * 5, np.ones((5, 1)))
    assert float((draws**2).mean()) == pytest.approx(1.0, abs=0.06)
    axis = LOADS / np.linalg.norm(LOADS)
    along = (draws.reshape(600, 5, 36) * axis[:, None]).sum(axis=1)
    assert float((along**2).mean()) == pytest.approx(36.0 / 34.0, abs=0.04)


def test_tails_are_told_apart() -> None:
    rng = np.random.default_rng(6)
    normal, heavy = tails(rng.standard_normal((5, 600))), tails(rng.standard_t(5, (5, 600)))
    assert sum(normal.values()) == pytest.approx(1.0)
    assert normal[np.inf] > 0.9
    assert heavy[np.inf] < 1e-6
    assert max(heavy, key=lambda freedom: heavy[freedom]) == 5.0


def test_draws_have_each_tail_in_its_share() -> None:
    """Beyond four standard deviations lie 6e-5 of normal draws and 0.0056 of those with 5 degrees of freedom."""
    noise = Noise(np.ones((2, 40)), np.ones(2), 0.0)
    shares = {5.0: 0.25, np.inf: 0.75}
    drawn = noise_draws(np.random.default_rng(8), 4000, noise, shares, [np.zeros((40, 0))] * 2, np.ones((2, 1)))
    beyond = (np.abs(drawn) > 4.0).mean(axis=1)
    assert beyond[:1000].mean() > 20 * beyond[1000:].mean()
    assert beyond[1000:].mean() < 3e-4


def test_what_a_sample_has_in_common_is_normal_whatever_the_tails() -> None:
    noise = Noise(np.ones((4, 40)), np.ones(4), 0.9)
    drawn = noise_draws(np.random.default_rng(9), 4000, noise, {3.5: 1.0}, [np.zeros((40, 0))] * 4, np.ones((4, 1)))
    together = drawn.reshape(4000, 4, 40).mean(axis=1)
    together /= together.std()
    assert (np.abs(together) > 5.0).mean() < 3e-5


def test_p_value_counts_the_data_themselves() -> None:
    assert p_value(10.0, np.zeros(99)) == pytest.approx(0.01)
    assert p_value(-1.0, np.zeros(99)) == 1.0


def test_what_noise_looks_like_is_no_bar_for_what_it_does_not() -> None:
    """One hypothesis takes wild values for itself and one never does; a gap shows in the second alone."""
    rng = np.random.default_rng(10)
    tailed, plain = rng.standard_t(3, (2, 400, 36)), rng.standard_normal((2, 400))
    loud = evidence.mean(evidence.two_sided(tailed), -1)
    null, other = (np.stack([loud[i], evidence.two_sided(plain[i])], axis=1) for i in (0, 1))
    gap = np.stack([loud[1], evidence.two_sided(plain[1] + 4.5)], axis=1)

    def claimed(of: Callable[[np.ndarray], np.ndarray], logs: np.ndarray) -> float:
        return float(np.mean([p_value(value, of(null)) <= 0.03 for value in of(logs)]))

    assert claimed(evidence.mean, gap) < 0.5
    assert claimed(lambda logs: statistic(logs, null), gap) > 0.9
    assert claimed(lambda logs: statistic(logs, null), other) < 0.06


def test_a_hypothesis_that_noise_speaks_against_is_not_helped() -> None:
    null = np.full((100, 2), -3.0)
    assert statistic(np.array([-3.0, 5.0]), null) == pytest.approx(evidence.mean(np.array([-3.0, 5.0])))


def test_draws_of_a_prior_that_is_right_are_its_posterior() -> None:
    fit, projection = _fitted(np.zeros(12))
    drawn = projection.priors(np.random.default_rng(11), 20_000, fit)
    theirs = projection.axes[projection.rows :]
    np.testing.assert_allclose(drawn.mean(axis=0), fit.pulled, atol=0.03)
    np.testing.assert_allclose(np.cov(drawn.T), theirs @ theirs.T, atol=0.03)


def test_draws_of_a_prior_that_is_off_lie_nearer_to_the_truth_than_the_fit_shows() -> None:
    """It pulls at the fit, which so shows too little of how far off it is."""
    fits = [_fitted(np.full(12, 2.0), seed) for seed in range(40)]
    shown = np.mean([fit.pulled for fit, _ in fits])
    drawn = np.mean([projection.priors(np.random.default_rng(12), 200, fit) for fit, projection in fits])
    assert -1.6 < shown < -1.3
    assert drawn < shown - 0.15


def _fitted(off: np.ndarray, seed: int = 0) -> tuple[Fit, Projection]:
    """A linear fit of twelve parameters to thirty values, whose truth lies so many standard deviations off."""
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(30, 12)) * 0.35
    data = jacobian @ off + rng.standard_normal(30)
    found = np.linalg.solve(jacobian.T @ jacobian + np.eye(12), jacobian.T @ data)
    state, values = State(found[None], np.zeros(0)), jacobian @ found
    objective = float(((data - values) ** 2).sum() + (found**2).sum())
    fit = Fit(state, values, data - values, np.ones(12), -found, objective, jacobian, 12)
    return fit, Projection.of_fit(fit)


def test_probabilities_sum_to_one_and_follow_evidence() -> None:
    named, unknown = probabilities({"a": 10.0, "b": 8.0}, 0.0)
    assert sum(named.values()) + unknown == pytest.approx(1.0)
    assert named["a"] > named["b"] > unknown


def test_a_set_reaches_its_mass_and_takes_doubles_in() -> None:
    probability = {"a": 0.85, "b": 0.08, "c": 0.05, "d": 0.02}
    assert smallest_set(probability, {}) == ("a", "b")
    assert smallest_set({"a": 0.95, "b": 0.01}, {}) == ("a",)
    assert smallest_set({"a": 0.95, "b": 0.01}, {frozenset("ab"): 0.97}) == ("a", "b")


def test_benjamini_hochberg_by_hand() -> None:
    np.testing.assert_allclose(benjamini_hochberg(np.array([0.01, 0.04, 0.03, 0.5])), [0.04, 0.16 / 3, 0.16 / 3, 0.5])


def test_sizes_are_drawn_together_only_as_far_as_chance_could_part_them() -> None:
    """Halfway, where chance alone could: channels seldom have one noise, and a few do not say that they have."""
    freedom, level = np.full(4, 30.0), np.ones((4, 1))
    alike, apart = np.array([0.95, 1.0, 1.05, 1.0]), np.array([0.2, 1.0, 3.0, 8.0])
    drawn, doubt = pooled(alike, freedom, level)
    assert np.ptp(drawn) == pytest.approx(0.5 * np.ptp(alike), rel=0.1)
    assert np.all((doubt > 0.08) & (doubt < 0.5 * np.sqrt(3.0 / 30.0)))
    many = np.tile(alike, 10)
    assert np.ptp(pooled(many, np.full(40, 30.0), np.ones((40, 1)))[0]) < 0.2 * np.ptp(alike)
    drawn, doubt = pooled(apart, freedom, level)
    np.testing.assert_allclose(drawn, apart, rtol=0.12)
    np.testing.assert_allclose(doubt, 0.5 * np.sqrt(3.0 / 30.0), rtol=0.05)
    np.testing.assert_allclose(pooled(7.0 * apart, freedom, level)[0], 7.0 * drawn)
    assert pooled(np.array([2.0]), np.array([30.0]), np.ones((1, 1))) == (2.0, pytest.approx(0.158, abs=0.001))


def test_sizes_are_drawn_to_one_share_of_the_values_where_that_is_what_they_are() -> None:
    freedom, level = np.full(4, 30.0), np.array([1.0, 2.0, 4.0, 8.0])
    alike = np.array([0.95, 1.0, 1.05, 1.0])
    assert np.ptp(pooled(alike * level, freedom, level[:, None])[0] / level) < 0.55 * np.ptp(alike)
    apart = alike * np.array([1.0, 3.0, 1.0, 9.0])
    np.testing.assert_allclose(pooled(apart, freedom, level[:, None])[0], apart, rtol=0.12)


def test_sizes_scatter_about_the_truth_as_they_are_unsure() -> None:
    """Channels whose noise differs by a fifth: as far off as said, and nearer than each channel's own."""
    rng = np.random.default_rng(5)
    truth = np.exp(0.2 * rng.standard_normal((400, 6)))
    own = truth * np.sqrt(rng.chisquare(24.0, truth.shape) / 24.0)
    found, doubt = pooled(own, np.full(6, 24.0), np.ones((6, 1)))
    off = np.log(found / truth)
    off -= off.mean(axis=1, keepdims=True)
    assert 0.6 < np.sqrt((off**2).mean()) / np.sqrt((doubt**2).mean()) < 1.0
    raw = np.log(own / truth)
    assert (off**2).mean() < 0.8 * ((raw - raw.mean(axis=1, keepdims=True)) ** 2).mean()


def test_what_stands_out_in_one_channel_may_be_its_noise_and_in_all_is_not() -> None:
    """Against a search over all sizes whose mean logarithm is known."""
    channels, samples = 5, 30
    doubt = np.array([0.1, 0.15, 0.2, 0.1, 0.12])
    noise = Noise(np.ones((channels, samples)), np.ones(channels), 0.0, doubt=doubt)
    rng = np.random.default_rng(0)
    white = rng.standard_normal((channels, samples))

    def searched(values: np.ndarray) -> float:
        squares = (values**2).sum(axis=1)

        def lost(free: np.ndarray) -> float:
            x = np.append(free, -free.sum())
            return -float((0.5 * squares * -np.expm1(-2.0 * x) - 28.0 * x - 0.5 * (x / doubt) ** 2).sum())

        return -float(minimize(lost, np.zeros(channels - 1), method="BFGS").fun)

    for factor in (1.0, 1.5, 3.0, 30.0):
        loud = white * np.array([1.0, 1.0, factor, 1.0, 1.0])[:, None]
        assert noise.spared(loud.ravel(), 28.0 * channels) == pytest.approx(searched(loud), rel=1e-3)
    assert noise.spared(white.ravel(), 28.0 * channels) < 1.0
    assert noise.spared(3.0 * np.ones(white.size), 28.0 * channels) == pytest.approx(0.0, abs=1e-9)
    known = Noise(np.ones((channels, samples)), np.ones(channels), 0.0)
    assert known.spared(5.0 * white.ravel(), 28.0 * channels) == 0.0


def test_a_quiet_channel_between_loud_ones_is_not_wild() -> None:
    """It is the median of most samples, so that what it usually lies apart from them is nothing."""
    rng = np.random.default_rng(5)
    residuals = rng.standard_normal((5, 23)) * np.array([3.0, 3.0, 0.1, 4.0, 4.0])[:, None]
    assert outlying(residuals)[2].max() < 10.0


def test_an_amplitude_that_cannot_be_lower_is_not() -> None:
    line = Hypothesis("line", "s", "tau", "s", -12.0, 12.0, least=-12.0)
    assert line.limits == (-12.0, 36.0)
    assert Hypothesis("any", "s", "tau", "s", -12.0, 12.0).limits == (-36.0, 36.0)
    assert line.widths == (18.0, 18.0)


def test_the_size_of_an_effect_that_channels_have_unlike() -> None:
    """Of one that acts in some alone the clearest; the median of one that acts in all about alike."""
    names = tuple("abcde")
    values, errors = np.array([0.02, 0.05, 0.06, 0.055, 0.07]), np.array([0.0005, 0.004, 0.004, 0.004, 0.004])
    unlike = Hypothesis("h", "s", "a", "1", 0.0, 0.2, by_channel=True)
    local, alike = (
        _amplitude(Term(replace(unlike, alike=each), values, {}), np.diag(errors**2), names) for each in (False, True)
    )
    assert (local.value, local.channel) == (0.02, "a")
    assert alike.channel == ""
    assert alike.value == 0.055
    assert alike.low < 0.05
    assert alike.high > 0.06
    same = Term(Hypothesis("h", "s", "a", "1", 0.0, 0.2, by_channel=True, alike=True), np.full(5, 0.05), {})
    assert _amplitude(same, np.diag(np.full(5, 1e-4)), names).value == pytest.approx(0.05)


def test_an_amplitude_that_one_channel_has_is_not_averaged_over_the_others() -> None:
    """However weak it is."""
    one = Term(Hypothesis("h", "s", "a", "1", -0.2, 0.2, by_channel=True), np.array([0.0, 0.03, 0.0]), {})
    found = _amplitude(one, np.diag(np.full(3, 1e-4)), ("a", "b", "c"))
    assert (found.value, found.channel, found.effect) == (0.03, "b", "h")
    assert found.low == pytest.approx(0.03 - 0.01645, abs=1e-4)


def test_one_witness_is_heard_once() -> None:
    def term(name: str, odds: float, witness: str = "") -> Term:
        return Term(Hypothesis(name, "s", "a", "1", 0.0, 1.0, log_odds=odds, witness=witness), 0.0, {})

    assert foreknown((term("a", 20.0, "w"), term("b", 15.0, "w"))) == 20.0
    assert foreknown((term("a", 20.0, "w"), term("b", 15.0))) == 35.0
    assert foreknown((term("a", -1.0, "w"), term("b", 4.0, "w"))) == 4.0


def test_heavy_tails_are_seen_in_a_single_scan_and_normal_ones_left_alone() -> None:
    rng = np.random.default_rng(7)
    heavy = [tails(rng.standard_t(4, (5, 36)))[np.inf] for _ in range(40)]
    normal = [tails(rng.standard_normal((5, 36)))[np.inf] for _ in range(40)]
    assert np.mean(np.array(heavy) < 0.1) > 0.75
    assert np.median(normal) > 0.75


def test_no_more_than_a_share_is_taken_for_a_factor_in_common() -> None:
    """Gains of all channels at once would else be noise, however large."""
    load = np.tile(np.array([1.2, 0.9, 0.8])[:, None] / np.sqrt(np.mean(np.square([1.2, 0.9, 0.8]))), 400)
    gain = load * np.sin(np.arange(400.0)) * np.sqrt(2.0)
    noise = 0.1 * np.random.default_rng(0).standard_normal(gain.shape)
    size, share = with_factor(gain + noise, 400.0, load)
    assert float(share) == 0.6
    assert float(size) == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize(
    ("rhythms", "phases", "place"),
    [
        ((7,), (0.0, 0.0, 0.0, 0.0), "swings alike"),
        ((7,), (0.3, 1.4, 2.9, 4.4), "swings each"),
        ((2, 3, 5, 7, 9, 11), (0.3, 1.4, 2.9, 4.4), "each"),
        ((2, 3, 5, 7, 9, 11), (0.0, 0.0, 0.0, 0.0), "alike"),
    ],
)
def test_what_swings_is_told_from_what_has_many_rhythms(
    rhythms: tuple[int, ...], phases: tuple[float, ...], place: str
) -> None:
    """Rhythms in half periods a scan, each channel with its phase, against what swings and what does not."""
    times = np.linspace(2.5, 87.5, 18)
    values = np.full((4, 18), 10.0)
    noise = Noise(np.ones_like(values), np.full(4, 0.1), 0.0)
    smooth = Smooth.around(
        [Profiles.of_values(values)], times, noise, Projection.of(np.zeros((values.size, 1)), np.ones(1))
    )
    turns = np.pi * times / 90.0 + np.array(phases)[:, None]
    wave = np.sum([np.sin(rhythm * turns) for rhythm in rhythms], axis=0)
    wave *= 12.0 * 0.1 / np.linalg.norm(wave)
    assert smooth.likeliest(noise.whiten(wave)) == place
