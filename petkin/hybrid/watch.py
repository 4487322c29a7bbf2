"""Notices runs that died: numbers that are not finite, or predictions that have left the picture."""

from __future__ import annotations

from dataclasses import dataclass

from petkin.errors import NumericalError

#: Predictions whose mean square stays below this share of the observations' count as dead, after so many steps.
_BLANK, _WINDOW, _PATIENCE = 0.05, 50, 300
#: Steps in a row that may be skipped for numbers that are not finite.
_SKIPS = 20


@dataclass
class Watch:
    """Notices runs that died."""

    skipped: int = 0
    blank: int = 0
    recent: float = 1.0

    def skip(self) -> None:
        self.skipped += 1
        if self.skipped > _SKIPS:
            raise NumericalError(f"{self.skipped} steps in a row held numbers that are not finite.")

    def see(self, light: float) -> None:
        """A step whose predictions have this share of the observations' mean square."""
        self.skipped = 0
        self.recent += (light - self.recent) / _WINDOW
        self.blank = self.blank + 1 if self.recent < _BLANK else 0
        if self.blank > _PATIENCE:
            raise NumericalError(
                f"Predictions held {100 * self.recent:.0f} % of the observations' mean square for {self.blank} steps: "
                "they are blank, nothing of them is left in sight."
            )
