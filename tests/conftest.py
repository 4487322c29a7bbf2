"""Fixtures shared by all rooms."""

from __future__ import annotations

import gc
import os
from collections import Counter
from pathlib import Path

import numba
import pytest
import torch

_BESIDE_THE_PROJECT = Path(__file__).resolve().parents[2] / "shared" / "data"


#: Files of few tests that take half a minute and more, and how many tests they count as, at least.
_LONG = frozenset(
    {
        "test_cohort",
        "test_diagnose_blood",
        "test_diagnose_shared_law",
        "test_diagnose_states",
        "test_diagnose_study",
        "test_documented_commands",
        "test_learning",
        "test_notebooks",
        "test_profile",
        "test_real_scans",
        "test_torchrun",
        "test_tracer",
        "test_withheld",
        "test_withheld_cases",
    }
)
_EARLY = 20


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files of many tests first, and none that takes long near the end, so that workers end together."""
    tests = Counter(item.path for item in items)
    items.sort(key=lambda item: -max(tests[item.path], _EARLY * (item.path.stem in _LONG)))


def pytest_collection_finish() -> None:
    """What is there for all of the run is no garbage: looking through it again and again took a tenth of the time."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)
    numba.set_num_threads(1)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real data and of the common benchmark, kept outside the project (PETKIN_DATA overrides)."""
    folder = Path(os.environ.get("PETKIN_DATA", _BESIDE_THE_PROJECT))
    if not folder.is_dir():
        pytest.skip(f"real data are not part of the project and {folder} is absent; set PETKIN_DATA to run this test")
    return folder
