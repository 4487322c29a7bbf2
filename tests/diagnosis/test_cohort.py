"""What data sets share: a cause too weak for each of them, who has it, how strong it is; nothing without a gap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from petkin.diagnosis import Cohort, Member, Strength, Term, diagnose, in_common
from petkin.diagnosis.detect import AgainstNoise
from petkin.diagnosis.evidence import two_sided
from petkin.diagnosis.pooling import mean_strength

from .decaying_channels import HYPOTHESES, DecayingChannels, hypothesis, measured

SIMULATOR = DecayingChannels()
#: An offset that most data sets do not show alone.
WEAK = 0.04


#: Of members that are made by hand: their p-values speak for them.
NOISE = AgainstNoise(("offset", "ripple"), np.zeros(2), np.random.default_rng(0).standard_normal((200, 2)))


def members(strengths: list[float], seed: int, name: str = "ripple") -> list[Member]:
    """Data sets with an effect of these strengths; 0 is none."""
    found = []
    for i, strength in enumerate(strengths):
        rng = np.random.default_rng((seed, i))
        terms = (Term(hypothesis(name), strength, {"pitch": 1.5} if name == "ripple" else {}),) if strength else ()
        data = measured(rng, *terms)
        found.append(Member.of(f"m{i}", diagnose(SIMULATOR, data, HYPOTHESES, draws=100, seed=i)))
    return found


@pytest.fixture(scope="module")
def weak() -> tuple[list[Member], Cohort]:
    kept = members([WEAK] * 8, 1, "offset")
    return kept, in_common(kept)


def test_a_cause_too_weak_for_each_is_named_by_all(weak: tuple[list[Member], Cohort]) -> None:
    kept, cohort = weak
    assert sum(m.p_value <= 0.03 for m in kept) <= 6
    assert cohort.kind == "named"
    assert cohort.chosen == ("offset",)
    assert cohort.p_value < min(m.p_value for m in kept)
    assert cohort.causes[0].prevalence.value > 0.7


def test_its_strength_is_that_of_the_members(weak: tuple[list[Member], Cohort]) -> None:
    mean = weak[1].causes[0].mean
    assert mean is not None
    assert mean.low < WEAK < mean.high
    assert mean.high - mean.low < WEAK


@pytest.mark.parametrize("seed", [2, 7, 13, 22])
def test_who_carries_it(seed: int) -> None:
    strengths = [0.08, 0.0, 0.08, 0.0, 0.0, 0.08]
    cohort = in_common(members(strengths, seed))
    carriers = cohort.causes[0].carriers
    assert cohort.causes[0].label == "ripple"
    assert (carriers[[0, 2, 5]] > 0.9).all()
    assert (carriers[[1, 3, 4]] < 0.5).all()
    assert cohort.causes[0].prevalence.low < 0.5 < cohort.causes[0].prevalence.high


def test_strengths_that_differ_between_members() -> None:
    cohort = in_common(members([0.05, 0.1, 0.2, 0.3], 3))
    assert cohort.causes[0].between is not None
    assert cohort.causes[0].between > 0.05


@pytest.mark.parametrize(("count", "error"), [(2, 0.1), (3, 0.25), (5, 0.1), (8, 0.4)])
def test_the_interval_of_a_mean_holds_it_however_few_tell_its_spread(count: int, error: float) -> None:
    """Strengths that are log-normal about 1; with the normal interval alone 0.71 to 0.90 do."""
    rng, held = np.random.default_rng(count), 0
    for _ in range(400):
        strengths = np.exp(0.25 * rng.standard_normal(count)) + error * rng.standard_normal(count)
        found = [
            Strength("amplitude", "1", s, s - 1.645 * error, s + 1.645 * error, signed=True, single=True)
            for s in strengths
        ]
        pooled = mean_strength(found)
        assert pooled is not None
        held += pooled.interval.low <= np.exp(0.5 * 0.25**2) <= pooled.interval.high
    assert 0.87 <= held / 400 <= 0.98


def test_an_error_that_all_have_alike_is_not_averaged_away() -> None:
    """Twenty scans each read a tenth too much, as all scans of a kind may."""
    rng, noise = np.random.default_rng(1), 0.02
    half = 1.645 * np.hypot(noise, 0.1 * 1.1)
    read = 1.1 + noise * rng.standard_normal(20)
    one = [Strength("amplitude", "mm", s, s - half, s + half, signed=False, single=True, alike=0.1) for s in read]
    pooled = mean_strength(one)
    assert pooled is not None
    assert pooled.interval.low < 1.0 < pooled.interval.high
    assert pooled.interval.high - pooled.interval.low == pytest.approx(2.0 * 1.645 * 0.1 * 1.1, rel=0.05)
    assert pooled.between < 0.02


def test_members_without_a_gap_share_nothing() -> None:
    alarms = sum(in_common(members([0.0] * 4, seed)).present for seed in range(10, 14))
    assert alarms <= 1


def test_causes_of_their_own_are_not_shared() -> None:
    different = [members([size], seed, name)[0] for seed, name, size in ((4, "ripple", 0.1), (5, "offset", 0.2))]
    calm = [members([0.0], seed)[0] for seed in range(6, 11)]
    cohort = in_common([*different, *calm])
    assert cohort.present
    assert cohort.unshared > 0.1
    assert all(c.prevalence.value < 0.5 for c in cohort.causes)


@pytest.mark.parametrize(("holders", "shared"), [(2, False), (5, True)])
def test_that_two_could_have_the_same_of_many_causes_is_no_wonder(holders: int, shared: bool) -> None:
    """Of six data sets each has a gap of its own; some have one as likely, which is the same."""

    def one(i: int) -> Member:
        evidence = {f"cause{k}": -4.0 for k in range(28)} | {f"cause{i}": 15.0}
        return Member(f"m{i}", 0.001, evidence | ({"cause20": 15.0} if i < holders else {}), {}, {}, NOISE)

    cohort = in_common([one(i) for i in range(6)])
    assert cohort.present
    assert cohort.causes[0].label == "cause20"
    assert (cohort.unshared < 0.5) == shared
    assert cohort.kind == ("named" if shared else "unknown")


def test_none_is_shared_or_any_cause_alike_beforehand() -> None:
    """Where members say nothing of any."""
    members = [Member(f"m{i}", 0.001, {f"cause{k}": 0.0 for k in range(28)}, {}, {}, NOISE) for i in range(6)]
    assert in_common(members).unshared == pytest.approx(0.5, abs=0.02)


def member(label: str, evidence: float, strength: float, *, single: bool = True) -> Member:
    """A data set whose offset has this evidence and strength, with an error of 1, beside an effect that it lacks."""
    width = 1.6448536269514722
    found = Strength("amplitude", "1", strength, strength - width, strength + width, signed=True, single=single)
    return Member(label, 0.05, {"offset": evidence, "ripple": -3.0}, {"offset": found}, {}, NOISE)


def told(*strengths: float, single: bool = True) -> float:
    """Log evidence that all share the offset, each as sure of it as its strength is of its sign."""
    each = [member(f"m{i}", float(two_sided(np.array(s))), s, single=single) for i, s in enumerate(strengths)]
    return next((c.log_evidence for c in in_common(each).causes if c.label == "offset"), 0.0)


def test_strengths_that_agree_speak_for_a_cause_that_is_shared() -> None:
    """As strong and as sure in each; of one sign or of both."""
    alike, mixed = told(2.5, 2.4, 2.6, 2.5), told(2.5, -2.4, 2.6, -2.5)
    apart = told(2.5, 2.4, 2.6, 2.5, single=False)
    assert apart == pytest.approx(told(2.5, -2.4, 2.6, -2.5, single=False), abs=1e-9)
    assert alike > apart + 1.0
    assert apart - np.log(2.0) - 1e-9 <= mixed < apart


def test_evidence_is_the_integral_over_prevalence_strength_and_spread() -> None:
    """Against sums over a finer grid of strengths, of data whose likelihood is normal."""
    strengths = np.array([3.0, 2.0, 3.5])
    own = two_sided(strengths)
    members = [member(f"m{i}", float(e), float(s)) for i, (e, s) in enumerate(zip(own, strengths, strict=True))]
    background = np.stack([m.background for m in members], axis=-1)
    prevalences, means = np.linspace(0.15, 0.99, 43), np.geomspace(0.8, 80.0, 2000)
    logs = []
    for mean in np.concatenate([means, -means]):
        for spread in (0.2, 0.4):
            wide = (spread * mean) ** 2 + 1.0
            logs.append(0.5 * strengths**2 - 0.5 * np.log(wide) - 0.5 * (strengths - mean) ** 2 / wide)
    common = _mixed(np.array(logs), background, prevalences)
    expected = np.logaddexp(common, _mixed(own[None], background, prevalences)) - np.log(2.0)
    assert told(*strengths) == pytest.approx(expected, abs=0.03)


def _mixed(own: np.ndarray, background: np.ndarray, prevalences: np.ndarray) -> float:
    """Over prevalences, values in common, and how often members have a gap of another cause."""
    without, count = np.exp(background[:, None, None]), own.shape[-1]
    p = prevalences[:, None, None]
    each, p1 = (1 - p) * without + p * np.exp(own), prevalences[:, None]
    few = ((1 - p) * without).prod(axis=-1) * (1 + (p / (1 - p) * np.exp(own) / without).sum(axis=-1))
    two = 1 - (1 - p1) ** count - count * p1 * (1 - p1) ** (count - 1)
    shared = (each.prod(axis=-1) - few) / two
    return float(np.log(shared.mean(axis=(1, 2)).sum() / without.prod(axis=-1).sum()))


def test_a_pair_that_one_member_has_is_not_what_all_share() -> None:
    """However far it is ahead there: what any data set may have holds pairs too."""
    usual = [member(f"m{i}", 6.0, 3.0) for i in range(5)]
    odd = Member("odd", 0.01, {"offset": 20.0, "ripple": 10.0, "ripple+tilt": 300.0}, {}, {}, NOISE)
    assert in_common([*usual, odd]).chosen == ("offset",)
    assert in_common([*usual, odd]).causes[0].carriers[-1] < 0.1


def told_of(evidence: list[dict[str, float]], unnamed: float | list[float] = -3.0) -> Cohort:
    """Members with this evidence of some causes, and little of thirty others."""
    usual = {f"cause{k}": -1.0 for k in range(30)}
    of_none = [unnamed] * len(evidence) if isinstance(unnamed, float) else unnamed
    return in_common(
        [
            Member(f"m{i}", 0.001, usual | each, {}, {}, NOISE, none)
            for i, (each, none) in enumerate(zip(evidence, of_none, strict=True))
        ]
    )


def test_two_causes_in_two_groups_are_both_named() -> None:
    """Each with its own members; what looks like the first is its alternative, not the second group's."""
    one, other, neither = {"cause1": 20.0, "cause2": 19.5}, {"cause3": 15.0}, {}
    order = [one, other, neither, one, other, one, other, neither, one, other]
    cohort = told_of(order)
    found = {group.chosen: group.causes[0].carriers > 0.5 for group in cohort.groups}
    assert set(found) == {("cause1", "cause2"), ("cause3",)}
    np.testing.assert_array_equal(found["cause1", "cause2"], [each == one for each in order])
    np.testing.assert_array_equal(found["cause3",], [each == other for each in order])
    assert cohort.further == cohort.groups[1:]
    assert cohort.unnamed is None


