"""Compiled code is kept, and processes that compile at the same moment do not mix up each other's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from petkin.compiled import VARIABLE
from petkin.jit import _Named, njit

_STAMP = (1.0, 1)


def test_what_is_listed_is_what_was_compiled_for_it_whoever_wrote_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both look at the list before either has written; the one's code arrives last."""
    one, other = (_Named(str(tmp_path), "total", _STAMP) for _ in range(2))
    monkeypatch.setattr(other, "_load_index", dict)
    write = one._save_data

    def late(name: str, data: Any) -> None:
        other.save("by columns", "code for columns")
        write(name, data)

    monkeypatch.setattr(one, "_save_data", late)
    one.save("by rows", "code for rows")
    found = _Named(str(tmp_path), "total", _STAMP)
    assert found.load("by columns") == "code for columns"
    assert found.load("by rows") in {None, "code for rows"}  # None: compiled again


def test_every_version_is_kept_and_found_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def total(rows):
        answer = 0.0
        for i in range(rows.shape[0]):
            for j in range(rows.shape[1]):
                answer += (1 + i) * (10 + j) * rows[i, j]
        return answer

    rows = np.arange(12.0).reshape(3, 4)
    looked = [rows, np.asfortranarray(rows), rows.astype(np.float32)]
    expected = np.arange(1, 4) @ rows @ np.arange(10, 14)
    for hits in (0, 3):
        compiled = njit(nogil=True)(total)
        assert [compiled(these) for these in looked] == [expected] * 3
        assert sum(compiled.stats.cache_hits.values()) == hits
    assert len(list(tmp_path.rglob("*.nbc"))) == 3


def test_division_is_numpys() -> None:
    @njit()
    def ratio(one, other):
        return one / other

    assert ratio(1.0, 0.0) == np.inf


def test_numbers_that_are_written_out_share_one_version() -> None:
    @njit(forceinline=True)
    def row(table, which, column):
        return table[which, column]

    @njit()
    def total(table):
        return row(table, 0, 1) + row(table, 1, 0) + row(table, which=1, column=1)

    assert total(np.arange(4.0).reshape(2, 2)) == 1.0 + 2.0 + 3.0
    assert len(row.signatures) == 1
