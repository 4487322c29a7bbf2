"""A small blind check: effects withheld from the simulator, made by an independent generator, named by the diagnosis.

Strengths are set by d', what is left of an effect after everything else is refitted, in units of the noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
import torch

from petkin.diagnosis import DRIVE, SWINGING, Diagnosis, Term, diagnose
from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.refit import State, refit
from petkin.dynamics import PiecewiseLinear
from petkin.effects import EFFECTS, effect_named
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs import InputFunction
from petkin.study.diagnosis.blood import read_at, reading_nodes
from petkin.study.diagnosis.hypotheses import hypotheses, hypothesis_of
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.sentences import sentence

from . import independent_scan as scan

PERCENT = 2.0
NOISES = ({"share": 0.0}, {"share": 0.3}, {"share": 0.6}, {"share": 0.0, "heavy": True})
#: Sizes from which each is scaled to its d'.
SINGLES = {
    "gain_step": {"size": 0.05, "onset": 33.0},
    "frame_duration": {"size": 0.1, "frame": 20.0},
    "dispersion": {"size": 8.0},
    "parent_fraction": {"size": 0.4},
    "vascular_trapping": {"size": 0.4},
    "attenuation_mismatch": {"size": 0.05, "onset": 41.0, "region": 3.0},
    "motion_step": {"size": 0.1, "onset": 26.0, "region": 2.0},
    "randoms_offset": {"size": 0.03},
    "interrupted_record": {"size": 0.01, "onset": 30.0},
    "motion_between": {"size": 0.1, "onset": 36.0},
    "alternating_gain": {"size": 0.02},
    "slipped_edge": {"size": 0.1, "frame": 20.0},
}
OURS = ("interrupted_record", "motion_between", "alternating_gain", "slipped_edge")
NAMED = tuple(name for name in SINGLES if name not in OURS)
FLAGS = ("mean_life_swap", "decay_applied_twice", "decay_not_applied")


@dataclass(frozen=True)
class Case:
    """One scan and what the diagnosis says of it."""

    answer: Diagnosis
    simulator: RegionalSimulator
    detectability: float


def simulator_of(truth: scan.Truth) -> RegionalSimulator:
    """2TCM with blood volume and delay, and blood as a laboratory records it: every second, then twice a minute."""
    last = truth.t.size - 1
    keep = np.unique(np.concatenate([np.arange(360), np.arange(360, last, 30), [last]]))
    t = torch.from_numpy(truth.t[keep])

    def lines(values: np.ndarray) -> PiecewiseLinear:
        return PiecewiseLinear(t, torch.from_numpy(np.ascontiguousarray(values[keep])))

    arterial = InputFunction(
        lines(truth.total * truth.parent),
        lines(truth.blood),
        total_plasma=lines(truth.total),
        parent_fraction=lines(truth.parent),
    )
    nodes = reading_nodes(arterial, float(scan.EDGES[-1]))
    clock = FrameObservation(FrameSchedule(scan.EDGES[:-1], scan.EDGES[1:]), scan.LAMBDA)
    included = (effect_named("blood_volume"), effect_named("arterial_delay"))
    return RegionalSimulator(scan.REGIONS, "2TCM", read_at(arterial, nodes), clock, included, nodes)


def detectability(simulator: RegionalSimulator, curves: np.ndarray, share: float) -> float:
    """d' of noise-free curves."""
    noise = Noise(scan.spread(curves), scan.noise_size(curves, PERCENT), share)
    start = State(simulator.starts[0], simulator.shared.mean)
    return float(np.sqrt(refit(simulator, curves, noise, start, iterations=20).chi2))


@cache
def case(seed: int, name: str = "", target: float = 0.0, noise: int = 0, onset: float | None = None) -> Case:
    rng = np.random.default_rng(7000 + seed)
    truth = scan.draw(rng)
    simulator = simulator_of(truth)
    asked = SINGLES.get(name, {}) | ({} if onset is None else {"onset": onset})
    effects = {name: asked} if name else {}
    share = float(NOISES[noise]["share"])
    if name in SINGLES:
        weak = detectability(simulator, scan.curves(replace(truth, effects=effects)), share)
        size = asked["size"] * target / weak
        effects = {name: {**asked, "size": min(size, 0.9) if name == "parent_fraction" else size}}
    curves = scan.curves(replace(truth, effects=effects))
    data = scan.noisy(curves, rng, percent=PERCENT, **NOISES[noise])  # type: ignore[arg-type]
    candidates = hypotheses(EFFECTS, simulator, without=frozenset())
    return Case(diagnose(simulator, data, candidates), simulator, detectability(simulator, curves, share))


def named(found: Case, name: str) -> bool:
    return found.answer.present and found.answer.causes[0].label == name


def test_the_simulator_reproduces_an_independent_one() -> None:
    """Without any effect, what is left after the refit is far below the noise."""
    for seed in range(3):
        truth = scan.draw(np.random.default_rng(seed))
        assert detectability(simulator_of(truth), scan.curves(truth), 0.0) < 0.7


