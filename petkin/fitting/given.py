"""What a scan gives every method besides its curves."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.imaging import FrameObservation
from petkin.inputs import InputFunction, smoothest

Array = NDArray[np.float64]

#: Start of the first frame (min) until which a reference curve is known well enough from zero at injection.
_LATEST_START = 2.0


class Need(Enum):
    """What a method cannot do without; the value is what a message calls it."""

    INPUT = "an arterial input function"
    REFERENCE = "a reference region"
    DOSE = "the injected dose and the body weight"


@dataclass(frozen=True)
class ReferenceCurve:
    """Curve of a region without specific binding, as frames report it.

    Args:
        name: region, or file of the mask.
        values: frame values (K,), kBq/mL.
    """

    name: str
    values: Array


@dataclass(frozen=True)
class Given:
    """What a scan gives besides its curves.

    Args:
        observation: what frames report.
        weights: frame weights (K,) shared by all curves, or (N, K); relative inverse variances >= 0.
        arterial: input function with its delay, or None.
        reference: reference region, or None.
        suv: body weight over injected dose, g/kBq, or None.
    """

    observation: FrameObservation
    weights: Array
    arterial: InputFunction | None = None
    reference: ReferenceCurve | None = None
    suv: float | None = None

    def input(self, label: str) -> InputFunction:
        """The input function, for the method with this label.

        Raises:
            InputError: there is none.
        """
        if self.arterial is None:
            raise InputError(f"{label} needs {Need.INPUT.value}, and there is no blood.")
        return self.arterial

    def reference_curve(self, label: str) -> ReferenceCurve:
        """The reference region, for the method with this label.

        Raises:
            InputError: there is none.
        """
        if self.reference is None:
            raise InputError(f"{label} needs {Need.REFERENCE.value}, and none was named.")
        return self.reference

    def reference_input(self, label: str) -> InputFunction:
        """The reference region's curve in the place of an input, for the method with this label.

        Raises:
            InputError: there is none, or the scan began too late to know it from the start.
        """
        values, frames = self.reference_curve(label).values, self.observation.frames
        if frames.start[0] > _LATEST_START:
            raise InputError(
                f"{label} needs the reference region's curve from injection on, but the first frame starts at "
                f"{frames.start[0]:g} min; SUVR does without."
            )
        edges = np.append(frames.start, frames.end)
        curve = smoothest(edges, self.observation.of_forcing).through(values)
        return InputFunction(curve, curve)

    def suv_factor(self, label: str) -> float:
        """Body weight over injected dose, g/kBq, for the method with this label.

        Raises:
            InputError: it is not known.
        """
        if self.suv is None:
            raise InputError(f"{label} needs {Need.DOSE.value}, and they are not known.")
        return self.suv
