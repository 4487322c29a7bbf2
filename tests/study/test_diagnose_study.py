"""The verb `diagnose` on simulated studies: its answer, its files, and the setting of the paper."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pandas as pd
import pytest

from petkin.errors import InputError
from petkin.study.diagnose import Diagnosed, diagnose_study, foresee_study
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings

SCHEMA = json.loads((files("petkin.reporting") / "schemas" / "gap-report-1.json").read_text())
EXAMPLE = {
    "schema": "petkin-gap/1",
    "subject": "sub-01",
    "simulator": {"model": "2tcm", "includes": ["blood_volume", "arterial_delay"]},
    "gap": {"present": True, "p_value": 0.0004, "chi2_per_dof": 1.9, "noise_floor": 1.0, "frame_common_share": 0.31},
    "where": {
        "stages": [{"stage": "clock", "probability": 0.81}],
        "regions": [{"region": "putamen", "q_value": 0.01, "share": 0.4}],
        "frames": [{"index": 17, "start_s": 1800, "end_s": 2100, "q_value": 0.003}],
        "onset_frame": 17,
        "state": [{"state": "C_T", "term": "second hidden compartment", "evidence": 3.1}],
    },
    "causes": [
        {
            "effects": ["motion_step"],
            "probability": 0.86,
            "estimate": {"onset_min": {"value": 30.0, "low": 29.1, "high": 31.2, "unit": "min"}},
            "log_evidence_gain": 14.2,
            "closure": {"value": 0.93, "low": 0.88, "high": 0.97},
        }
    ],
    "verdict": {
        "kind": "named",
        "set": ["motion_step"],
        "set_probability": 0.93,
        "split_by": None,
        "sentence": "A 10 % mixing step at 30 min in the putamen explains 93 % of the gap.",
    },
    "cannot_tell": [
        {"effects": ["input_scale"], "why": "K1 absorbs it exactly", "worst_bias": {"K1": 0.05, "VT": 0.05}}
    ],
    "parameters": [{"region": "putamen", "symbol": "VT", "unit": "mL/cm3", "before": 3.9, "after": 4.4}],
    "provenance": {"petkin": "0.1.0", "seed": 0, "seconds": 0.8},
}
INCLUDES = ("blood_volume", "arterial_delay")


def simulated(folder: Path, **options: object) -> Path:
    """A slice of coarse voxels, large regions: little noise a region."""
    usual = {"out": folder / "study", "noise": 8.0, "voxel_size": 7.0, "tracer": "reversible"}
    return simulate(SimulationSettings.model_validate({**usual, **options}))


def diagnosed(study: Path, out: Path, **options: Any) -> Diagnosed:
    (one,) = diagnose_study(DiagnoseRequest(study, out=out, **options))
    return one


@pytest.fixture(scope="module")
def step(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A gain step of 10 percent at 30 min."""
    return simulated(tmp_path_factory.mktemp("stepped"), effects=("gain_step=0.1,onset=30",))


@pytest.fixture(scope="module")
def stepped(step: Path) -> Diagnosed:
    return diagnosed(step, step.parent / "out", include=INCLUDES)


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Diagnosed]:
    """A study without a gap."""
    folder = tmp_path_factory.mktemp("quiet")
    study = simulated(folder)
    return study, diagnosed(study, folder / "out", include=INCLUDES)


@pytest.fixture(scope="module")
def paper(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Diagnosed]:
    """Data of two compartments, 40 min, not decay-corrected, no noise; a simulator of one."""
    folder = tmp_path_factory.mktemp("paper")
    study = simulated(folder, preset="paper", tracer="paper", model="2TCM", noise=0.0)
    return study, diagnosed(study, folder / "out", model="1tcm")


def test_the_contracts_example_passes_the_schema() -> None:
    jsonschema.validate(EXAMPLE, SCHEMA)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**EXAMPLE, "verdict": {**EXAMPLE["verdict"], "kind": "perhaps"}}, SCHEMA)