def test_refits_begin_within_frames() -> None:
    """Between two frames a refit of an onset would stand on a kink."""
    simulator = simulator_of(scan.draw(np.random.default_rng(0)))
    frames = simulator.clock.frames
    found = hypotheses(EFFECTS, simulator, without=frozenset())
    settings = np.array([each["onset"] for h in found for each in h.settings if "onset" in each])
    assert {h.name for h in found if any(shape.kinked for shape in h.shapes)} >= {"gain_step", "attenuation_mismatch"}
    own = np.searchsorted(frames.start, settings, side="right") - 1
    passed = (settings - frames.start[own]) / frames.duration[own]
    assert len(settings) > 20
    assert 0.2 < passed.min() < passed.max() < 0.8


def test_a_blunder_is_rarer_than_an_effect() -> None:
    """What is there or not has no size to be averaged over, so that it would win every tie."""
    found = hypotheses(EFFECTS, simulator_of(scan.draw(np.random.default_rng(0))), without=frozenset())
    flags = {h.name for h in found if h.flag}
    assert flags >= {"mean_life_swap", "decay_applied_twice", "decay_not_applied"}
    assert {h.name for h in found if h.log_odds < 0} == flags
    assert all(h.log_odds == 0 for h in found if not h.flag)


def test_what_lies_beside_is_the_mean_of_others_or_one_of_them() -> None:
    """Half of the probability each; which one is as likely as another. Of many regions few are tried."""
    simulator = simulator_of(scan.draw(np.random.default_rng(0)))
    for name in ("partial_volume", "motion_step", "motion_drift"):
        found = hypothesis_of(effect_named(name), simulator)
        beside = np.array([each["beside"] for each in found.settings])
        probability = np.exp(found.told) / len(beside)
        assert sorted(set(beside)) == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
        assert [probability[beside == r].sum() for r in range(6)] == pytest.approx([0.5, *(5 * [0.1])])
    many = replace(simulator, channels=tuple(map(str, range(24))))
    assert {each["beside"] for each in hypothesis_of(effect_named("motion_drift"), many).settings} == {0.0, 1.0, 24.0}
    two = hypothesis_of(effect_named("motion_step"), replace(simulator, channels=scan.REGIONS[:2]))
    assert {each["beside"] for each in two.settings} == {0.0}
    assert two.told == ()


@pytest.mark.parametrize("seed", [90, 94, 95])
def test_tissue_in_an_image_derived_input_is_named(seed: int) -> None:
    """The record holds a fifth of the regions' own mean curve (d' 15, 8 and 40)."""
    rng = np.random.default_rng(7000 + seed)
    truth = scan.draw(rng)
    plasma = truth.total * truth.parent
    around = 0.2 * scan._tissue(truth.t, plasma, truth.rates, {}).mean(axis=0)
    recorded = replace(truth, total=truth.total + around / truth.parent, blood=truth.blood + around)
    data = scan.noisy(scan.curves(truth), rng, percent=1.0)
    simulator = simulator_of(recorded)
    found = diagnose(simulator, data, hypotheses(EFFECTS, simulator, without=frozenset()))
    assert found.present
    assert "input_partial_volume" in found.chosen


def test_a_frame_that_ended_late_is_named_with_the_next_one() -> None:
    """One frame has what the next one lacks: noise in common cannot do that as well, whatever its size."""
    for seed in range(4):
        (cause, *_) = case(80 + seed, "slipped_edge", 12.0, seed).answer.causes
        known = {e.symbol: e.value for e in cause.estimates}
        assert (cause.label, known["frame"], known["edge"]) == ("frame_duration", 20.0, 1.0)


def test_a_wrong_frame_is_seldom_one_whose_end_slipped() -> None:
    found = hypothesis_of(effect_named("frame_duration"), simulator_of(scan.draw(np.random.default_rng(0))))
    slipped = np.array([each["edge"] for each in found.settings]) > 0
    assert np.exp(found.told)[slipped].sum() / len(slipped) == pytest.approx(0.25)
    assert slipped.sum() == len(slipped) / 2


def test_motion_between_regions_is_in_the_set() -> None:
    """Where every region enters the next, some more than others, gains of each fit nearly as well."""
    found = [case(70 + seed, "motion_between", 12.0, seed % 4).answer for seed in range(8)]
    assert all("motion_step" in answer.chosen for answer in found)


def test_noise_is_not_called_a_gap() -> None:
    """Two scans of each kind of noise; of 8 at 5 percent, 2 or more happen once in 17 times."""
    assert sum(case(seed, noise=noise).answer.present for noise in range(4) for seed in range(2)) <= 1


def test_strong_effects_are_named() -> None:
    """At d' = 12 a matched filter names the class in 0.98; 8 effects, four kinds of noise in turn, five scans of each.

    Three quarters bear their own name, though a gain in one region and motion between regions fit some scans alike.
    """
    found = [(name, case(20 * k + i, name, 12.0, i % 4)) for k in (1, 3, 4, 5, 6) for i, name in enumerate(NAMED)]
    assert all(c.answer.present for _, c in found)
    assert sum(named(c, name) for name, c in found) >= 30


