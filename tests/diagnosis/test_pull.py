"""What a prior pulls, what is alike in all channels, and causes that only show beside another."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from petkin.diagnosis import Coordinates, Term, diagnose, evidence
from petkin.diagnosis.nominal import base_fit
from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.pairs import _beside, _jointly, _refitted
from petkin.diagnosis.refit import State, begun, refit
from petkin.diagnosis.scan import Scan, templates
from petkin.diagnosis.which import Candidate, refitted, singles

from .decaying_channels import HYPOTHESES, DecayingChannels, hypothesis, measured

SIMULATOR = DecayingChannels()
OFFSET = Term(hypothesis("offset"), 0.12, {})
RIPPLE = Term(hypothesis("ripple"), 0.3, {"pitch": 1.6})


def test_what_a_refit_leaves_of_data_and_prior() -> None:
    rng = np.random.default_rng(0)
    J, penalty, y, z = (
        rng.standard_normal((30, 5)),
        rng.uniform(0.2, 3.0, 5),
        rng.standard_normal(30),
        rng.standard_normal(5),
    )
    x = np.linalg.solve(J.T @ J + np.diag(penalty), J.T @ y + np.sqrt(penalty) * z)
    np.testing.assert_allclose(Projection.of(J, penalty).left(y, z), y - J @ x, atol=1e-12)


def test_a_fit_knows_its_pull_and_draws_keep_it() -> None:
    data = measured(np.random.default_rng(1))
    base, *_ = base_fit(SIMULATOR, data)
    assert base.objective == pytest.approx(base.chi2 + base.pulled @ base.pulled)
    projection = Projection.of_fit(base)
    np.testing.assert_allclose(projection.left_of(base), base.residual, atol=1e-3)
    draws = projection.priors(np.random.default_rng(2), 20000, base)
    scaled = base.jacobian / np.sqrt(base.penalty)
    covariance = np.linalg.inv(np.eye(len(base.penalty)) + scaled.T @ scaled)
    np.testing.assert_allclose(draws.mean(axis=0), base.pulled, atol=0.03)
    np.testing.assert_allclose(np.cov(draws.T), covariance, atol=0.03)


def test_each_side_of_a_range_has_a_prior_of_its_own_width() -> None:
    """An amplitude of -0.3 lies three ranges below zero here, and half a range above."""
    lopsided = replace(hypothesis("offset"), lower=-0.1, upper=0.6)
    assert lopsided.widths == pytest.approx((0.15, 0.9))
    assert replace(lopsided, lower=0.0).widths == pytest.approx((0.9, 0.9))
    costs = []
    for sign in (-1.0, 1.0):
        data = measured(np.random.default_rng(3), replace(OFFSET, amplitude=sign * 0.3), sd=0.3)
        base, noise, *_ = base_fit(SIMULATOR, data)
        fits = []
        for given in (lopsided, replace(lopsided, lower=-0.6)):
            start = State(base.state.own, base.state.shared, (Term(given, sign * 0.2, {}),))
            fits.append(refit(SIMULATOR, data, noise, start))
        costs.append(fits[0].objective - fits[1].objective)
        scan = Scan(templates(SIMULATOR, noise, base, [lopsided]), Projection.of_fit(base), None)
        wide = Scan(templates(SIMULATOR, noise, base, [replace(lopsided, lower=-0.6)]), Projection.of_fit(base), None)
        costs.append(float(wide.each(base.residual)[0] - scan.each(base.residual)[0]))
    below, scanned_below, above, scanned_above = costs
    assert below > 0.5
    assert scanned_below > 0.1
    assert above == pytest.approx(0.0, abs=1e-3)
    assert scanned_above == pytest.approx(0.0, abs=0.05)


@dataclass(frozen=True)
class Mistaken(DecayingChannels):
    """Its prior lies three standard deviations off, and is as strong as some tens of samples."""

    @property
    def own(self) -> Coordinates:
        return replace(super().own, mean=np.log([5.0, 0.3]) + 0.45, sd=np.full(2, 0.15))


def p_values(simulator: DecayingChannels) -> list[float]:
    data = [measured(np.random.default_rng(seed), sd=0.3) for seed in range(8)]
    return [diagnose(simulator, one, HYPOTHESES, draws=200).p_value for one in data]


def test_a_prior_that_is_off_is_no_gap() -> None:
    """Draws without its pull have p-values 0.07 lower in the mean."""
    assert np.mean(p_values(Mistaken())) == pytest.approx(np.mean(p_values(SIMULATOR)), abs=0.04)


def test_amplitudes_that_are_alike_have_more_evidence_where_they_should_be() -> None:
    spread = evidence.Spread.of(np.eye(6))
    same, lone = np.full(6, 4.0), np.array([9.8, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert float(spread.by_channel(same, True, True)) > float(spread.by_channel(same, False, True)) + 3.0
    assert float(spread.by_channel(lone, True, True)) < float(spread.by_channel(lone, False, True)) - 3.0


def test_a_cause_far_behind_is_asked_for_what_it_lacks() -> None:
    """One that takes part of both true causes may lead by far; either true one reaches beyond it with the other."""
    data = measured(np.random.default_rng(3), OFFSET, RIPPLE)
    base, noise, *_ = base_fit(SIMULATOR, data)
    projection = Projection.of_fit(base)
    scan = Scan(templates(SIMULATOR, noise, base, HYPOTHESES), projection, None)
    behind = refitted(SIMULATOR, data, noise, base, begun(SIMULATOR, data, noise, base, (OFFSET,)))
    ahead = Candidate(("local step",), None, behind.log_evidence + 30.0)
    wanted = _beside(scan, [ahead, behind])
    assert wanted["offset", "ripple"].score > ahead.log_evidence


def test_a_refit_begins_weakly_where_a_linear_amplitude_lies_too_far() -> None:
    data = measured(np.random.default_rng(4), RIPPLE)
    base, noise, *_ = base_fit(SIMULATOR, data)
    wild = replace(RIPPLE, amplitude=3.0)
    start = begun(SIMULATOR, data, noise, base, (RIPPLE,))
    assert start.terms == (RIPPLE,)
    assert begun(SIMULATOR, data, noise, base, (wild,)).terms[0].amplitude == pytest.approx(0.3)
    known = refitted(SIMULATOR, data, noise, base, start)
    assert known.fit is not None
    kept = begun(SIMULATOR, data, noise, known.fit, (Term(hypothesis("offset"), 2.0, {}),))
    assert kept.terms[0].amplitude == pytest.approx(known.terms[0].amplitude, rel=0.2)
    assert kept.terms[1].amplitude == pytest.approx(0.2)


def test_what_is_there_makes_room_for_a_strong_effect() -> None:
    """Beside all of a ripple the simulator's own fit is far off; one linear step takes most of that away."""
    data = measured(np.random.default_rng(4), replace(RIPPLE, amplitude=3.0 * RIPPLE.amplitude))
    base, noise, *_ = base_fit(SIMULATOR, data)
    strong = replace(RIPPLE, amplitude=3.0 * RIPPLE.amplitude)
    start = begun(SIMULATOR, data, noise, base, (strong,))

    def off(state: State) -> float:
        return float(np.square(noise.whiten(data - SIMULATOR.predict(state.own, state.shared, state.terms))).sum())

    assert off(start) < 0.5 * off(replace(base.state, terms=(strong,)))