def test_the_answer_passes_the_schema_and_names_the_step(stepped: Diagnosed) -> None:
    written = json.loads(stepped.report.with_suffix(".json").read_text())
    jsonschema.validate(written, SCHEMA)
    assert stepped.report.name == "sub-01_desc-gap_report.html"
    assert written["verdict"]["set"][0] == "gain_step"
    assert written["where"]["stages"][0]["stage"] == "imaging"
    leader = written["causes"][0]
    assert leader["estimate"]["amplitude"]["value"] == pytest.approx(0.1, abs=0.02)
    assert leader["estimate"]["onset_min"]["value"] == pytest.approx(30.0, abs=5.0)
    assert leader["closure"]["value"] > 0.9
    assert written["where"]["onset_frame"] is not None


def test_a_simulator_without_blood_is_told_so_by_a_whole_brain(tmp_path: Path) -> None:
    """A record sharpened by 20 s and more would do for 16 regions nearly what their blood does, with one number; no
    sampling line smears a record so."""
    study = simulated(tmp_path, roi=16, noise=6.0, seed=6)
    answer = diagnosed(study, tmp_path / "out").answer
    assert answer["verdict"]["set"] == ["blood_volume"]
    told = answer["causes"][0]["estimate"]["amplitude"]
    truth = pd.read_csv(next(study.rglob("*_desc-truth_kinpar.tsv")), sep="\t")["VB"].median()
    assert told["low"] < truth < told["high"]
    assert told["value"] == pytest.approx(truth, rel=0.2)


def test_trapping_in_a_whole_brain_is_named_alone(tmp_path: Path) -> None:
    """With a number a region its refit ends in a side valley, from which one number for all leads out."""
    study = simulated(tmp_path, roi=16, seed=15, effects=("vascular_trapping=0.2",))
    answer = diagnosed(study, tmp_path / "out", include=("blood_volume",)).answer
    assert answer["verdict"]["set"] == ["vascular_trapping"]
    assert answer["causes"][0]["closure"]["value"] > 0.9
    assert answer["causes"][0]["estimate"]["amplitude"]["value"] == pytest.approx(0.2, rel=0.25)


@pytest.mark.parametrize(("model", "said"), [("2tcm", True), ("2tcm3k", False)])
def test_irreversible_binding_is_pointed_at(tmp_path: Path, model: str, said: bool) -> None:
    one = diagnosed(simulated(tmp_path, tracer="fdg"), tmp_path / "out", model=model, include=INCLUDES)
    assert ("use --model 2tcm3k" in one.report.read_text()) is said


def test_rules_of_the_answer(stepped: Diagnosed) -> None:
    answer = stepped.answer
    named = sum(cause["probability"] for cause in answer["causes"])
    assert 0 < named <= 1 + 1e-9
    assert all(list(cause["effects"]) == sorted(cause["effects"]) for cause in answer["causes"])
    assert next(iter(answer["causes"][0]["estimate"])) == "amplitude"
    assert {row["region"] for row in answer["where"]["regions"]} == {p["region"] for p in answer["parameters"]}
    assert [row["index"] for row in answer["where"]["frames"]] == list(range(len(answer["where"]["frames"])))
    assert {p["symbol"] for p in answer["parameters"]} == {"K1", "VT", "Ki"}
    hidden = [name for entry in answer["cannot_tell"] for name in entry["effects"]]
    assert "input_scale" in hidden
    assert not set(INCLUDES) & {e for cause in answer["causes"] for e in cause["effects"]}


def test_a_study_without_a_gap_is_left_in_peace(quiet: tuple[Path, Diagnosed]) -> None:
    one = quiet[1]
    assert one.answer["verdict"]["kind"] == "none"
    assert one.answer["causes"] == []
    assert one.answer["gap"]["present"] is False
    jsonschema.validate(one.answer, SCHEMA)


def test_the_papers_missing_compartment_is_named_and_closes_the_gap(paper: tuple[Path, Diagnosed]) -> None:
    answer = paper[1].answer
    assert answer["verdict"]["set"] == ["second_tissue"]
    assert answer["verdict"]["kind"] == "named"
    assert answer["where"]["stages"][0]["stage"] == "tissue"


def test_it_closes_as_much_as_the_true_model_does(paper: tuple[Path, Diagnosed], tmp_path: Path) -> None:
    """The paper's global residual closes 0.93 and its meta-learned one 0.999 of what the full physics does."""
    study, found = paper
    without, oracle = (simulator_error(one) for one in (found, diagnosed(study, tmp_path / "out", model="2tcm")))
    closed = found.answer["causes"][0]["closure"]["value"]
    assert oracle < 0.01 * without
    assert closed * without >= 0.95 * (without - oracle)


