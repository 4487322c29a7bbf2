"""Numbers that do not depend on where arrays lie, where the processor's library has such a mode."""

from __future__ import annotations

import os

import pytest

from petkin import repeatable


@pytest.mark.parametrize(
    ("intel", "given", "left"), [(True, None, "AUTO,STRICT"), (True, "AVX2", "AVX2"), (False, None, None)]
)
def test_only_intel_is_asked_and_the_user_comes_first(
    monkeypatch: pytest.MonkeyPatch, intel: bool, given: str | None, left: str | None
) -> None:
    monkeypatch.setattr(repeatable, "_is_intel", lambda: intel)
    monkeypatch.delenv(repeatable.VARIABLE, raising=False)
    if given is not None:
        monkeypatch.setenv(repeatable.VARIABLE, given)
    repeatable.keep_repeatable()
    assert os.environ.get(repeatable.VARIABLE) == left
