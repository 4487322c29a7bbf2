"""Called from Python, what studies are asked for leaves libraries of linear algebra one core, and theirs afterwards."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from petkin.errors import InputError
from petkin.study.diagnose import diagnose_study, foresee_study
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.fit import fit_study
from petkin.study.request import FitRequest


def _cores() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.mark.parametrize(
    ("asked", "request_of"),
    [
        (fit_study, lambda study: FitRequest(study, models=("1TCM",))),
        (diagnose_study, DiagnoseRequest),
        (foresee_study, DiagnoseRequest),
    ],
)
def test_matrices_are_left_to_one_core(asked: Any, request_of: Callable[[Path], Any], tmp_path: Path) -> None:
    seen: set[int] = set()
    with threadpool_limits(2, "blas"):
        with pytest.raises(InputError):
            asked(request_of(tmp_path / "nothing"), lambda *_: seen.update(_cores()))
        assert _cores() == {2}
    assert seen == {1}
