"""P-values of several data sets together: those of noise are uniform; many weak gaps, few strong ones, one alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from petkin.diagnosis.any_gap import any_gap
from petkin.diagnosis.detect import AgainstNoise
from petkin.diagnosis.evidence import two_sided

NAMES = ("offset", "ripple", "tilt", "")


def told(seed: int, strength: float = 0.0, names: tuple[str, ...] = NAMES) -> AgainstNoise:
    """A data set whose first hypothesis is true at this many standard errors."""
    rng = np.random.default_rng(seed)
    found = rng.standard_normal(len(names)) + strength * np.eye(len(names))[0]
    return AgainstNoise(names, two_sided(found), two_sided(rng.standard_normal((300, len(names)))))


def p_of(*each: AgainstNoise) -> float:
    return any_gap([one.p_value for one in each], each)


@pytest.mark.parametrize("members", [3, 12])
def test_p_values_of_noise_are_uniform(members: int) -> None:
    found = np.array([p_of(*(told(1000 * k + i) for i in range(members))) for k in range(200)])
    assert np.mean(found <= 0.03) <= 0.065
    assert np.mean(found <= 0.03) >= 0.005
    assert np.mean(found) == pytest.approx(0.5, abs=0.06)


def test_one_gap_among_many_without() -> None:
    """Fisher's p-value alone does not see it: sixteen without and one of 1 in 301 are what noise gives often."""
    fisher = []
    for k in range(9):
        each = [told(100 * k + i, 9.0 if i == 16 else 0.0) for i in range(17)]
        assert p_of(*each) < 0.02
        fisher.append(chi2.sf(-2.0 * np.log([one.p_value for one in each]).sum(), 34))
    assert np.median(fisher) > 0.05


def test_many_weak_gaps() -> None:
    weak = [told(i, 2.2) for i in range(12)]
    assert np.median([one.p_value for one in weak]) > 0.03
    assert p_of(*weak) < 0.003


def test_gaps_that_are_not_the_same() -> None:
    """Each has another one: their p-values see it."""
    each = [told(i, 3.0, (f"cause{i}", *NAMES)) for i in range(8)]
    assert p_of(*each) < 0.01


def test_hypotheses_that_only_some_know_say_nothing_of_the_others() -> None:
    one = told(1, 0.0, ("offset", "ripple"))
    found = one.of(("blur", "ripple"))
    assert (found[:, 0] == 0.0).all()
    np.testing.assert_array_equal(found[:, 1], [one.found[1], *one.drawn[:, 1]])


def test_draws_have_the_p_values_of_their_ranks() -> None:
    p = told(2).p_values
    np.testing.assert_allclose(np.sort(p), np.arange(1, 301) / 300)


def test_a_witness_of_other_data_is_heard() -> None:
    """A gap that it alone sees, of a hypothesis or of a name of its own, counts; its draws are those of noise."""
    rng = np.random.default_rng(5)
    quiet = [told(i) for i in range(6)]
    for name in ("ripple", "elsewhere"):
        said = {name: np.append(9.0, two_sided(rng.standard_normal(100))), "tilt": two_sided(rng.standard_normal(101))}
        heard = [quiet[0].witnessed(said, rng, times=1.0), *quiet[1:]]
        assert heard[0].found[heard[0].names.index(name)] > 6.0
        assert len(heard[0].drawn) == len(quiet[0].drawn)
        assert any_gap([one.p_value for one in quiet], heard) < 0.02 < p_of(*quiet)
    assert quiet[0].witnessed({}, rng, times=2.0) is quiet[0]


def test_a_p_value_counts_as_often_as_the_most_doubtful_witness_makes_it() -> None:
    weak = [told(i, 2.2) for i in range(12)]
    doubted = [*weak[:-1], replace(weak[-1], times=2.5)]
    assert p_of(*doubted) == pytest.approx(2.5 * p_of(*weak))
