"""What a verdict says in words where no gap is claimed, and of noise alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from petkin.diagnosis import Cause, Diagnosis, Estimate, diagnose
from petkin.study.diagnosis.answer import cause_entry
from petkin.study.diagnosis.sentences import sentence

from .decaying_channels import HYPOTHESES, DecayingChannels, measured


@pytest.fixture(scope="module")
def calm() -> Diagnosis:
    """Noise alone, of its own in every channel."""
    return diagnose(DecayingChannels(), measured(np.random.default_rng(3)), HYPOTHESES, draws=100)


def test_no_gap(calm: Diagnosis) -> None:
    assert calm.kind == "none"
    said = sentence(replace(calm, noise=replace(calm.noise, share=0.1)))
    assert said == f"The simulator explains these data: no gap beyond the noise (p = {calm.p_value:.2g})."


def test_a_p_value_near_the_limit_says_where_that_is(calm: Diagnosis) -> None:
    near = replace(calm, noise=replace(calm.noise, share=0.1), p_value=0.041)
    assert sentence(near).endswith("no gap beyond the noise (p = 0.041; a gap is claimed at 0.03).")


def test_what_could_hide_is_said_where_noise_is_shared_or_a_region_alone(calm: Diagnosis) -> None:
    assert "56% of the noise, could hide a change of all." in sentence(
        replace(calm, noise=replace(calm.noise, share=0.56))
    )
    assert "one region says little of its own noise" in sentence(replace(calm, channels=("a",)))


def test_a_p_value_that_draws_cannot_tell_is_no_number(calm: Diagnosis) -> None:
    found = replace(calm, present=True, p_value=1.0 / 101.0)
    assert "(p <= 0.0099)" in sentence(found)
    assert "(p = 0.02)" in sentence(replace(found, p_value=0.02))


def test_a_law_of_noise_is_no_share_of_a_gap(calm: Diagnosis) -> None:
    size = Estimate("amplitude", "1", 0.692, 0.5, 0.9, effect="noise_variance")
    alone = Cause(("noise_variance",), ("noise",), 0.95, 20.0, (size,))
    found = replace(calm, present=True, causes=(alone,), chosen=("noise_variance",))
    assert sentence(found) == (
        "Noise variance of 0.692 (0: as counts, 1: one size in all frames); no gap in the mean is claimed."
    )


@pytest.mark.parametrize(("left", "said"), [(None, ""), (1.3, ""), (13.6, " What that leaves is more than noise ")])
def test_what_a_cause_leaves_is_said_where_it_is_no_noise(calm: Diagnosis, left: float | None, said: str) -> None:
    step = Cause(("gain_step",), ("imaging",), 0.97, 20.0, (Estimate("amplitude", "1", 0.1, 0.09, 0.11),), left=left)
    found = replace(calm, present=True, causes=(step,), chosen=("gain_step",))
    first, second = sentence(found)[: len("Gain step of 0.1.")], sentence(found)[len("Gain step of 0.1.") :]
    assert first == "Gain step of 0.1."
    assert second.startswith(said)
    assert bool(second) == bool(said)
    assert cause_entry(step).get("log_evidence_left") == left