def test_a_scanner_that_changes_before_the_bolus_has_passed_is_named() -> None:
    """A step of the gain at 3 min, of a scan of a short bolus: five of six, and in its minute."""
    found = [case(60 + seed, "gain_step", 12.0, seed % 4, onset=3.0) for seed in range(6)]
    right = [c for c in found if named(c, "gain_step")]
    assert len(right) >= 5
    assert all(c.answer.onset is not None and abs(c.answer.onset - 3.0) < 1.0 for c in right)


@pytest.mark.parametrize("name", FLAGS)
def test_blunders_of_decay_are_named(name: str) -> None:
    found = case(40, name)
    assert found.answer.chosen[0] == name
    assert found.answer.stages["clock"] > 0.8


def test_onset_and_place_of_local_effects() -> None:
    found = case(25, "attenuation_mismatch", 12.0, 1)
    assert found.answer.onset == pytest.approx(41.0, abs=5.0)
    assert found.answer.regions.q_values.argmin() == 2


@pytest.mark.parametrize("seed", [50, 54, 56])
def test_an_input_that_departs_from_its_record_is_not_taken_for_kinetics(seed: int) -> None:
    """Tracer arrives for 8 min more than the record shows: all regions follow, as if their kinetics changed at once."""
    found = case(seed, "interrupted_record", 12.0, seed % 4).answer
    assert (found.kind, found.unknown_place) == ("unknown", DRIVE)
    assert "plasma input" in sentence(found)


@pytest.mark.parametrize("seed", range(4))
def test_a_gain_that_swings_from_frame_to_frame_is_not_taken_for_noise(seed: int) -> None:
    """Larger and smaller by turns: a few percent that all regions of a frame share, which only the rhythm betrays."""
    found = case(80 + seed, "alternating_gain", 12.0, seed).answer
    assert (found.kind, found.unknown_place) == ("unknown", SWINGING)
    assert "swings in all regions alike" in sentence(found)


def test_what_is_kept_of_predictions_changes_none() -> None:
    """Every effect twice, forwards and backwards through more than is kept, against a simulator that begins anew."""
    simulator = simulator_of(scan.draw(np.random.default_rng(4)))
    own, shared = simulator.starts[0], simulator.shared.mean
    count = len(simulator.channels)
    terms = [
        Term(h, np.full(count, h.typical) if h.by_channel else h.typical, setting)
        for h in hypotheses(EFFECTS, simulator, without=frozenset())
        for setting in h.settings[:8]
    ]
    for term in (*terms, *reversed(terms)):
        other = replace(simulator).predict(own, shared, (term,))
        np.testing.assert_array_equal(simulator.predict(own, shared, (term,)), other)


def test_what_drives_the_regions_passes_through_their_kinetics() -> None:
    """Against a simulator that is given the other input whole; a departure by a constant is a scale of C_P alone."""
    simulator = simulator_of(scan.draw(np.random.default_rng(3)))
    own, shared = simulator.starts[0], simulator.shared.mean
    nodes = torch.from_numpy(simulator.nodes)
    plasma = simulator.input.plasma(nodes).numpy()
    level = np.sqrt(plasma * np.trapezoid(plasma, simulator.nodes) / simulator.nodes[-1])
    course = np.exp(-0.5 * ((simulator.nodes - 40.0) / 5.0) ** 2)
    more = PiecewiseLinear(nodes, torch.from_numpy(plasma + 0.5 * course * level))
    other = replace(simulator, input=replace(simulator.input, plasma=more))
    expected = other.predict(own, shared) - simulator.predict(own, shared)
    found = 0.5 * simulator.driven(own, shared, lambda t: np.exp(-0.5 * ((t - 40.0) / 5.0) ** 2)[None])[0]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9 * expected.max())


def test_what_is_named_closes_the_gap() -> None:
    """Held out, without the selection: most of the excess goes, and the interval holds 1."""
    closed = [case(20 + i, name, 12.0, i % 4).answer.causes[0].closure for i, name in enumerate(NAMED)]
    values = [c.value for c in closed if c is not None]
    assert np.median(values) > 0.9


def test_an_effect_that_is_taken_out_is_not_in_the_answer() -> None:
    truth = scan.draw(np.random.default_rng(1))
    simulator = simulator_of(truth)
    names = {h.name for h in hypotheses(EFFECTS, simulator, without=frozenset({"gain_step"}))}
    assert "gain_step" not in names
    assert "blood_volume" not in names
    assert {"gain_drift", "motion_step", "mean_life_swap"} <= names


def test_the_scale_of_the_input_cannot_be_told() -> None:
    hidden = {v.hypothesis.name for v in case(0).answer.visible if v.invisible}
    assert "input_scale" in hidden
    drift = next(v for v in case(0).answer.visible if v.hypothesis.name == "gain_drift")
    assert dict(drift.partners)["half_life_error"] > 0.9
