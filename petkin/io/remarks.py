"""What a reader noticed: one sentence each, with how much it matters, so that no number goes wrong in silence."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Severity(StrEnum):
    """How much a remark matters."""

    NOTE = "note"
    WARNING = "warning"
    SEVERE = "severe"


@dataclass(frozen=True)
class Remark:
    """One thing that is odd in a file, in one sentence.

    Args:
        severity: NOTE (legal, nothing was changed), WARNING (converted or assumed on reading, or a number may move a
            little), SEVERE (a number is wrong unless it is resolved).
        code: short stable name of the trap, e.g. "dose-mismatch"; remarks of several scans are grouped by it.
        where: file it was seen in.
        text: the sentence, with the value and what was done about it.
    """

    severity: Severity
    code: str
    where: str
    text: str

    def __str__(self) -> str:
        return f"{self.where}: {self.text}"


def note(code: str, where: str, text: str) -> Remark:
    """A remark on something legal, where nothing was changed."""
    return Remark(Severity.NOTE, code, where, text)


def warning(code: str, where: str, text: str) -> Remark:
    """A remark on something that was converted or assumed, or that may move the numbers a little."""
    return Remark(Severity.WARNING, code, where, text)


def severe(code: str, where: str, text: str) -> Remark:
    """A remark on something that makes a number wrong unless it is resolved."""
    return Remark(Severity.SEVERE, code, where, text)
