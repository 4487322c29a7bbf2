"""The input function as a report shows it: curves on a grid of times, and the samples behind them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.inputs.input_function import InputFunction

#: Columns of a blood table that hold activity or a fraction, and the curve that each of them samples.
_SAMPLED_CURVES = {
    "AIF": "AIF",
    "plasma_radioactivity": "total plasma",
    "whole_blood_radioactivity": "whole blood",
    "metabolite_parent_fraction": "parent fraction",
}


@dataclass(frozen=True)
class BloodSamples:
    """Measured points of one curve of the input function ("AIF", "whole blood", "total plasma" or "parent fraction").

    Args:
        curve: which curve they sample.
        time: min.
        value: kBq/mL, or a fraction.
    """

    curve: str
    time: NDArray[np.floating]
    value: NDArray[np.floating]


@dataclass(frozen=True)
class InputCurves:
    """The input function as the fit used it, before the tissue's own delay.

    Args:
        time: T times, min.
        aif: unmetabolised tracer in arterial plasma, kBq/mL, [T].
        whole_blood: kBq/mL, [T], or None.
        total_plasma: kBq/mL, [T], or None.
        parent_fraction: [T], or None.
        samples: the measured points.
        end: last time that samples support, min.
        remarks: what was assumed or repaired.
    """

    time: NDArray[np.floating]
    aif: NDArray[np.floating]
    whole_blood: NDArray[np.floating] | None = None
    total_plasma: NDArray[np.floating] | None = None
    parent_fraction: NDArray[np.floating] | None = None
    samples: tuple[BloodSamples, ...] = ()
    end: float = float("inf")
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("aif", "whole_blood", "total_plasma", "parent_fraction"):
            values = getattr(self, name)
            if values is not None and np.shape(values) != np.shape(self.time):
                raise InputError(
                    f"The report's {name} curve has {np.size(values)} values for {np.size(self.time)} times; "
                    "give one value a time."
                )

    @classmethod
    def from_input(
        cls,
        source: InputFunction,
        until: float,
        *,
        total_plasma: NDArray[np.floating] | None = None,
        parent_fraction: NDArray[np.floating] | None = None,
    ) -> InputCurves:
        """Evaluate an input function on `curve_times(until)` and take its samples along.

        Args:
            source: the input function.
            until: end of the scan, min.
            total_plasma: kBq/mL on `curve_times(until)`.
            parent_fraction: on `curve_times(until)`.
        """
        time = curve_times(until)
        return cls(
            time=time,
            aif=np.asarray(source.plasma(time)),
            whole_blood=np.asarray(source.whole_blood(time)),
            total_plasma=total_plasma,
            parent_fraction=parent_fraction,
            samples=_samples_of(source),
            end=source.end,
            remarks=source.remarks,
        )


def curve_times(until: float) -> NDArray[np.float64]:
    """Times (min) that show a bolus and its tail: 0.5 s apart in the first 5 min, 600 steps after them."""
    early = min(5.0, until)
    return np.unique(np.concatenate([np.linspace(0.0, early, 601), np.linspace(early, until, 600)]))


def _samples_of(source: InputFunction) -> tuple[BloodSamples, ...]:
    table = source.samples
    found = []
    for column in (c for c in _SAMPLED_CURVES if c in table.columns and "time" in table.columns):
        rows = table[["time", column]].to_numpy(np.float64)
        rows = rows[np.isfinite(rows).all(axis=1)]
        if len(rows):
            found.append(BloodSamples(_SAMPLED_CURVES[column], rows[:, 0], rows[:, 1]))
    return tuple(found)
