"""Parts taken out of the engine, and a network in its place: what is taken out is gone, and comes back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from petkin.diagnosis import noise
from petkin.diagnosis.effect import Hypothesis
from petkin_bench.withheld import network
from petkin_bench.withheld.ablations import PARTS, without
from petkin_bench.withheld.cases import case
from petkin_bench.withheld.network import LABELS, network_verdict, train_network

OFFSET = Hypothesis("offset", "imaging", "a", "1", -0.05, 0.05)


def test_without_ranges_a_strength_is_free_and_then_it_is_not() -> None:
    before = OFFSET.width, OFFSET.limits
    with without("priors"):
        assert OFFSET.width > 10.0
        assert OFFSET.limits == (-0.95, 0.95)
    assert (OFFSET.width, OFFSET.limits) == before == (pytest.approx(0.075), pytest.approx((-0.15, 0.15)))


def test_without_common_noise_none_is_found() -> None:
    together = np.ones((4, 1)) * np.random.default_rng(0).standard_normal((1, 40))
    apart = together + 0.5 * np.random.default_rng(1).standard_normal((4, 40))
    assert noise.common_share(together) > 0.5
    assert noise.with_factor(apart, 40.0, np.ones((4, 40)))[1] > 0.5
    with without("common_noise"):
        assert noise.common_share(together) == 0.0
        size, share = noise.with_factor(apart, 40.0, np.ones((4, 40)))
        assert share == 0.0
        assert size == pytest.approx(np.sqrt(np.mean(apart**2)))


def test_a_whole_engine_stays_whole() -> None:
    with without(""):
        assert OFFSET.limits == (pytest.approx(-0.15), pytest.approx(0.15))
    assert {"projection", "priors", "common_noise", "pairs"} == set(PARTS)


def test_a_network_learns_is_kept_and_judges(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network, "_STEPS", 3)
    path = tmp_path / "network.safetensors"
    train_network(path, seed=0, count=4, regions=3)
    told = network_verdict(case("training", 1, 0, 3)[0], path)
    assert told == network_verdict(case("training", 1, 0, 3)[0], path) | {"seconds": told["seconds"]}
    assert told["verdict"] in ("none", "named", "ambiguous", "unknown")
    assert told["leader"] in LABELS