def test_one_cause_in_all_is_no_second_one() -> None:
    cohort = told_of([{"cause1": 15.0, "cause2": 12.0}] * 8)
    assert len(cohort.groups) == 1
    assert cohort.further == ()
    assert cohort.chosen[0] == "cause1"


def test_members_of_whom_no_name_explains_the_gap_share_one_of_no_name() -> None:
    """However far ahead of no gap the best name is in each."""
    cohort = told_of([{"cause1": 12.0}, {"cause1": 25.0}, {"cause1": 8.0}, {"cause1": 17.0}], [18.0, 32.0, 14.0, 20.0])
    assert cohort.kind == "unknown"
    assert cohort.chosen == ()
    assert cohort.unnamed is not None
    assert (cohort.unnamed.carriers > 0.9).all()


def test_a_gap_of_no_name_may_stand_beside_a_shared_cause() -> None:
    cohort = told_of([{"cause1": 20.0}] * 5 + [{"cause2": 8.0}] * 4, [5.0] * 5 + [20.0] * 4)
    assert cohort.chosen == ("cause1",)
    assert cohort.unnamed is not None
    np.testing.assert_array_equal(cohort.unnamed.carriers > 0.5, [False] * 5 + [True] * 4)


def test_one_member_with_a_gap_of_no_name_shares_it_with_none() -> None:
    cohort = told_of([{}] * 7, [40.0] + [-3.0] * 6)
    assert cohort.unnamed is None
    assert cohort.unshared > 0.5


def test_sizes_in_other_channels_or_units_have_no_mean() -> None:
    one = Strength("amplitude", "1", 0.1, 0.05, 0.15, signed=True, single=False, channel="putamen")
    assert mean_strength([one, replace(one, value=0.12)]) is not None
    assert mean_strength([one, replace(one, channel="lesion")]) is None
    assert mean_strength([replace(one, single=True), replace(one, single=True, unit="mm")]) is None
