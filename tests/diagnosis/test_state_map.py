"""Claims of a map of what a law lacks: held under noise, made where data ask, not where only members have learned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from petkin.diagnosis import Noise, StateMap, Witness, map_states

C, K, V = 2, 12, 3
NOISE = Noise(np.linspace(1.0, 2.0, C * K).reshape(C, K), np.array([0.3, 0.5]), 0.4)
_BASIS = np.linalg.qr(np.random.default_rng(1).standard_normal((K, V)))[0]
#: What members read of a curve: its part along a few directions.
READING = np.broadcast_to(_BASIS @ _BASIS.T, (C, K, K))


def drawn(rng: np.random.Generator, count: int) -> np.ndarray:
    return NOISE.coloured(rng.standard_normal((count, C * K)))


def members(left: np.ndarray, rng: np.random.Generator, bias: float = 0.0) -> list[Witness]:
    """Five that read what is left, each a little off, and all of them by so much too high."""
    found = []
    for _ in range(5):
        term = np.einsum("ckl,cl->ck", READING, left) + bias + 0.02 * rng.standard_normal((C, K))
        unread = left - np.einsum("ckl,cl->ck", READING, left)
        root = np.broadcast_to(0.3 * _BASIS, (C, K, V))
        found.append(Witness(term, root, unread, READING, READING, np.zeros((C, K))))
    return found


def mapped(left: np.ndarray, seed: int, bias: float = 0.0) -> StateMap:
    rng = np.random.default_rng((seed, 9))
    return map_states(members(left, rng, bias), left, drawn(rng, 300), NOISE, rng)


def test_noise_is_coloured_as_it_is_whitened() -> None:
    white = np.random.default_rng(0).standard_normal((7, C * K))
    np.testing.assert_allclose(NOISE.whiten(NOISE.coloured(white)), white, atol=1e-12)


@pytest.mark.parametrize("bias", [0.0, 3.0])
def test_noise_alone_is_seldom_claimed_whatever_members_have_learned(bias: float) -> None:
    rng = np.random.default_rng(3)
    maps = [mapped(left, seed, bias) for seed, left in enumerate(drawn(rng, 120))]
    assert sum(m.claimed.any() for m in maps) <= 12  # 5 % of 120, and two standard deviations
    assert abs(np.mean([m.evidence for m in maps])) < 0.5
    if bias:
        assert any((m.low > 0).any() for m in maps), "bands alone would claim"


def test_what_is_there_is_claimed_with_its_sign() -> None:
    left = drawn(np.random.default_rng(5), 1)[0]
    left[0] += 30.0 * _BASIS[:, 0]
    found = mapped(left, 0)
    assert found.claimed[0].any()
    assert not found.claimed[1].any()
    assert (np.sign(found.term[0]) == np.sign(_BASIS[:, 0]))[found.claimed[0]].all()
    assert ((found.low > 0) | (found.high < 0))[found.claimed].all()
    assert found.p_value < 0.01
    assert found.evidence > 50


def test_a_term_against_what_the_data_ask_for_is_no_claim() -> None:
    rng = np.random.default_rng(6)
    left = drawn(rng, 1)[0] + 30.0 * _BASIS[:, 0]
    turned = [replace(m, term=-m.term) for m in members(left, rng)]
    assert not map_states(turned, left, drawn(rng, 300), NOISE, rng).claimed.any()


def test_members_that_differ_widen_the_band() -> None:
    rng = np.random.default_rng(7)
    left = drawn(rng, 1)[0]
    alike = members(left, rng)
    apart = [replace(m, term=m.term + 5.0 * rng.standard_normal()) for m in alike]
    widths = [map_states(m, left, drawn(rng, 100), NOISE, rng) for m in (alike, apart)]
    assert ((widths[1].high - widths[1].low) > (widths[0].high - widths[0].low)).all()
