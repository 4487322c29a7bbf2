"""Cohorts of the blind check: who holds what, verdicts, scores."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from petkin.errors import InputError
from petkin_bench.withheld import run as runs
from petkin_bench.withheld.cohorts import cases
from petkin_bench.withheld.cohorts.cases import CohortAnswer, cohort_case
from petkin_bench.withheld.cohorts.score import cohort_metrics
from petkin_bench.withheld.run import Plan
from petkin_bench.withheld.score import Judged, joined

SCANS = 3


@pytest.fixture
def of_kind(monkeypatch: pytest.MonkeyPatch):
    """A cohort of one kind, by its number."""

    def make(kind: str, index: int) -> CohortAnswer:
        monkeypatch.setattr(cases, "_KINDS", {kind: 1.0})
        return cohort_case("training", 5, index, SCANS, 2)[1]

    return make


def test_a_cohort_follows_from_its_numbers_alone() -> None:
    (first, truth), (again, same) = (cohort_case("scored", 3, 1, SCANS, 2) for _ in range(2))
    other, _ = cohort_case("training", 3, 1, SCANS, 2)
    assert truth == same
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.values, two.values)
    assert not np.array_equal(first[0].values[:, :10], other[0].values[:, :10])


def test_scans_of_a_cohort_have_one_clock_and_subjects_of_their_own() -> None:
    scans, _ = cohort_case("training", 5, 0, SCANS, 2)
    for scan in scans[1:]:
        np.testing.assert_array_equal(scan.frames.end, scans[0].frames.end)
        assert scan.frames.decay == scans[0].frames.decay
        assert not np.array_equal(scan.blood.total, scans[0].blood.total)
        assert not np.array_equal(scan.values, scans[0].values)


def test_a_cause_is_in_all_scans_in_some_or_in_none(of_kind) -> None:
    """Each at a size of its own, about one; what only some have is in two at least."""
    for index in range(3):
        every, some, none = (of_kind(kind, index) for kind in ("all", "some", "none"))
        assert min(every.detectability) > 0
        assert cases._LEAST <= np.count_nonzero(some.detectability) < SCANS
        assert not any(none.detectability)
        assert none.name == ""
        for answer in (every, some):
            held = np.array(answer.sizes)[np.array(answer.detectability) > 0]
            assert answer.name in answer.same
            assert len(set(held)) == len(held)
            assert np.all(np.abs(np.log(held / abs(answer.size))) < 4 * cases.SPREAD)


def test_causes_that_differ_have_strengths_that_one_scan_shows(of_kind) -> None:
    low, high = cases._APART
    answer = of_kind("apart", 0)
    assert answer.name == ""
    assert all(0.9 * low < strength < 1.1 * high for strength in answer.detectability)


def test_two_causes_are_in_groups_of_their_own_and_cannot_be_taken_for_each_other(of_kind) -> None:
    answer = of_kind("two", 0)
    assert min(answer.detectability) > 0
    assert cases._LEAST <= np.count_nonzero(answer.sizes) < SCANS
    assert answer.name in answer.same
    assert answer.other
    assert not set(answer.same) & set(answer.other)


def test_a_cause_of_no_name_is_in_all_scans(of_kind) -> None:
    answer = of_kind("unnamed", 0)
    assert min(answer.detectability) > 0
    assert (answer.name, answer.same, answer.other) == ("", (), ())


def test_moments_are_those_of_each_scan_or_of_all(of_kind, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cases, "KNOWN", tuple(c for c in cases.KNOWN if c.name == "gain_step"))
    monkeypatch.setattr(cases, "_OTHER_FORM", 0.0)
    drawn: list[float] = []
    kept = cases.made_of
    monkeypatch.setattr(cases, "made_of", lambda s, c, d, size: drawn.append(d.onset) or kept(s, c, d, size))
    for at_once in (1.0, 0.0):
        monkeypatch.setattr(cases, "_AT_ONCE", at_once)
        drawn.clear()
        answer = of_kind("all", 1)
        assert (answer.onset >= 0) == bool(at_once)
        assert len(set(drawn)) == (1 if at_once else SCANS)


def judged(**cells: str) -> Judged:
    usual = {
        "kind": "all",
        "verdict": "named",
        "leader": "gain_step",
        "leader_probability": "0.95",
        "set": "gain_step",
        "set_probability": "0.95",
        "classes": "gain_step",
        "name": "gain_step",
        "form": "known",
        "detectability": "5.0;4.0;6.0",
        "carriers": "0.9;0.8;0.99",
        "prevalence_low": "0.4",
        "prevalence_high": "0.9",
        "mean": "0.05",
        "mean_low": "0.04",
        "mean_high": "0.06",
        "size": "-0.05",
        "onset": "-1.0",
        "onset_low": "",
        "onset_high": "",
        "groups": "gain_step",
        "further": "",
        "unnamed": "",
        "each": "gain_step;;dispersion",
        "seconds": "3.0",
    }
    return Judged(usual | cells)


def test_moments_by_hand() -> None:
    held = judged(onset="30.0", onset_low="28.0", onset_high="31.0")
    off, unsaid = judged(onset="30.0", onset_low="31.0", onset_high="33.0"), judged(onset="30.0")
    own = judged(onset_low="28.0", onset_high="31.0")
    found = {m.name.split(": ")[1]: (m.value, m.cases) for m in cohort_metrics([held, off, unsaid, own, judged()])}
    assert found["a moment in common is said"] == (pytest.approx(2 / 3), 3)
    assert found["its interval holds it"] == (0.5, 2)
    assert found["moments of their own said to be one"] == (0.5, 2)


def test_scores_by_hand() -> None:
    some = judged(kind="some", detectability="5.0;0.0;6.0", carriers="0.9;0.7;0.99", mean_high="0.045")
    apart = judged(kind="apart", classes="", name="", form="", carriers="0.9;0.8;0.1")
    alone = judged(kind="apart", classes="", name="", form="", carriers="0.9;0.1;0.1")
    groups = {"kind": "two", "classes": "gain_step|dispersion", "groups": "gain_step;dispersion|arterial_delay"}
    both, one = judged(**groups, further="arterial_delay"), judged(**groups)
    alien = {"kind": "unnamed", "classes": "", "groups": "", "name": "", "form": ""}
    unknown = judged(**alien, verdict="unknown", set="", leader_probability="0.1", unnamed="0.9;0.9;0.9")
    silent = judged(kind="none", verdict="none", classes="", name="", form="", set="", leader="", carriers="", mean="")
    cases_ = [judged(), some, apart, alone, silent, both, one, unknown, judged(**alien)]
    found = {m.name: m.value for m in cohort_metrics(cases_)}
    assert {name.partition(": ")[0] for name in found} == {"cohorts of 3"}
    value = {name.partition(": ")[2]: v for name, v in found.items()}
    assert value["false alarms"] == 0.0
    assert value["different causes called shared"] == 0.5
    assert value["class first, held by all, d' 4-6"] == 1.0
    assert value["class first in a scan alone, d' 4-6"] == pytest.approx(2 / 5)
    assert value["scans rightly said to carry it or not"] == pytest.approx(5 / 6)
    assert value["AUROC of carriers, held by some"] == 1.0
    assert value["prevalence interval holds it, held by some"] == 1.0
    assert value["interval of the mean size holds it"] == 0.5
    assert value["two causes: both named, each of some scans"] == 0.5
    assert value["two causes: one named at least"] == 1.0
    assert value["a second cause named where there is none"] == 0.0
    assert value["of no name in all: called unknown"] == 0.5
    assert value["of no name in all: said to be shared"] == 0.5
    assert value["of no name in all: named with p > 0.9"] == 0.5
    assert value["named called of no name"] == 0.0
    assert value["CPU s a scan, median"] == 1.0


def test_a_cohort_is_judged_and_scored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cases, "_KINDS", {"all": 1.0})
    verdicts, answers = runs.run(Plan("training", 5, 1, 2, 50, scans=SCANS), tmp_path)
    (case,) = joined(verdicts, answers)
    assert len(case.words("detectability")) == SCANS
    assert case.cells["verdict"] in ("none", "named", "ambiguous", "unknown")
    assert len(case.cells["each"].split(";")) == SCANS
    assert {m.name.partition(": ")[0] for m in cohort_metrics([case])} == {"cohorts of 3"}


@pytest.mark.parametrize("scans", [2, 11])
def test_two_scans_and_more_than_there_are_classes_are_refused(scans: int) -> None:
    with pytest.raises(InputError, match=f"--scans {scans}: give 1, or 3 to 10"):
        Plan("scored", 0, 1, 5, 100, scans=scans)


def test_ten_causes_of_classes_of_their_own_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cases, "_KINDS", {"apart": 1.0})
    assert len(cohort_case("training", 5, 1, cases.SCANS[1], 2)[0]) == cases.SCANS[1]


def test_cohorts_of_images_are_refused() -> None:
    with pytest.raises(InputError, match="--scans 3"):
        Plan("scored", 0, 1, 5, 100, images=True, scans=3)
