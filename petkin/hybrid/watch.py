"""Notices runs that died: numbers that are not finite, or predictions that have left the picture."""

from __future__ import annotations

from dataclasses import dataclass

from petkin.errors import NumericalError

#: A window's mean loss above this share of a blank observation's counts as dead, after so many steps.
_BLANK, _WINDOW, _PATIENCE = 0.95, 50, 300
#: Steps in a row that may be skipped for numbers that are not finite.
_SKIPS = 20


@dataclass
class Watch:
    """Notices runs that died."""

    skipped: int = 0
    blank: int = 0
    recent: float = 0.0

    def skip(self) -> None:
        self.skipped += 1
        if self.skipped > _SKIPS:
            raise NumericalError(f"{self.skipped} steps in a row held numbers that are not finite.")

    def see(self, loss: float, blank: float) -> None:
        self.skipped = 0
        self.recent += (loss / blank - self.recent) / _WINDOW
        self.blank = self.blank + 1 if self.recent > _BLANK else 0
        if self.blank > _PATIENCE:
            raise NumericalError(
                f"The loss stayed at {self.recent:.2f} of a blank observation's for {self.blank} steps: nothing of the "
                "predictions is left in sight."
            )
