"""`petkin diagnose` on several subjects: the cause they share, who carries it, and pages that link to each other."""

from __future__ import annotations

import json
from importlib.resources import files

import jsonschema
import pytest

from petkin.study.diagnose import Diagnosed, diagnose_study
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings

SCHEMA = json.loads((files("petkin.reporting") / "schemas" / "gap-cohort-1.json").read_text())
SCANS = 3


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> tuple[Diagnosed, ...]:
    """Three subjects with the same gain step."""
    folder = tmp_path_factory.mktemp("cohort")
    usual = {"out": folder / "study", "noise": 8.0, "voxel_size": 7.0, "tracer": "reversible", "subjects": SCANS}
    study = simulate(SimulationSettings.model_validate({**usual, "effects": ("gain_step=0.05,onset=30",)}))
    include = ("blood_volume", "arterial_delay")
    return diagnose_study(DiagnoseRequest(study, out=folder / "out", include=include))


def test_the_group_comes_last_and_passes_its_schema(found: tuple[Diagnosed, ...]) -> None:
    assert [one.label for one in found] == ["sub-01", "sub-02", "sub-03", "group"]
    written = json.loads(found[-1].report.with_suffix(".json").read_text())
    jsonschema.validate(written, SCHEMA)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**written, "verdict": None}, SCHEMA)
    assert found[-1].report.name == "group_desc-gap_report.html"


def test_it_names_the_step_and_its_carriers(found: tuple[Diagnosed, ...]) -> None:
    answer = found[-1].answer
    leader = answer["causes"][0]
    assert leader["effects"] == ["gain_step"]
    assert answer["verdict"]["set"][0] == "gain_step"
    assert "shared by 3 of 3 scans" in answer["verdict"]["sentence"]
    assert all(member["probability"] > 0.5 for member in leader["members"])
    assert leader["amplitude"]["low"] < 0.05 < leader["amplitude"]["high"]


def test_nothing_else_is_shared(found: tuple[Diagnosed, ...]) -> None:
    answer = found[-1].answer
    assert answer["further"] == []
    assert answer["unnamed"] is None
    assert "Beside it" not in answer["verdict"]["sentence"]


def test_the_page_links_to_every_scan(found: tuple[Diagnosed, ...]) -> None:
    group = found[-1]
    page = group.report.read_text()
    for one in found[:-1]:
        link = one.report.relative_to(group.report.parent).as_posix()
        assert f'href="{link}"' in page
        assert (group.report.parent / link).is_file()
    assert page.count("data:image/svg+xml") == 2


def test_the_page_says_how_noise_goes_and_seconds_hold_all_of_it(found: tuple[Diagnosed, ...]) -> None:
    page = found[-1].report.read_text()
    assert ("scans tell together: variance as" in page) != ("do not tell together" in page)
    seconds = [one.answer["provenance"]["seconds"] for one in found]
    assert seconds[-1] > sum(seconds[:-1])