def test_one_amplitude_that_is_positive_has_no_other_sign_to_average_over() -> None:
    """Twice as likely as one of either sign where it is positive, and far less where it is not."""
    spread = evidence.Spread.of(np.eye(6))
    lone = np.array([9.8, 0.0, 0.0, 0.0, 0.0, 0.0])
    for alike, score in ((False, lone), (True, np.full(6, 4.0))):
        either, positive, absent = (
            float(spread.by_channel(sign * score, alike, signed))
            for sign, signed in ((1, True), (1, False), (-1, False))
        )
        assert positive == pytest.approx(either + np.log(2.0), abs=0.05)
        assert absent < either - 1.0


@pytest.mark.parametrize("score", [(4.0, 3.0, 5.0), (4.0, 0.2, 3.0), (3.0, -1.0, 4.0)])
def test_amplitudes_that_are_positive_are_averaged_over_what_is_positive(score: tuple[float, ...]) -> None:
    """Against integrals over half-normal amplitudes of each width."""

    def one(s: float, width: float) -> float:
        return quad(lambda a: 2.0 * norm.pdf(a, 0.0, width) * np.exp(s * a - 0.5 * a * a), 0.0, 12.0)[0]

    widths = np.geomspace(0.5, 40.0, 8)
    together = np.log(np.mean([np.prod([one(s, w) for s in score]) for w in widths]))
    lone = np.log(np.mean(np.exp(evidence.one_sided(np.array(score)))))
    found = evidence.Spread.of(np.eye(3)).by_channel(np.array(score), False, False)
    assert float(found) == pytest.approx(np.logaddexp(together, lone) - np.log(2.0), abs=0.35)


