"""The demonstration's own diagnosis: 2TCM data, a 1TCM simulator, as in arXiv 2403.08194."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from petkin.diagnosis import diagnose
from petkin.diagnosis.how_far import held_out
from petkin.diagnosis.refit import Fit, State, refit
from petkin.effects import EFFECTS
from petkin.study.demo import ask_one_tissue
from petkin.study.diagnose import ALWAYS
from petkin.study.diagnosis.hypotheses import hypotheses
from petkin.study.diagnosis.preparing import prepared, sources_of
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings

INCLUDES = ("blood_volume", "arterial_delay")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As the demonstration has it, but for a slice instead of a brain."""
    out = tmp_path_factory.mktemp("demo") / "study"
    return simulate(SimulationSettings(out=out, tracer="reversible", noise=5.0, voxel_size=4.0, seed=1))


def test_one_tissue_lacks_the_second_and_the_report_says_so(study: Path) -> None:
    (found,) = ask_one_tissue(study, "", lambda step, done: None)
    assert found.answer["verdict"]["set"][0] == "second_tissue"
    assert found.answer["causes"][0]["effects"] == ["second_tissue"]
    assert found.answer["causes"][0]["closure"]["value"] >= 0.95
    page = found.report.read_text()
    assert found.answer["verdict"]["sentence"] in page
    assert found.answer["verdict"]["sentence"].startswith("Second tissue")


def test_it_closes_what_the_true_model_closes(study: Path) -> None:
    """The oracle has both compartments from the start, each region with rates of its own."""
    request = DiagnoseRequest(study, model="1TCM", include=INCLUDES)
    (source,) = sources_of(request)[2]
    curves, simulator = prepared(source, request)
    oracle = prepared(source, replace(request, model="2TCM"))[1]
    found = diagnose(simulator, curves.values, hypotheses(EFFECTS, simulator, without=frozenset()), always=ALWAYS)
    (named,) = (cause for cause in found.causes if cause.label == "second_tissue")
    assert named.fit is not None
    starts = [refit(oracle, curves.values, found.noise, State(own, oracle.shared.mean)) for own in oracle.starts]
    true = min(starts, key=lambda fit: fit.objective)
    before, mine, best = (excess(fit, (len(curves.names), len(curves.frames))) for fit in (found.base, named.fit, true))
    assert before > 100.0 * best
    assert before - mine >= 0.95 * (before - best)


def excess(fit: Fit, shape: tuple[int, int]) -> float:
    """Held-out deviance above its floor."""
    deviance, floor = held_out(fit, shape)
    return float(np.sum(deviance) - np.sum(floor))
