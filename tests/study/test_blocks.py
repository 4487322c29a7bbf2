"""Voxels in blocks, in memory or on disk: the same numbers to the bit, whatever is fitted together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.fitting import Choices, Given, Need, ReferenceCurve
from petkin.fitting.parts import PART
from petkin.io import Rows, Scratch, open_series
from petkin.methods import METHODS, Method
from petkin.study.fit import fit_study
from petkin.study.resources import Execution, Plan, Resources, free_memory
from petkin.study.series import VoxelCurves
from petkin_bench.problems import fit_problem
from petkin_bench.whole_image import write_image

GB = 2**30


@pytest.fixture(scope="module")
def problem():
    return fit_problem(voxels=40, percent=10.0)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.label)
def test_a_voxel_does_not_feel_what_it_is_fitted_with(method: Method, problem) -> None:
    """What a method makes of one curve depends on that curve alone, and on what all share: else blocks would show."""
    curves = problem.curves.astype(np.float32).T  # (K, N) with voxels together, as they lie in memory
    reference = ReferenceCurve("reference", problem.clean[0]) if Need.REFERENCE in method.needs else None
    given = Given(problem.observation, problem.weights, problem.arterial, reference, 0.5)
    shared = method.share(curves.T, given, Choices(), True) if method.share else {}
    choices = Choices(fixed={symbol: value for symbol, (value, _) in shared.items()})
    try:
        whole = method.fit(curves.T, given, choices, True)
    except InputError as refused:
        if "use --level region" not in str(refused):
            raise
        return
    for part in (slice(0, 7), slice(7, 40)):
        alone = method.fit(np.ascontiguousarray(curves[:, part]).T, given, choices, True)
        for mine, theirs in zip(alone.estimates, whole.estimates, strict=True):
            np.testing.assert_array_equal(mine.value, theirs.value[part], err_msg=mine.symbol)
            np.testing.assert_array_equal(mine.percent_se, theirs.percent_se[part], err_msg=mine.symbol)
        np.testing.assert_array_equal(alone.status, whole.status[part])
        for mine, theirs in zip(alone.columns, whole.columns, strict=True):
            np.testing.assert_array_equal(mine.values, theirs.values[part], err_msg=mine.name)
        assert alone.settings == whole.settings


def everything(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_blocks_on_disk_give_the_bytes_of_memory(tmp_path: Path, problem, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports too, whose maps are read back from disk."""
    mask = np.ones((5, 4, 2), np.bool_)
    request = write_image(tmp_path, problem, mask)
    fit_study(request)
    in_memory = everything(tmp_path / "out")
    assert not list(tmp_path.glob(".petkin-*"))

    def small(self: Resources, series, voxels: int, models: int, *, denoised: bool = False) -> Plan:
        return Plan(self, on_disk=True, block=7, maps=1)

    monkeypatch.setattr(Resources, "plan", small)
    fit_study(request, execution=Execution(again=True))
    assert everything(tmp_path / "out") == in_memory
    assert not list(tmp_path.glob(".petkin-*"))


def test_the_whole_brain_is_summed_alike_in_memory_and_on_disk(tmp_path: Path, problem) -> None:
    """Its mean leaves out voxels that are not finite in every frame."""
    values = np.array(problem.curves.astype(np.float32).T)
    values[3, 5], values[4, 6] = np.nan, -1.0
    mask = np.ones((5, 4, 2), np.bool_)
    request = write_image(tmp_path, problem, mask)
    series = open_series(request.target)
    with Scratch(tmp_path) as scratch:
        plan = Plan(Resources(GB, scratch), on_disk=False, block=10, maps=1)
        rows = scratch.rows("curves", *values.shape)
        rows.array[:] = values
        kept, stored = (VoxelCurves.summed_up(r, mask, series, "", plan) for r in (Rows(values), rows))
    np.testing.assert_array_equal(kept.mean, stored.mean)
    np.testing.assert_allclose(kept.mean, np.delete(values, 5, axis=1).mean(axis=1, dtype=np.float64), rtol=1e-12)
    assert (kept.not_finite, kept.negative) == (1, np.mean(values < 0))


def test_a_plan_keeps_to_its_memory(tmp_path: Path, problem) -> None:
    series = open_series(write_image(tmp_path, problem, np.ones((5, 4, 2), np.bool_)).target)
    with Scratch(tmp_path) as scratch:
        plenty = Resources(free_memory(), scratch).plan(series, 40, 1)
        assert (plenty.on_disk, plenty.parts(40)) == (False, [slice(0, 40)])
        million = Resources(free_memory(), scratch).plan(series, 10**9, 1)
        assert million.on_disk
        assert million.block % PART == 0
        assert 8 * 26 * million.block < free_memory()
        with pytest.raises(InputError, match=r"--memory 0\.05G is too little .*; give at least \d+\.\d\dG"):
            Resources(GB // 20, scratch).plan(series, 40, 1)


def test_large_tables_lie_in_files_unless_the_disk_is_full(
    tmp_path: Path, problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    series = open_series(write_image(tmp_path, problem, np.ones((5, 4, 2), np.bool_)).target)
    with Scratch(tmp_path) as scratch:
        room = Resources(8 * GB, scratch)
        assert room.plan(series, 10**6, 1).on_disk
        monkeypatch.setattr(Scratch, "free", 0)
        assert not room.plan(series, 10**6, 1).on_disk
        assert room.plan(series, 10**8, 1).on_disk  # memory does not hold them either; `rows` says so


def test_requests_for_workers_are_checked() -> None:
    with pytest.raises(InputError, match="--workers is -1"):
        Execution(workers=-1)
    with pytest.raises(InputError, match="give one of them"):
        Execution(workers=2, scheduler="tcp://a:1")