@pytest.mark.parametrize("score", [(4.0, 3.0, 5.0), (6.0, 0.2, 3.0), (3.0, -1.0, 4.0)])
def test_amplitudes_about_the_same_are_averaged_over_what_they_may_be(score: tuple[float, ...]) -> None:
    """Against integrals over amplitudes that differ by half of what they are about, itself log-uniform."""

    def one(s: float, about: float) -> float:
        return quad(lambda a: norm.pdf(a, about, 0.5 * about) * np.exp(s * a - 0.5 * a * a), -20.0, 60.0, limit=200)[0]

    sizes = np.geomspace(0.8, 80.0, 120) / np.sqrt(3.0)
    expected = np.log(np.mean([np.prod([one(s, about) for s in score]) for about in sizes]))
    found = evidence.Spread.of(np.eye(3)).about(np.array(score), False)
    assert float(found) == pytest.approx(expected, abs=0.05)


def test_twenty_amplitudes_that_are_alike_are_no_easier_to_have_than_five() -> None:
    """As much of them, evenly over channels, is no better a reason; over some channels only it is a worse one."""
    few, many = (evidence.Spread.of(np.eye(n)) for n in (5, 20))
    even = [float(s.about(np.full(n, 8.0 / np.sqrt(n)), False)) for s, n in ((few, 5), (many, 20))]
    assert even[0] - 4.0 < even[1] < even[0] < float(evidence.one_sided(np.array(8.0)))
    half = np.repeat([8.0 / np.sqrt(10), 0.0], 10)
    assert float(many.about(half, False)) < even[1] - 2.0


def test_two_that_do_the_same_to_a_channel_explain_no_more_than_one_beside_the_other() -> None:
    """A gain in two channels, and jumps that would nearly cancel with more of it."""
    gain = replace(hypothesis("local step"), name="local gain", lower=-0.5, upper=0.5, unit="1")
    truth, lowered = Term(gain, np.array([0.0, 0.25, 0.2, 0.0]), {"onset": 5.0}), []
    for seed in range(6):
        data = measured(np.random.default_rng(seed), truth)
        base, noise, *_ = base_fit(SIMULATOR, data)
        asked = [hypothesis("local step"), gain]
        scan = Scan(templates(SIMULATOR, noise, base, asked), Projection.of_fit(base), None)
        alone = {found.label: found for found in singles(SIMULATOR, data, noise, base, scan)}
        wanted = _jointly(scan, base.residual)["local gain", "local step"]
        free, bound = (_refitted(SIMULATOR, data, noise, base, wanted, known).log_evidence for known in ({}, alone))
        assert bound < alone["local gain"].log_evidence - 0.5 * evidence.SECOND
        lowered.append(free - bound)
    assert min(lowered) > -0.2  # the likelier of both comes first then, from where a refit may end elsewhere
    assert max(lowered) > 2.0
