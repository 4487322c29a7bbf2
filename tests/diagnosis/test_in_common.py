"""What data sets may have in common: a moment and a strength, told by all where none tells it alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from petkin.diagnosis import CLAIM, Cohort, Fit, Interval, Member, Strength, Term, base_fit, diagnose, in_common
from petkin.diagnosis.any_gap import any_gap
from petkin.diagnosis.diagnose import scan_of
from petkin.diagnosis.evidence import mean
from petkin.diagnosis.pooling import mean_closure, moment
from petkin.diagnosis.profile import profiles
from petkin.diagnosis.sharing import Common, mixture

from .decaying_channels import HYPOTHESES, DecayingChannels, hypothesis, measured

SIMULATOR = DecayingChannels()
#: A step that hardly any data set shows alone.
WEAK = 0.028


def stepped(onsets: list[float], seed: int, name: str = "step", size: float = WEAK) -> list[Member]:
    """Data sets whose values step, each at its moment; 0 for none."""
    found = []
    for i, onset in enumerate(onsets):
        amplitude = np.array([0.0, size, 0.0, 0.0]) if hypothesis(name).by_channel else size
        terms = (Term(hypothesis(name), amplitude, {"onset": onset}),) if onset else ()
        data = measured(np.random.default_rng((seed, i)), *terms)
        found.append(Member.of(f"m{i}", diagnose(SIMULATOR, data, HYPOTHESES, draws=100, seed=i)))
    return found


@pytest.fixture(scope="module")
def weak() -> list[Member]:
    return stepped([4.2] * 12, 9)


def test_a_moment_in_common_tells_what_no_data_set_does(weak: list[Member]) -> None:
    cohort = in_common(weak)
    leader = cohort.causes[0]
    assert sum(m.p_value <= CLAIM for m in weak) <= 6
    assert cohort.chosen == ("step",)
    assert leader.onset is not None
    assert leader.onset.low < 4.2 < leader.onset.high
    assert leader.onset.high - leader.onset.low < 2.5
    assert "step" not in _without_profiles(weak).chosen


def test_its_mean_strength_is_that_at_the_moment_which_lies_between_those_asked() -> None:
    held, means = [], []
    for seed, onset in enumerate(np.random.default_rng(0).uniform(2.0, 8.0, 8)):
        members = stepped([float(onset)] * 8, 30 + seed, size=0.035)
        leader = next(c for c in in_common(members).groups[0].causes if c.label == "step")
        assert leader.mean is not None
        held.append(leader.mean.low < 0.035 < leader.mean.high)
        means.append(leader.mean.value)
    assert sum(held) >= 6
    assert np.mean(means) == pytest.approx(0.035, rel=0.15)


def _without_profiles(members: list[Member]) -> Cohort:
    return in_common([replace(m, profiles={}) for m in members])


def test_moments_of_their_own_are_no_moment_in_common() -> None:
    cohort = in_common(stepped([2.1, 3.3, 4.4, 5.6, 6.7, 7.8], 4, size=0.06))
    assert cohort.chosen == ("step",)
    assert cohort.causes[0].onset is None


def test_a_member_without_it_is_told_by_the_size_in_the_others() -> None:
    """Each with a moment of its own; what noise looks like at its best moment is smaller."""
    onsets = [2.1, 0.0, 3.3, 0.0, 4.4, 0.0, 5.6, 0.0, 0.0, 0.0]
    members = stepped(onsets, 5, "local step", 0.12)
    carriers = in_common(members).causes[0].carriers
    np.testing.assert_array_equal(carriers > 0.5, np.array(onsets) > 0)
    before = _without_profiles(members).causes[0].carriers
    without = np.array(onsets) == 0
    assert carriers[without].mean() < 0.7 * before[without].mean()


@pytest.mark.parametrize("seed", range(20, 24))
def test_many_data_sets_without_anything_share_nothing(seed: int) -> None:
    cohort = in_common(stepped([0.0] * 14, seed))
    assert cohort.unshared > 0.2
    assert not cohort.present or cohort.p_value > 0.2 * CLAIM


def test_what_all_share_makes_a_gap_that_none_shows(weak: list[Member]) -> None:
    silent = [replace(m, p_value=0.6) for m in weak]
    assert any_gap([m.p_value for m in silent], [m.against for m in silent]) > CLAIM
    assert in_common(silent).present
    assert in_common(silent).p_value == pytest.approx(1e-3)


def test_profiles_are_likelihood_ratios_beside_the_rest_of_the_fit() -> None:
    """Against the objective of a linear refit with the amplitude held."""
    data = measured(np.random.default_rng(0), Term(hypothesis("step"), 0.05, {"onset": 5.0}))
    base, noise, _, _ = base_fit(SIMULATOR, data)
    scan = scan_of(SIMULATOR, noise, base, HYPOTHESES)
    found = profiles(scan, base.residual)
    assert "clipped" not in found
    step = found["step"]
    template = next(t for t in scan.templates if t.hypothesis.name == "step" and t.setting["onset"] == 5.0)
    place = step.settings.index({"onset": 5.0})
    for size, log in zip(step.sizes[::7], step.by_size[place, ::7], strict=True):
        gain = _objective(base, base.residual) - _objective(base, base.residual - size * template.columns[:, 0])
        prior = -0.5 * (size / hypothesis("step").width) ** 2
        assert log == pytest.approx(0.5 * gain + prior, rel=2e-3, abs=0.1)
    assert step.values[place] == pytest.approx(0.05, abs=4 * step.errors[place])
    assert mean(step.by_setting) == pytest.approx(float(scan.evidence(base.residual)[scan.names.index("step")]))
    assert np.isnan(found["local step"].values).all()
    assert (found["local step"].sizes > 0).all()


def _objective(base: Fit, residual: np.ndarray) -> float:
    """After one linear step."""
    rows = np.concatenate([base.jacobian, np.diag(np.sqrt(base.penalty))])
    target = np.concatenate([residual, base.pulled])
    left = target - rows @ np.linalg.lstsq(rows, target)[0]
    return float(left @ left)


def test_a_profile_of_channels_is_an_average_over_their_amplitudes() -> None:
    """Against draws of the amplitudes."""
    data = measured(np.random.default_rng(1))
    base, noise, _, _ = base_fit(SIMULATOR, data)
    scan = scan_of(SIMULATOR, noise, base, HYPOTHESES)
    found, rng = profiles(scan, base.residual)["local step"], np.random.default_rng(0)
    i = next(i for i, t in enumerate(scan.templates) if t.hypothesis.name == "local step")
    columns, projected = scan.by_template()[i]
    score, information = (
        base.residual @ projected,
        columns.T @ projected + np.eye(4) * hypothesis("local step").width ** -2.0,
    )
    place = int(np.abs(found.sizes - 0.03).argmin())
    size = found.sizes[place]

    def average(drawn: np.ndarray) -> float:
        return float(np.exp(drawn @ score - 0.5 * ((drawn @ information) * drawn).sum(axis=1)).mean())

    every = average(size * rng.standard_normal((400_000, 4)))
    lone = average(size * np.concatenate([np.eye(4), -np.eye(4)]))
    assert found.by_size[0, place] == pytest.approx(np.log(0.5 * (every + lone)), abs=0.03)


def test_a_profile_at_other_settings_is_that_at_the_nearest() -> None:
    base, noise, _, _ = base_fit(SIMULATOR, measured(np.random.default_rng(2)))
    step = profiles(scan_of(SIMULATOR, noise, base, HYPOTHESES), base.residual)["step"]
    moved = step.on(({"onset": 1.1}, {"onset": 5.2}, {"onset": 80.0}))
    np.testing.assert_array_equal(moved.by_size, step.by_size[[0, 8, -1]])
    assert step.on(step.settings) is step
    further = step.on(({"onset": 5.2, "course": 1.0},))
    np.testing.assert_array_equal(further.by_size, step.by_size[[8]])


def test_members_whose_sizes_mean_something_else_have_strengths_alone_in_common(weak: list[Member]) -> None:
    """As where one has pictures and the others curves."""
    odd = weak[0].profiles["step"]
    other = replace(odd, sizes=odd.sizes[:30], by_size=odd.by_size[:, :30])
    mixed = [replace(weak[0], profiles=weak[0].profiles | {"step": other}), *weak[1:]]
    cohort = in_common(mixed)
    assert all(cause.onset is None for cause in cohort.causes if cause.label == "step")


def test_a_strength_at_an_unknown_moment_is_as_unsure_as_that_makes_it() -> None:
    """Of weak steps at any moment, which another moment may suit as well, with the other sign."""
    held, narrow = [], []
    for seed, onset in enumerate(np.random.default_rng(1).uniform(2.0, 8.0, 40)):
        (member,) = stepped([float(onset)], 60 + seed, size=0.03)
        found, own = member.strength("step"), member.strengths["step"]
        assert found is not None
        assert found.low <= own.low <= own.high <= found.high
        held.append(found.low <= 0.03 <= found.high)
        narrow.append(own.low <= 0.03 <= own.high)
    assert np.mean(held) >= 0.85
    assert np.mean(narrow) <= np.mean(held) - 0.1


def test_what_templates_miss_is_added_where_they_say_most() -> None:
    base, noise, _, _ = base_fit(SIMULATOR, measured(np.random.default_rng(3), Term(hypothesis("offset"), 0.1, {})))
    offset = profiles(scan_of(SIMULATOR, noise, base, HYPOTHESES), base.residual)["offset"]
    own = float(mean(offset.by_setting))
    right = offset.reaching(own + 5.0)
    assert right.by_size.max() == pytest.approx(offset.by_size.max() + 5.0)
    least = int(np.abs(offset.sizes).argmin())
    assert abs(right.by_size[0, least] - offset.by_size[0, least]) < 0.2 * 5.0


def test_a_glaring_gap_is_not_believed_to_have_a_size_beyond_what_it_has_on_average() -> None:
    gap = Term(hypothesis("local step"), np.array([3.0, -2.0, 4.0, 0.0]), {"onset": 5.0})
    base, noise, _, _ = base_fit(SIMULATOR, measured(np.random.default_rng(3), gap))
    for one in profiles(scan_of(SIMULATOR, noise, base, HYPOTHESES), base.residual).values():
        for own in (-2.0, 30.0, 3000.0):
            right = one.reaching(own)
            assert max(right.by_size.max(), right.by_setting.max()) <= max(own, 0.0) + 15.0


def test_a_mixture_is_the_sum_over_what_may_be_in_common() -> None:
    rng = np.random.default_rng(4)
    own, background = rng.normal(2.0, 2.0, 5), rng.normal(-0.5, 0.3, (3, 5))
    kinds = [Common(rng.normal(1.0, 2.0, (7, 5))), Common(rng.normal(3.0, 2.0, (4, 5)), np.array([0, 0, 1, 1]))]
    found = mixture(own, kinds, background)
    rows = [(0.5, -1, own)]
    for kind in kinds:
        places = [-1] * len(kind.evidence) if kind.settings is None else kind.settings
        rows += [(0.25 / len(kind.evidence), s, e) for s, e in zip(places, kind.evidence, strict=True)]
    prevalences = np.linspace(0.15, 0.99, 43)
    total, at, having = 0.0, np.zeros(2), np.zeros(5)
    for b in background:
        for share, setting, e in rows:
            for p in prevalences:
                each = (1 - p) * np.exp(b) + p * np.exp(e)
                few = ((1 - p) * np.exp(b)).prod() * (1 + (p / (1 - p) * np.exp(e - b)).sum())
                usual = 1 - (1 - p) ** 5 - 5 * p * (1 - p) ** 4
                weight = share * (each.prod() - few) / usual
                total, having = total + weight, having + weight * p * np.exp(e) / each
                if setting >= 0:
                    at[setting] += weight
    nothing = np.exp(background.sum(axis=1)).sum() * len(prevalences)
    assert found.log_evidence == pytest.approx(np.log(total / nothing), abs=1e-6)
    np.testing.assert_allclose(found.settings, at / total, atol=1e-6)
    np.testing.assert_allclose(found.carriers, having / total, atol=1e-6)


def test_one_member_shares_with_none() -> None:
    alone = mixture(np.array([40.0, -1.0, -1.0, -1.0]), [], np.array([[36.0, 0.0, 0.0, 0.0]]))
    both = mixture(np.array([40.0, 4.0, -1.0, -1.0]), [], np.array([[36.0, 0.0, 0.0, 0.0]]))
    assert alone.log_evidence < 2.5
    assert both.log_evidence > alone.log_evidence + 3.0


def test_a_gap_of_no_name_has_in_common_what_the_name_has_that_it_is_like() -> None:
    """Members whose steps have a moment in common, beside something that no name explains."""
    members = stepped([4.2] * 6, 6, size=0.06)
    stranger = [replace(m, unnamed=max(m.evidence.values()) + 9.0) for m in members]
    assert in_common(members).chosen == ("step",)
    found = in_common(stranger)
    assert found.chosen == ()
    assert found.unnamed is not None
    assert found.unnamed.like == "step"
    assert found.unnamed.onset is None


def test_huge_evidence_overflows_nothing() -> None:
    found = mixture(np.array([900.0, 5000.0, -5000.0]), [], np.zeros((2, 3)))
    assert np.isfinite(found.log_evidence)
    np.testing.assert_allclose(found.carriers, [1.0, 1.0, 0.0], atol=1e-9)


def test_the_interval_of_a_moment_reaches_halfway_to_those_not_asked() -> None:
    found = moment([10.0, 20.0, 30.0, 20.0], np.array([0.02, 0.6, 0.01, 0.37]))
    assert found == Interval(pytest.approx(19.9), 15.0, 25.0)
    assert moment([None, None], np.array([0.5, 0.5])) is None


def test_the_mean_closure_is_no_more_than_all() -> None:
    found = mean_closure([Interval(0.98, 0.9, 1.0), Interval(1.0, 0.95, 1.0), Interval(0.97, 0.9, 1.0)])
    assert found is not None
    assert 0.9 < found.low < found.value < found.high <= 1.0
    assert mean_closure([Interval(0.98, 0.9, 1.0)]) is None


@pytest.mark.parametrize("share", [0.0, 0.7])
def test_an_amplitude_of_all_channels_errs_by_what_they_have_in_common(share: float) -> None:
    """Its interval holds the truth as often where noise is common to channels."""
    alike = replace(hypothesis("local step"), alike=True, settings=({"onset": 4.0},))
    held: list[bool] = []
    for seed in range(60):
        term = Term(hypothesis("local step"), np.full(4, 0.1), {"onset": 4.0})
        data = measured(np.random.default_rng((seed, 9)), term, share=share)
        found: Strength = diagnose(DecayingChannels(common_factor=True), data, (alike,), draws=20).strengths[alike.name]
        held.append(found.low <= 0.1 <= found.high)
    assert np.mean(held) >= 0.8
