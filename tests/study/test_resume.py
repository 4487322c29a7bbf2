"""When a finished scan counts as finished, and what is left out of the record of a command."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import nibabel
import numpy as np
import pytest
from distributed import LocalCluster

from petkin.cli.parsing import memory_size, typed_command
from petkin.errors import InputError, PetkinError
from petkin.fitting import Choices
from petkin.study.fit import fit_study
from petkin.study.request import FitRequest
from petkin.study.resources import Execution
from petkin_bench.problems import fit_problem
from petkin_bench.whole_image import write_image


@pytest.fixture
def request_(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FitRequest:
    """A small image, fitted; reports have tests of their own."""
    monkeypatch.setattr("petkin.reporting.render_fit_report", lambda report: report.title)
    request = write_image(tmp_path, fit_problem(voxels=40, percent=10.0), np.ones((5, 4, 2), np.bool_))
    request = replace(request, models=("Patlak",))
    assert not fit_study(request)[0].before
    return request


def before(request: FitRequest) -> bool:
    return fit_study(request)[0].before


def test_the_same_request_is_not_fitted_again(request_: FitRequest) -> None:
    (first,) = fit_study(request_)
    assert first.before
    (again,) = fit_study(request_, execution=Execution(again=True))
    assert not again.before
    assert (first.label, first.delay, first.outcomes, first.remarks, first.report) == (
        (again.label, again.delay, again.outcomes, again.remarks, again.report)
    )
    assert before(replace(request_, command_line="petkin fit, typed in another way"))


def test_another_request_is_fitted(request_: FitRequest) -> None:
    assert not before(replace(request_, models=("Patlak", "Logan")))
    assert not before(replace(request_, choices=Choices(t_star=20.0)))
    assert not before(request_)


def test_another_input_is_fitted(request_: FitRequest) -> None:
    blood = request_.blood[0]
    blood.write_text(blood.read_text().replace("\t", "\t", 1) + "4000\t1\t1\n")
    assert not before(request_)
    image = nibabel.load(request_.target)  # type: ignore[attr-defined]
    values = np.asarray(image.dataobj)
    values[0, 0, 0, 3] *= 1.5
    nibabel.save(nibabel.Nifti1Image(values, image.affine), request_.target)
    assert not before(request_)
    weights = request_.target.parent / "weights.tsv"
    for content in ("weight\n" + "1\n" * 26, "weight\n" + "1\n" * 25 + "2\n"):
        weights.write_text(content)
        assert not before(replace(request_, weights=str(weights)))


def test_a_file_that_is_gone_or_cut_is_made_again(request_: FitRequest) -> None:
    assert request_.out is not None
    path = next(request_.out.rglob("*meas-Ki_mimap.nii.gz"))
    whole = path.read_bytes()
    for damage in (lambda: path.unlink(), lambda: path.write_bytes(whole[:-1])):
        damage()
        assert not before(request_)
        assert path.read_bytes() == whole
    record = next(request_.out.rglob("*_record.json"))
    for text in ("", "[]", '{"Files": 3}', json.dumps({**json.loads(record.read_text()), "Outcomes": [{"a": 1}]})):
        record.write_text(text)
        assert not before(request_)
    assert before(request_)


def test_one_bad_scan_does_not_keep_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request_: FitRequest
) -> None:
    from petkin.study import fit as room

    fit_job = room.fit_job

    def fails(job, progress, **more):
        if "bad" in job.source.label:
            raise InputError("pet.nii.gz: cannot be read.")
        return fit_job(job, progress, **more)

    read = room.read_sources

    def twice(request):
        name, out, (source,) = read(request)
        return name, out, tuple(replace(source, entities={"sub": label}) for label in ("bad", "good"))

    monkeypatch.setattr(room, "fit_job", fails)
    monkeypatch.setattr(room, "read_sources", twice)
    with pytest.raises(
        InputError, match=r"1 of 2 scans could not be fitted, .* sub-bad: pet\.nii\.gz: cannot be read\."
    ):
        fit_study(request_)
    assert request_.out is not None
    assert {path.name for path in request_.out.glob("sub-*")} == {"sub-pet", "sub-good"}


def test_voxels_of_one_scan_are_shared_by_the_workers_of_a_scheduler(tmp_path: Path) -> None:
    """More voxels than one block holds: two workers fit them, and every byte is that of this process alone."""
    mask = np.ones((40, 42, 40), np.bool_)
    problem = fit_problem(voxels=100, percent=10.0)
    repeated = replace(problem, curves=np.tile(problem.curves, (mask.size // 100, 1)))
    request = replace(write_image(tmp_path, repeated, mask), models=("Patlak",))
    fit_study(request)
    folder = tmp_path / "out"
    serial = {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    steps: list[tuple[str, float]] = []
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, memory_limit=0) as cluster:
        execution = Execution(scheduler=cluster.scheduler_address, again=True)
        fit_study(request, lambda step, done: steps.append((step, done)), execution)
    assert {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()} == serial
    by_voxel = [done for step, done in steps if step.endswith("by voxel")]
    assert len(set(by_voxel)) > 3  # one a block
    assert [done for _, done in steps] == sorted(done for _, done in steps)
    assert not list(tmp_path.glob(".petkin-*"))


def test_a_scheduler_that_is_not_there_is_one_line(monkeypatch: pytest.MonkeyPatch, request_: FitRequest) -> None:
    monkeypatch.setattr("petkin.study.cohort._PATIENCE", 1)
    with pytest.raises(PetkinError, match=r"--scheduler tcp://127\.0\.0\.1:9: no scheduler with workers there"):
        fit_study(request_, execution=Execution(scheduler="tcp://127.0.0.1:9"))


def test_options_that_change_no_result_are_not_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    typed = ["/bin/petkin", "fit", "a study", "--memory", "4G", "--workers=2", "--again", "-m", "2TCM"]
    monkeypatch.setattr(sys, "argv", typed)
    assert typed_command(without=("--memory", "--workers"), flags=("--again",)) == "petkin fit 'a study' -m 2TCM"


def test_memory_is_read_with_its_unit() -> None:
    sizes = {"4G": 4 * 2**30, "1.5GiB": 3 * 2**29, "800m": 800 * 2**20, "2tb": 2 * 2**40, "1000": 1000}
    assert {text: memory_size(text) for text in sizes} == sizes
    for text in ("", "G", "-1G", "0", "4X"):
        with pytest.raises(InputError, match="--memory"):
            memory_size(text)
