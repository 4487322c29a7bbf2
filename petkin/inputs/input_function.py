"""The input function: what arrives in the tissue."""

from __future__ import annotations

from dataclasses import dataclass, field

import pandas as pd

from petkin.dynamics import Forcing, Shifted


@dataclass(frozen=True)
class InputFunction:
    """Arterial input, decay-corrected to injection.

    Args:
        plasma: C_P, unmetabolised tracer in arterial plasma (the AIF), kBq/mL over min.
        whole_blood: C_B, activity in whole blood, kBq/mL over min: what the vessels of a voxel hold.
        end: last time that samples support, min; infinity for a formula.
        samples: the measured points behind it, for reports (columns of the blood table, time in min); may be empty.
        remarks: what was assumed or repaired on the way, one sentence each.
    """

    plasma: Forcing
    whole_blood: Forcing
    end: float = float("inf")
    samples: pd.DataFrame = field(default_factory=pd.DataFrame)
    remarks: tuple[str, ...] = ()

    def delayed(self, delay: float) -> InputFunction:
        """The same input arriving `delay` minutes later in plasma and whole blood alike."""
        if delay == 0.0:
            return self
        return InputFunction(
            Shifted(self.plasma, delay), Shifted(self.whole_blood, delay), self.end + delay, self.samples, self.remarks
        )
