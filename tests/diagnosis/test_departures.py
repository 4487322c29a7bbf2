"""Gaps of no name beside the channels: seen where they are, silent in noise, and weighed against names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from petkin.diagnosis import WITHIN, Departure, Elsewhere, Family, Pattern, judge_contrasts
from petkin.diagnosis.departures import _Scored, judge_departures
from petkin.diagnosis.families import root

PLACES, ROWS, SAMPLES, DRAWS = 6, 3, 20, 200
TIMES = np.linspace(0.2, 60.0, SAMPLES)
CURVE = 20.0 * np.exp(-TIMES / 40.0)
#: A unit gain in a place adds the curve to that place's rows.
ADDED = np.kron(np.eye(PLACES)[:, :, None], np.ones((1, ROWS, 1))) * CURVE
NO_PARTS = ADDED[:0]
#: What rows may hold of it all the time, each for itself.
ALWAYS = 10.0 * np.eye(PLACES * ROWS)[:, :, None] * CURVE


def departure(gap: np.ndarray, rng: np.random.Generator, noise: float = 1.0) -> Departure:
    """Rows with noise, of which the judge expects 1, what is always there, and a gap (places, K)."""
    rows = noise * rng.standard_normal((PLACES * ROWS, SAMPLES))
    rows += np.tensordot(rng.standard_normal(len(ALWAYS)), ALWAYS, 1)
    rows += np.einsum("bk,bjk->jk", gap, ADDED)
    return Departure(Family.of(rows, ALWAYS, np.eye(len(rows)), 1e-9), ADDED, TIMES, NO_PARTS)


def judged(each: Departure, rng: np.random.Generator) -> tuple[float, np.ndarray]:
    return judge_departures([each], draws=DRAWS, rng=rng)[:2]


def swelling(*places: int) -> np.ndarray:
    gap = np.zeros((PLACES, SAMPLES))
    gap[list(places)] = 0.3 * np.sin(np.pi * TIMES / 60.0)
    return gap


@pytest.mark.parametrize("places", [(2,), (0, 4)])
def test_a_smooth_gap_is_seen_in_one_place_or_in_two(places: tuple[int, ...]) -> None:
    rng = np.random.default_rng(2)
    found, null = judged(departure(swelling(*places), rng), rng)
    assert found > 10.0
    assert found > null.max()


def test_how_places_are_mixed_does_not_matter_to_what_is_as_visible_any_way() -> None:
    """Places taken together otherwise are the same places."""
    rng = np.random.default_rng(6)
    mixing = rng.standard_normal((PLACES, PLACES))
    one = departure(swelling(1, 3), rng)
    other = replace(one, added=np.einsum("ab,bjk->ajk", mixing, one.added))
    found = []
    for each in (one, other):
        scored = _Scored.of(each, {})[0]
        found.append(scored.evidence(scored.score, 1.0)[2])
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6)
    assert (found[0] > 5.0).all()


def test_a_gap_in_a_part_is_seen_where_no_place_alone_shows_it() -> None:
    """As a gap of several places of any size the same scores show less, which parts do not change."""
    rng = np.random.default_rng(12)
    part = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    gap = 0.12 * part[:, None] * np.sin(np.pi * TIMES / 60.0)
    without, null = departure(gap, rng), departure(swelling(), rng)
    parts = np.einsum("b,bjk->jk", part, ADDED)[None]
    whole = replace(without, parts=parts)
    (before, _), (after, drawn) = (judged(each, np.random.default_rng(13)) for each in (without, whole))
    assert after > before + 3.0
    assert after > drawn.max()
    plain, kept = (_Scored.of(each, {})[0] for each in (without, whole))
    assert plain.misfits() == pytest.approx(kept.misfits())
    for one, other in zip(plain.evidence(plain.score, 1.0)[1:], kept.evidence(kept.score, 1.0)[1:], strict=True):
        np.testing.assert_allclose(one, other)
    assert judged(replace(null, parts=parts), rng)[0] < 1.0


def test_a_part_that_nothing_shows_has_no_evidence() -> None:
    rng = np.random.default_rng(14)
    each = departure(swelling(2), rng)
    found, null = judged(replace(each, parts=0.0 * ADDED[:1]), np.random.default_rng(13))
    without, _ = judged(each, np.random.default_rng(13))
    assert np.isfinite(null).all()
    assert without - np.log(2.0) < found <= without + 1e-9


def test_noise_has_no_evidence_of_what_is_as_visible_any_way() -> None:
    """A likelihood ratio of 20 in less than a twentieth of draws; here in a hundredth."""
    rng = np.random.default_rng(7)
    scored = _Scored.of(departure(swelling(), rng), {})[0]
    drawn = rng.standard_normal((4000, len(scored.score))) @ root(scored.information)
    ratio = np.exp(scored.evidence(drawn, 1.0)[2])
    assert (np.mean(ratio >= 20.0, axis=0) <= 0.01).all()
    assert (np.median(ratio, axis=0) > 0.01).all()
    assert (np.median(ratio, axis=0) < 0.5).all()


def moving(rng: np.random.Generator) -> np.ndarray:
    """What a motion adds to one place (1, J, K)."""
    return rng.standard_normal((1, PLACES * ROWS, 1)) * np.repeat(np.arange(PLACES) < 1, ROWS)[:, None] * CURVE


def test_what_a_name_explains_is_no_gap_beside_it() -> None:
    """A head that moves: what that adds by its size and by its square, with its course."""
    rng = np.random.default_rng(8)
    course = np.clip(TIMES / 60.0, 0.0, 1.0)
    by, squared = moving(rng), moving(rng)
    moved = 0.5 * by[0] * course + 0.3 * squared[0] * course**2

    def seen(rows: np.ndarray) -> tuple[float, float]:
        each = departure(swelling(), np.random.default_rng(9))
        each = replace(each, held={"motion": (by, squared)}, family=replace(each.family, rows=each.family.rows + rows))
        found, _, left = judge_departures([each], {"motion": course}, draws=DRAWS, rng=rng)
        return found, left["motion"]

    alone, beside = seen(moved), seen(moved + np.einsum("bk,bjk->jk", swelling(2), ADDED))
    assert alone[0] > 10.0 > 0.0 > alone[1]
    assert beside[0] > beside[1] > 10.0


def test_a_gap_of_no_name_is_no_surer_than_a_name_with_what_that_leaves() -> None:
    rng = np.random.default_rng(10)
    course = np.clip(TIMES / 60.0, 0.0, 1.0)
    by = moving(rng)
    each = departure(swelling(), rng)
    family = replace(each.family, rows=each.family.rows + 0.5 * by[0] * course)
    pattern = Pattern("motion", "x", np.ones((ROWS, 1)) * course, {}, course=course)
    rows = 1.2 * np.ones((ROWS, 1)) * course + rng.standard_normal((ROWS, SAMPLES))
    families = {"x": Family.of(rows, np.zeros((1, ROWS, SAMPLES)), np.eye(ROWS), 1e-9)}
    free, held = (
        judge_contrasts(families, [pattern], [one], draws=DRAWS, rng=np.random.default_rng(11))
        for one in (replace(each, family=family), replace(each, family=family, held={"motion": (by, by[:0])}))
    )
    assert free.p_value == held.p_value
    assert free.unnamed is not None
    assert held.unnamed is not None
    assert 0.0 < held.unnamed < held.evidence["motion"] < free.unnamed


def test_what_is_always_there_is_no_gap() -> None:
    rng = np.random.default_rng(3)
    gap = np.zeros((PLACES, SAMPLES))
    gap[1] = 0.4
    found, null = judged(departure(gap, rng), rng)
    assert found < np.quantile(null, 0.97)


def test_more_noise_than_expected_in_all_places_is_no_gap() -> None:
    rng = np.random.default_rng(4)
    evidence = [judged(departure(swelling(), rng, noise=1.6), rng)[0] for _ in range(20)]
    assert np.median(evidence) < 0.0


def test_p_values_of_noise_are_not_too_small() -> None:
    rng = np.random.default_rng(5)
    step = Pattern("step", "x", np.ones((ROWS, 1)) * (TIMES > 30.0), {"onset": 30.0})
    found = []
    for _ in range(150):
        rows = rng.standard_normal((ROWS, SAMPLES))
        families = {"x": Family.of(rows, np.zeros((1, ROWS, SAMPLES)), np.eye(ROWS), 1e-9)}
        one = departure(swelling(), rng)
        found.append(judge_contrasts(families, [step], [one], draws=DRAWS, rng=rng).p_value)
    assert np.mean(np.array(found) <= 0.05) <= 0.09
    assert 0.3 <= np.mean(np.array(found) <= 0.5) <= 0.6


#: What a gap of no name needs beyond the evidence of channels where somebody looked beside them.
RARER = 1.4


def test_nothing_beside_the_channels_costs_a_gap_of_no_name_a_bit() -> None:
    silent = Elsewhere(-3.0, {})
    assert silent.joined(20.0) == pytest.approx(20.0 - np.log(2.0) - RARER, abs=0.03)
    assert silent.place(20.0, "drive") == "drive"


def test_a_gap_beside_the_channels_is_there() -> None:
    loud = Elsewhere(30.0, {})
    assert loud.joined(-2.0) == pytest.approx(30.0 - np.log(4.0) + np.log1p(np.exp(-2.0)) - RARER, abs=0.01)
    assert loud.place(-2.0, "alike") == WITHIN


def test_a_name_that_was_seen_there_too_keeps_what_it_explains() -> None:
    seen = Elsewhere(30.0, {"tilt": 40.0, "blur": 12.0})
    assert seen.beyond(("tilt",)) == 0.0
    assert seen.beyond(("blur", "delay")) == pytest.approx(18.0)
    assert seen.beyond(("delay",)) == pytest.approx(30.0)
