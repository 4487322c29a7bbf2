"""The engine on a simulator that is no scan: it names, localises, sizes, and says what it cannot tell."""

from __future__ import annotations

import numpy as np
import pytest

from petkin.diagnosis import Diagnosis, Term, diagnose, indistinct

from .decaying_channels import HYPOTHESES, TRUTH, DecayingChannels, hypothesis, measured

SIMULATOR = DecayingChannels()


def found(*terms: Term, seed: int = 1, share: float = 0.0, sd: float = 0.05) -> Diagnosis:
    data = measured(np.random.default_rng(seed), *terms, share=share, sd=sd)
    return diagnose(SIMULATOR, data, HYPOTHESES, seed=seed, draws=200)


def local_step(size: float) -> Term:
    return Term(hypothesis("local step"), np.array([0.0, 0.0, size, 0.0]), {"onset": 5.0})


PRESENT = {
    "offset": Term(hypothesis("offset"), 0.2, {}),
    "step": Term(hypothesis("step"), 0.1, {"onset": 4.0}),
    "local step": local_step(0.25),
    "ripple": Term(hypothesis("ripple"), 0.12, {"pitch": 1.6}),
    "clipped": Term(hypothesis("clipped"), 1.0, {}),
}


@pytest.mark.parametrize("name", PRESENT)
def test_what_is_missing_is_named_and_closes_the_gap(name: str) -> None:
    answer = found(PRESENT[name])
    assert answer.present
    assert answer.kind == "named"
    assert answer.chosen == (name,)
    closed = answer.causes[0].closure
    assert closed is not None
    assert closed.value > 0.9
    assert 0 <= closed.low <= closed.value <= closed.high <= 1


@pytest.mark.parametrize("name", ["offset", "step", "local step"])
def test_its_size_is_found_with_its_error(name: str) -> None:
    amplitude = found(PRESENT[name]).causes[0].estimates[0]
    true = float(np.max(PRESENT[name].amplitude))
    width = (amplitude.high - amplitude.low) / (2 * 1.645)
    assert abs(amplitude.value - true) < 4 * width
    assert width < 0.3 * true


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_a_name_leaves_is_noise_unless_something_is_there_besides(seed: int) -> None:
    data = measured(np.random.default_rng(seed), Term(hypothesis("step"), 0.2, {"onset": 4.0}), sd=0.02)
    bump = 1.0 + 0.06 * np.exp(-0.5 * ((SIMULATOR.times - 7.0) / 0.8) ** 2)
    alone, beside = (diagnose(SIMULATOR, values, HYPOTHESES, draws=100).causes for values in (data, data * bump))
    assert (alone[0].label, beside[0].label) == ("step", "step")
    assert alone[0].left is not None
    assert beside[0].left is not None
    assert alone[0].left < 2.0
    assert beside[0].left > 10.0


def test_onset_and_region_of_a_local_effect() -> None:
    answer = found(local_step(0.25))
    assert answer.onset == pytest.approx(5.0, abs=0.5)
    assert np.flatnonzero(answer.regions.q_values <= 0.05).tolist() == [2]
    assert answer.regions.shares.argmax() == 2
    assert answer.regions.shares.sum() == pytest.approx(1.0)


def test_two_effects_are_both_named() -> None:
    answer = found(PRESENT["offset"], PRESENT["ripple"], sd=0.03)
    assert answer.causes[0].effects == ("offset", "ripple")


@pytest.mark.parametrize("share", [0.0, 0.6])
def test_noise_alone_is_rarely_called_a_gap(share: float) -> None:
    """At 5 percent, 24 draws hold more than 4 false alarms once in 200 times."""
    alarms = sum(found(seed=seed, share=share).present for seed in range(24))
    assert alarms <= 4


def test_none_means_no_causes_and_no_set() -> None:
    answer = next(a for a in (found(seed=s) for s in range(5)) if not a.present)
    assert answer.kind == "none"
    assert answer.causes == ()
    assert answer.chosen == ()


def test_what_the_refit_absorbs_is_told_in_advance() -> None:
    names = [n for n, _ in indistinct(found(PRESENT["offset"]).visible)]
    assert ("scale",) in names
    assert ("offset",) not in names


def test_a_gap_of_no_name_is_unknown() -> None:
    rng = np.random.default_rng(3)
    t = SIMULATOR.times
    bump = 0.6 * np.sin(1.1 * np.log(t + 1.0) * 3.0)[None] * np.array([[1.0], [-0.7], [0.4], [1.2]])
    data = measured(rng) + bump
    answer = diagnose(SIMULATOR, data, HYPOTHESES[:2], draws=100)
    assert answer.kind == "unknown"
    assert answer.chosen == ()
    assert answer.unknown > 0.5


def test_a_withheld_effect_is_nowhere_in_the_answer() -> None:
    data = measured(np.random.default_rng(1), PRESENT["step"])
    rest = [h for h in HYPOTHESES if h.name != "step"]
    answer = diagnose(SIMULATOR, data, rest, draws=100)
    assert answer.present
    assert all("step" not in cause.effects for cause in answer.causes)


def test_probabilities_exclude_one_another() -> None:
    answer = found(PRESENT["ripple"])
    assert sum(c.probability for c in answer.causes) + answer.unknown <= 1 + 1e-9
    assert answer.set_probability == pytest.approx(
        sum(c.probability for c in answer.causes if c.label in answer.chosen)
    )


def test_the_same_seed_gives_the_same_answer() -> None:
    one, two = found(PRESENT["step"], seed=4), found(PRESENT["step"], seed=4)
    assert one.p_value == two.p_value
    assert [(c.label, c.probability, c.closure) for c in one.causes] == [
        (c.label, c.probability, c.closure) for c in two.causes
    ]


def test_parameters_move_back_to_the_truth() -> None:
    answer = found(PRESENT["offset"], sd=0.02)
    fit = answer.causes[0].fit
    assert fit is not None
    before, after = np.abs(answer.base.state.own - TRUTH).max(), np.abs(fit.state.own - TRUTH).max()
    assert after < 0.3 * before
