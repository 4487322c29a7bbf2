"""What a scan gives every method besides its curves."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction

Array = NDArray[np.float64]


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

    def suv_factor(self, label: str) -> float:
        """Body weight over injected dose, g/kBq, for the method with this label.

        Raises:
            InputError: it is not known.
        """
        if self.suv is None:
            raise InputError(f"{label} needs {Need.DOSE.value}, and they are not known.")
        return self.suv
