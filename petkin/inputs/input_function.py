"""The input function: what arrives in the tissue."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from petkin.dynamics import Forcing, Shifted
from petkin.inputs.parent_fraction import ParentFractionFit


@dataclass(frozen=True)
class InputFunction:
    """Arterial input, decay-corrected to injection.

    Args:
        plasma: C_P, unmetabolised tracer in arterial plasma (the AIF), kBq/mL over min.
        whole_blood: C_B, activity in whole blood, kBq/mL over min: what the vessels of a voxel hold.
        end: last time that samples support, min; infinity for a formula.
        samples: the measured points behind it, for reports (columns of the blood table, time in min); may be empty.
        remarks: what was assumed or repaired on the way, one sentence each.
        total_plasma: plasma activity with its metabolites, kBq/mL, where it is known.
        parent_fraction: share of the total plasma that is unmetabolised tracer, where it is known.
        parent_fraction_fit: the fit behind it, for reports; its time is that of the samples, before any delay.
    """

    plasma: Forcing
    whole_blood: Forcing
    end: float = float("inf")
    samples: pd.DataFrame = field(default_factory=pd.DataFrame)
    remarks: tuple[str, ...] = ()
    total_plasma: Forcing | None = None
    parent_fraction: Forcing | None = None
    parent_fraction_fit: ParentFractionFit | None = None

    def delayed(self, delay: float) -> InputFunction:
        """The same input arriving `delay` minutes later in plasma and whole blood alike."""
        if delay == 0.0:
            return self
        return replace(
            self,
            plasma=Shifted(self.plasma, delay),
            whole_blood=Shifted(self.whole_blood, delay),
            end=self.end + delay,
            total_plasma=None if self.total_plasma is None else Shifted(self.total_plasma, delay),
            parent_fraction=None if self.parent_fraction is None else Shifted(self.parent_fraction, delay),
        )

    def area(self, until: float) -> float:
        """Area under C_P from injection to `until` (min), kBq min/mL; of one curve, not of a batch."""
        return float(self.plasma.integral(np.array([until]))[0])