def simulator_error(one: Diagnosed) -> float:
    return float(one.answer["gap"]["chi2_per_dof"])


def test_kinetics_move_to_the_truth_once_the_cause_is_in(paper: tuple[Path, Diagnosed]) -> None:
    study, found = paper
    path = study / "derivatives/phantom/sub-01/pet/sub-01_seg-phantom_model-2TCM_desc-truth_kinpar.tsv"
    truth = pd.read_csv(path, sep="\t").set_index("name").VT
    rows = [row for row in found.answer["parameters"] if row["symbol"] == "VT"]
    before = np.array([abs(row["before"] / truth[row["region"]] - 1) for row in rows])
    after = np.array([abs(row["after"] / truth[row["region"]] - 1) for row in rows])
    assert np.median(after) < 0.02
    assert np.median(before) > 0.1


def test_a_withheld_cause_appears_nowhere(step: Path, tmp_path: Path) -> None:
    one = diagnosed(step, tmp_path / "out", include=INCLUDES, without=("gain_step",))
    names = {e for cause in one.answer["causes"] for e in cause["effects"]}
    assert one.answer["gap"]["present"]
    assert "gain_step" not in names
    assert all("gain_step" not in label for label in one.answer["verdict"]["set"])


def test_the_same_seed_gives_the_same_files(quiet: tuple[Path, Diagnosed], tmp_path: Path) -> None:
    study, one = quiet
    two = diagnosed(study, tmp_path / "again", include=INCLUDES)
    assert one.report.read_bytes() == two.report.read_bytes()
    first, second = ({**each.answer, "provenance": {**each.answer["provenance"], "seconds": 0}} for each in (one, two))
    assert first == second


def test_the_page_says_what_was_found(stepped: Diagnosed) -> None:
    page = stepped.report.read_text()
    assert stepped.answer["verdict"]["sentence"] in page
    for heading in ("Where", "Which, and how far", "What these data cannot tell"):
        assert heading in page
    assert page.count("data:image/svg+xml") >= 4
    assert "http" not in page.replace("http-equiv", "")


def test_a_design_is_judged_before_any_data(quiet: tuple[Path, Diagnosed]) -> None:
    ((label, visible),) = foresee_study(DiagnoseRequest(quiet[0], include=INCLUDES))
    known = {one.hypothesis.name: one for one in visible}
    assert label == "sub-01"
    assert known["input_scale"].invisible
    assert not known["frame_duration"].invisible
    assert "arterial_delay" not in known


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "5tcm"}, "a simulator needs a compartment model: 1TCM"),
        ({"include": ("gravity",)}, "--include 'gravity': there is no such effect"),
        ({"without": ("gravity",)}, "--without 'gravity': there is no such effect"),
        ({"include": ("dispersion",), "without": ("dispersion",)}, "it is in the simulator or it is not"),
        ({"model": "2TCM", "include": ("second_tissue",)}, "has it already; use --model 1tcm"),
        ({"seed": -1}, "give 0 or more"),
    ],
)
def test_requests_that_cannot_be(options: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        diagnose_study(DiagnoseRequest(tmp_path, **options))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda table: table.assign(grey=np.nan), "region 'grey' has no finite value in frame 1"),
        (lambda table: table.assign(grey=0.0), "region 'grey' holds no activity"),
        (lambda table: table.iloc[:7], "7 frames are too few"),
    ],
)
def test_curves_that_cannot_be_diagnosed(spoil, message: str, tmp_path: Path) -> None:
    study = simulated(tmp_path, truth_tacs=True)
    folder = study / "derivatives/phantom/sub-01/pet"
    made = next(folder.glob("*noisefree_tacs.tsv"))
    other = study / "derivatives/other/sub-01/pet"
    other.mkdir(parents=True)
    spoil(pd.read_csv(made, sep="\t")).to_csv(other / "sub-01_seg-own_tacs.tsv", sep="\t", index=False, na_rep="n/a")
    (other / "sub-01_seg-own_tacs.json").write_text(made.with_suffix(".json").read_text())
    with pytest.raises(InputError, match=message):
        diagnosed(study, tmp_path / "out", seg="own")
