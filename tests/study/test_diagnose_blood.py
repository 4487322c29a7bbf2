"""Blood that scatters: lines between its samples are a gap, curves that may err as they scatter are none."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from petkin.diagnosis import Hypothesis, detect
from petkin.dynamics import PiecewiseLinear
from petkin.effects import EFFECTS
from petkin.errors import InputError
from petkin.inputs import InputFunction, from_blood
from petkin.io import BloodRecord
from petkin.study.diagnose import diagnose_study
from petkin.study.diagnosis.blood import recorded_input
from petkin.study.diagnosis.hypotheses import hypotheses
from petkin.study.diagnosis.preparing import prepared, sources_of
from petkin.study.diagnosis.record import between_errors, fraction_samples, plasma_samples, record_errors, remark
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.request import FITTED, RECORDED, DiagnoseRequest
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings

SPARSE = np.array([0.5, 1, 1.5, 2, 3, 4, 5, 7, 10, 15, 20, 25, 30, 40, 50, 60, 75, 90])
INCLUDES = ("blood_volume", "arterial_delay")


def blood(times: np.ndarray, scatter: float = 0.0, odds: float = 0.0, seed: int = 0) -> InputFunction:
    """Three exponentials and a Hill curve, their samples with errors."""
    rng = np.random.default_rng(seed)
    total = 60 * np.exp(-times / 1.5) + 12 * np.exp(-times / 15) + 6 * np.exp(-times / 200)
    share = 1 / (1 + (times / 25) ** 1.6)
    logit = np.log(share / (1 - share)) + odds * rng.standard_normal(times.size)
    plasma = total * (1 + scatter * rng.standard_normal(times.size))
    columns = {
        "time": times,
        "plasma_radioactivity": plasma,
        "whole_blood_radioactivity": 0.7 * plasma,
        "metabolite_parent_fraction": 1 / (1 + np.exp(-logit)),
    }
    return from_blood(pd.DataFrame(columns))


def candidates(simulator: RegionalSimulator) -> tuple[Hypothesis, ...]:
    return tuple(hypotheses(EFFECTS, simulator, without=frozenset()))


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study without an effect, whose blood samples err by 8 percent."""
    out = tmp_path_factory.mktemp("noisy") / "study"
    settings = {"out": out, "noise": 8.0, "voxel_size": 7.0, "tracer": "reversible", "blood_noise": 8.0}
    return simulate(SimulationSettings.model_validate(settings))


@pytest.mark.parametrize("scatter", [0.03, 0.08])
def test_scatter_of_samples_is_recovered(scatter: float) -> None:
    found = [plasma_samples(blood(SPARSE, scatter, seed=seed)).size for seed in range(40)]
    assert np.median(found) == pytest.approx(scatter, rel=0.3)


def test_scatter_of_the_parent_fraction_is_recovered_in_its_odds() -> None:
    found = [fraction_samples(blood(SPARSE, odds=0.15, seed=seed)).size for seed in range(20)]
    assert np.median(found) == pytest.approx(0.15, rel=0.4)


def test_a_dense_record_without_noise_hardly_errs() -> None:
    nodes = np.linspace(0.0, 90.0, 200)
    dense = record_errors(blood(np.arange(0.05, 90.0, 0.25)), nodes)
    noisy = record_errors(blood(SPARSE, 0.08, 0.15), nodes)
    assert np.sqrt((dense**2).sum(axis=0)).max() < 0.005
    assert np.sqrt((noisy**2).sum(axis=0)).max() > 0.05


def test_a_fraction_near_one_hardly_errs() -> None:
    nodes = np.array([0.5, 60.0])
    early, late = np.abs(record_errors(blood(SPARSE, 0.0, 0.3), nodes)[-10:]).max(axis=0)
    assert early < 0.01
    assert late > 10 * early


def recorded(times: np.ndarray, every: int = 1) -> tuple[InputFunction, np.ndarray, np.ndarray]:
    """Such a record read as lines, times, and how C_P departs from that there, relatively."""
    nodes = np.linspace(times[0], 90.0, 400)
    table = blood(times).samples.copy()
    table.loc[np.arange(len(table)) % every > 0, "metabolite_parent_fraction"] = np.nan
    lines = recorded_input(BloodRecord(table, None, True, None, "here"), 90.0)
    truth = blood(nodes).samples
    plasma = truth["plasma_radioactivity"] * truth["metabolite_parent_fraction"]
    return lines, nodes, plasma.to_numpy() / np.asarray(lines.plasma(nodes)) - 1.0


