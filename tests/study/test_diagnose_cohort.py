"""`petkin diagnose` on several subjects: the cause they share, who carries it, and pages that link to each other."""

from __future__ import annotations

import json
from importlib.resources import files

import jsonschema
import numpy as np
import pytest

from petkin.diagnosis import Member, in_common
from petkin.diagnosis.detect import AgainstNoise
from petkin.reporting import CohortReport, render_cohort_report
from petkin.study.diagnose import Diagnosed, diagnose_study
from petkin.study.diagnosis.cohort import cohort_answer
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


def told(evidence: list[dict[str, float]], unnamed: list[float]) -> dict:
    """The answer about scans with this evidence of some causes, and little of thirty others."""
    noise = AgainstNoise(("gain_step",), np.zeros(1), np.random.default_rng(0).standard_normal((200, 1)))
    usual = {f"cause{k}": -1.0 for k in range(30)}
    members = [
        Member(f"sub-{i:02d}", 0.001, usual | each, {}, {}, noise, none)
        for i, (each, none) in enumerate(zip(evidence, unnamed, strict=True), 1)
    ]
    alone = {
        "simulator": {"model": "2TCM", "includes": []},
        "gap": {"present": True, "p_value": 0.001},
        "verdict": {"kind": "unknown", "set": []},
    }
    written = cohort_answer(in_common(members), [alone] * len(members), seed=0, seconds=1.0)
    jsonschema.validate(written, SCHEMA)
    return written


def page_of(written: dict) -> str:
    return render_cohort_report(CohortReport("A group", written, ("#",) * len(written["members"]), "", ""))


def test_what_two_groups_share_and_a_gap_of_no_name_stand_side_by_side() -> None:
    one, other, strange = {"gain_step": 30.0}, {"dispersion": 16.0}, {}
    written = told([one] * 5 + [other] * 4 + [strange] * 4, [5.0] * 5 + [2.0] * 4 + [25.0] * 4)
    assert written["verdict"]["kind"] == "named"
    named = [written["verdict"]["set"], *(group["set"] for group in written["further"])]
    assert sorted(named) == [["dispersion"], ["gain_step"]]
    assert [m["probability"] > 0.5 for m in written["unnamed"]["members"]] == [False] * 9 + [True] * 4
    sentence = written["verdict"]["sentence"]
    assert "step is shared by 5 of 13 scans." in sentence
    assert "ispersion is shared by 4 of 13 scans." in sentence
    assert "Beside it, 4 of 13 scans hold a gap that no effect of the catalogue explains" in sentence
    page = page_of(written)
    for caption in ("Shared causes, likeliest first", "What other scans share, likeliest first", "A gap of no name"):
        assert page.count(f"<caption>{caption}</caption>") == 1
    assert "none of the catalogue" in page


def test_scans_that_share_no_more_than_a_gap_of_no_name_say_so() -> None:
    written = told([{"gain_step": 8.0}] * 4, [20.0] * 4)
    assert written["verdict"]["kind"] == "unknown"
    assert written["verdict"]["sentence"].startswith("4 of 4 scans hold a gap that no effect of the catalogue explains")
    assert "<caption>A gap of no name</caption>" in page_of(written)


def test_scans_that_share_nothing_are_called_by_name_where_few_have_a_gap() -> None:
    written = told([{"gain_step": 14.0}, {"dispersion": 14.0}, {"dead_time": 14.0}], [-3.0] * 3)
    assert written["verdict"]["kind"] == "unknown"
    assert written["verdict"]["sentence"].endswith("share; by themselves: sub-01, sub-02, sub-03.")
    assert "<caption>" in page_of(written)
