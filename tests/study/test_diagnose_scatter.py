"""The law of the noise: a flat one is named, any other is used without a word, counts and steps are left alone."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from petkin.diagnosis import base_fit, detect, diagnose
from petkin.effects import EFFECTS
from petkin.study.diagnose import diagnose_study
from petkin.study.diagnosis.hypotheses import hypotheses
from petkin.study.diagnosis.judging import diagnose_curves, law_of_noise, scattered
from petkin.study.diagnosis.noise_law import COUNTS, NoiseLaw, contrasts
from petkin.study.diagnosis.preparing import prepared, sources_of
from petkin.study.diagnosis.report import _law_of_noise
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.diagnosis.scatter import Scatter, as_voxels_scatter, evidence_without_gap, look_at_scatter
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings

SCHEMA = json.loads((files("petkin.reporting") / "schemas" / "gap-report-1.json").read_text())
INCLUDES = ("blood_volume", "arterial_delay")


def request_of(folder: Path, *effects: str, **options: object) -> DiagnoseRequest:
    given = {"out": folder / "study", "noise": 20.0, "tracer": "reversible", "effects": effects}
    study = simulate(SimulationSettings.model_validate(given))
    return DiagnoseRequest(study, include=INCLUDES, out=folder / "out", **options)  # type: ignore[arg-type]


def scatter_of(request: DiagnoseRequest, change: object = None) -> Scatter:
    _, _, (source,) = sources_of(request)
    curves, simulator = prepared(source, request)
    values = curves.values if change is None else curves.values * change
    return look_at_scatter(simulator, base_fit(simulator, values), seed=0)


def test_noise_that_is_the_same_always_is_named(tmp_path: Path) -> None:
    (one,) = diagnose_study(request_of(tmp_path, "noise_variance=1"))
    jsonschema.validate(one.answer, SCHEMA)
    leader = one.answer["causes"][0]
    assert "noise_variance" in one.answer["verdict"]["set"][0].split("+")
    key = "second_amplitude" if leader["effects"].index("noise_variance") else "amplitude"
    assert leader["estimate"][key]["value"] > 0.5
    assert "noise" in {stage["stage"] for stage in one.answer["where"]["stages"]}


def test_counts_are_left_alone_and_so_is_a_step(tmp_path: Path) -> None:
    request = request_of(tmp_path)
    assert not scatter_of(request).claimed
    late = np.where(np.arange(46) > 36, 1.3, 1.0)
    assert not scatter_of(request, late).claimed


def test_a_flat_law_is_that_of_voxels_too(tmp_path: Path) -> None:
    """A gap in the mean of a region makes its residuals uneven; voxels scatter as they did."""
    request = request_of(tmp_path, "noise_variance=1")
    _, _, (source,) = sources_of(request)
    curves, simulator = prepared(source, request)
    base = base_fit(simulator, curves.values)
    said, counts = look_at_scatter(simulator, base, seed=0), simulator.spread(base[0].values)
    flat = replace(simulator, law=NoiseLaw(0.0, 0.0, 0.0)).spread(base[0].values)
    assert said.claimed
    assert as_voxels_scatter(said, simulator, base[0], flat / counts).claimed
    assert not as_voxels_scatter(said, simulator, base[0], np.ones_like(counts)).claimed
    # under the law that was taken voxels scatter evenly
    taken = replace(simulator, law=NoiseLaw(0.0, 0.0, 0.0))
    assert as_voxels_scatter(said, taken, base[0], np.ones_like(counts)).claimed


def test_it_can_be_taken_out(tmp_path: Path) -> None:
    (one,) = diagnose_study(request_of(tmp_path, "noise_variance=1", without=("noise_variance",)))
    named = {name for cause in one.answer["causes"] for name in cause["effects"]}
    assert "noise_variance" not in named | set(one.answer["verdict"]["set"])


@pytest.mark.parametrize("flatness", [-1.2, 0.0, 0.5, 1.0, 2.2])
def test_evidence_is_that_of_a_mean_over_the_range(flatness: float) -> None:
    from petkin.study.diagnosis.scatter import _log_evidence

    error, grid = 0.15, np.linspace(0.0, 1.0, 4001)
    likelihood = np.exp(-0.5 * ((flatness - grid) / error) ** 2 + 0.5 * (flatness / error) ** 2)
    assert _log_evidence(flatness, error) == pytest.approx(np.log(np.trapezoid(likelihood, grid)), abs=2e-3)


def test_a_gap_that_jumps_is_no_law_of_noise(tmp_path: Path) -> None:
    """Motion of 2 mm in a brain of 16 regions, which differences feel where it sets in, taken for a flatness of 0.4."""
    settings = SimulationSettings(
        out=tmp_path / "study", phantom="brain3d", voxel_size=7.0, noise=8.0, psf=5.0, effects=("motion_step=2,axis=2",)
    )
    request = DiagnoseRequest(simulate(settings), include=("blood_volume", "partial_volume"))
    scatter = scatter_of(request)
    assert scatter.p_value > 1e-3
    assert not scatter.claimed


@pytest.mark.parametrize("law", [NoiseLaw(2.0, 0.0, 0.0), NoiseLaw(0.0, 0.0, 1.0)])
def test_any_law_is_found_and_its_noise_is_no_gap(tmp_path: Path, law: NoiseLaw) -> None:
    """2 % of every value, and what the length of frames alone says, of which the law of counts makes gaps."""
    request = request_of(tmp_path)
    _, _, (source,) = sources_of(request)
    curves, counts = prepared(source, request)
    fit, *_ = base_fit(counts, curves.values)
    sd = replace(counts, law=law).spread(fit.values)
    late = np.median(sd[:, 20:] / fit.values[:, 20:], axis=1, keepdims=True)
    candidates, claimed, as_counts = hypotheses(EFFECTS, counts, without=frozenset()), 0, 0
    for seed in range(4):
        noise = 0.02 * sd / late * np.random.default_rng(seed).standard_normal(sd.shape)
        told, _, detected = law_of_noise(counts, fit.values + noise, candidates, seed=seed)
        assert told is not None
        assert told.otherwise
        assert np.abs(np.subtract(told.law, law))[[0, 2]].max() < 0.8
        claimed += detected.present or told.claimed
        as_counts += detect(counts, fit.values + noise, candidates, seed=seed).present
    assert claimed <= 1 < as_counts


def test_what_no_scatter_could_say_for_sure_is_no_gap(tmp_path: Path) -> None:
    """Noise of no value but of time, which slopes hardly tell from counts in every fourth scan, while the test does."""
    request = request_of(tmp_path)
    _, _, (source,) = sources_of(request)
    curves, counts = prepared(source, request)
    fit, *_ = base_fit(counts, curves.values)
    sd = replace(counts, law=NoiseLaw(0.0, 0.4, 0.8)).spread(fit.values)
    late = np.median(sd[:, 20:] / fit.values[:, 20:], axis=1, keepdims=True)
    candidates = hypotheses(EFFECTS, counts, without=frozenset())
    claimed = as_counts = unsure = 0
    for seed in range(12):
        values = fit.values + 0.02 * sd / late * np.random.default_rng(seed).standard_normal(sd.shape)
        told, simulator, detected = law_of_noise(counts, values, candidates, seed=seed)
        assert told is not None
        gap = detect(counts, values, candidates, seed=seed).present
        claimed += detected.present
        as_counts += gap
        unsure += gap and not told.otherwise
    assert claimed <= 1
    assert "not as of counts" in _law_of_noise(simulator, None)
    assert ("would be a gap" in _law_of_noise(simulator, None)) == bool(len(simulator.law_errors))
    assert as_counts >= 6
    assert unsure >= 1


def test_a_law_that_is_not_sure_hides_no_gap(tmp_path: Path) -> None:
    """Noise of counts, of which a scan may look otherwise by chance, and 15 s of delay that is not modelled."""
    request = request_of(tmp_path, "arterial_delay=15")
    _, _, (source,) = sources_of(request)
    curves, simulator = prepared(source, replace(request, include=("blood_volume",)))
    told, other, detected = law_of_noise(
        simulator, curves.values, hypotheses(EFFECTS, simulator, without=frozenset()), seed=0
    )
    assert told is not None
    assert len(told.errors) == 3
    assert detected.present
    assert not len(other.law_errors)


@pytest.mark.parametrize("size", [0.0, 0.01, 0.02, 0.2])
def test_what_is_asked_first_changes_no_answer(tmp_path: Path, size: float) -> None:
    """The law of the noise and then the cause, or the cause of what no law explains at once: noise that goes with the
    value, and steps of the gain from none to strong."""
    request = request_of(tmp_path)
    _, _, (source,) = sources_of(request)
    curves, counts = prepared(source, request)
    fit, *_ = base_fit(counts, curves.values)
    noise = 0.01 * fit.values * np.random.default_rng(3).standard_normal(fit.values.shape)
    values = fit.values * np.where(counts.times > 40.0, 1.0 + size, 1.0) + noise
    candidates = hypotheses(EFFECTS, counts, without=frozenset())
    told, under, detected = law_of_noise(counts, values, candidates, seed=0)
    one = scattered(diagnose(under, values, candidates, detected=detected), told)
    two, other, again = diagnose_curves(counts, values, candidates)
    assert (other.law, again.p_value) == (under.law, detected.p_value)
    assert (two.present, two.chosen, two.p_value, two.unknown) == (one.present, one.chosen, one.p_value, one.unknown)
    assert [(c.label, c.probability) for c in two.likely] == [(c.label, c.probability) for c in one.likely]


@pytest.mark.parametrize("seed", [0, 4])
def test_an_offset_that_makes_early_frames_uneven_is_not_noise(tmp_path: Path, seed: int) -> None:
    """20 s, of which a law of louder early frames explains much, but the cause more."""
    frames = "6x10,4x30,5x60,4x120,8x300"
    settings = SimulationSettings(out=tmp_path / "study", noise=0.0, effects=("frame_offset=20",), frames=frames)
    request = DiagnoseRequest(simulate(settings), include=("blood_volume",))
    _, _, (source,) = sources_of(request)
    curves, simulator = prepared(source, request)
    rng, sd = np.random.default_rng(seed), simulator.spread(curves.values)
    late = np.median((sd / curves.values)[:, simulator.times > 20.0], axis=1, keepdims=True)
    noise = np.sqrt(0.4) * rng.standard_normal(sd.shape) + np.sqrt(0.6) * rng.standard_normal(sd.shape[1])
    candidates = hypotheses(EFFECTS, simulator, without=frozenset())
    _, _, detected = law_of_noise(simulator, curves.values + 0.02 * sd / late * noise, candidates, seed=0)
    assert detected.present


@pytest.mark.parametrize("law", [COUNTS, NoiseLaw(0.4, 0.6, 0.7)])
def test_evidence_without_a_gap_is_that_of_a_mean_over_laws(tmp_path: Path, law: NoiseLaw) -> None:
    request = request_of(tmp_path)
    _, _, (source,) = sources_of(request)
    curves, simulator = prepared(source, request)
    fit, *_ = base_fit(simulator, curves.values)
    ratio = replace(simulator, law=law).spread(fit.values) / simulator.spread(fit.values)
    z = (ratio * np.random.default_rng(0).standard_normal(ratio.shape)).ravel()
    each = contrasts(fit.values, simulator.clock)
    x = (each - each.mean(axis=-1, keepdims=True)).reshape(3, -1)
    logs = np.concatenate(
        [
            0.5 * (z**2 * (1.0 - np.exp(-2.0 * d @ x))).sum(axis=1)
            for d in np.random.default_rng(1).standard_normal((40, 5000, 3))
        ]
    )
    expected = float(np.log(np.mean(np.exp(logs - logs.max()))) + logs.max())
    assert evidence_without_gap(simulator, replace(fit, residual=z)) == pytest.approx(expected, abs=0.5)
    assert (expected > 0.0) == (law != COUNTS)


@pytest.mark.parametrize(("flatness", "claimed"), [(0.7, True), (1.4, True), (1.8, False)])
def test_what_is_flatter_than_flat_is_not_noise(flatness: float, claimed: bool) -> None:
    assert Scatter(COUNTS, 9.0, flatness, 0.3, 9.0, 1e-6).claimed == claimed


def test_what_any_other_law_explains_better_is_not_told_as_flat() -> None:
    assert not Scatter(NoiseLaw(2.0, 0.0, 0.0), 30.0, 0.7, 0.1, 9.0, 1e-6).claimed