def test_errors_between_samples_are_what_lines_lack() -> None:
    """Of how the truth departs from lines through 18 samples, and 9 fractions, a tenth is left; a third after the last
    fraction, at 75 min, which is 0.22 off at the end."""
    lines, nodes, truth = recorded(SPARSE, every=2)
    plasma, fraction, later = between_errors(lines, nodes)
    left, inside = plasma + fraction + later - truth, nodes < 75.0
    assert (later[inside] == 0.0).all()
    assert np.abs(truth[inside]).max() > 0.02
    assert np.abs(left[inside]).max() < 0.1 * np.abs(truth[inside]).max()
    assert np.abs(left).max() < 0.34 * np.abs(truth).max()


def test_a_dense_record_leaves_nothing_between_its_samples() -> None:
    lines, nodes, _ = recorded(np.arange(0.25, 90.1, 0.25))
    assert np.abs(between_errors(lines, nodes)).max() < 0.005


def test_a_record_of_activity_alone_has_no_error_of_a_fraction() -> None:
    lines, nodes, _ = recorded(SPARSE)
    bare = replace(lines, plasma=lines.total_plasma, parent_fraction=None)
    np.testing.assert_array_equal(between_errors(bare, nodes), between_errors(lines, nodes)[:1])


def test_sparse_samples_of_a_scan_without_an_effect_are_no_gap(tmp_path: Path) -> None:
    """By default: 19 samples of plasma and 9 of the parent fraction, none of them with an error."""
    allowed, as_exact = 0, 0
    for seed in range(2, 6):
        settings = {"out": tmp_path / f"study{seed}", "tracer": "reversible", "seed": seed, "noise": 5.0}
        request = DiagnoseRequest(simulate(SimulationSettings.model_validate(settings)), include=INCLUDES)
        curves, simulator = prepared(sources_of(request)[2][0], request)
        exact = replace(simulator, errors=np.zeros((0, simulator.nodes.size)))
        of_lines, of_exact = (detect(s, curves.values, candidates(s), seed=seed) for s in (simulator, exact))
        allowed, as_exact = allowed + of_lines.present, as_exact + of_exact.present
    assert allowed <= 1
    assert as_exact >= 3


@pytest.mark.parametrize("column", ["plasma_radioactivity", "AIF", "metabolite_parent_fraction"])
def test_blood_without_activity_is_one_line(column: str) -> None:
    table = pd.DataFrame({"time": [0.0, 1.0, 2.0], "plasma_radioactivity": 1.0, column: 0.0})
    with pytest.raises(InputError, match=f"here: column '{column}' has no value above 0"):
        recorded_input(BloodRecord(table, None, True, None, "here"), 2.0)


def test_too_few_samples_get_the_usual_error() -> None:
    assert plasma_samples(blood(SPARSE[[3, 6, 9, 12, 15]], 0.2)).size == pytest.approx(0.05)


def test_an_input_without_samples_is_exact() -> None:
    line = PiecewiseLinear(np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    assert record_errors(InputFunction(line, line), np.linspace(0, 1, 5)).shape == (0, 5)


def test_noisy_blood_is_a_gap_only_where_it_is_taken_as_exact(noisy: Path, tmp_path: Path) -> None:
    answers = {}
    for how in (RECORDED, FITTED):
        request = DiagnoseRequest(noisy, include=INCLUDES, out=tmp_path / how, blood=how)
        (one,) = diagnose_study(request)
        answers[how] = one
    assert answers[RECORDED].answer["gap"]["present"]
    assert not answers[FITTED].answer["gap"]["present"]
    assert "samples of plasma scatter by" in answers[FITTED].report.read_text()
    assert "samples of plasma scatter by" not in answers[RECORDED].report.read_text()
    assert "see --read-blood fitted" in answers[RECORDED].report.read_text()
    assert "see --read-blood fitted" not in answers[FITTED].report.read_text()


def test_the_same_blood_is_read_as_a_fit_reads_it(noisy: Path) -> None:
    request = DiagnoseRequest(noisy, include=INCLUDES, blood=FITTED)
    (source,) = sources_of(request)[2]
    simulator = prepared(source, request)[1]
    assert simulator.input.parent_fraction_fit is not None
    assert len(simulator.errors) > 0
    assert remark(simulator.input) in simulator.input.remarks


def test_an_unknown_way_to_read_is_refused(noisy: Path) -> None:
    with pytest.raises(InputError, match="--read-blood 'guessed': choose recorded or fitted"):
        DiagnoseRequest(noisy, blood="guessed")


def test_answers_validate_either_way(noisy: Path, tmp_path: Path) -> None:
    (one,) = diagnose_study(DiagnoseRequest(noisy, include=INCLUDES, out=tmp_path, blood=FITTED))
    assert json.loads(json.dumps(one.answer))["schema"] == "petkin-gap/1"
