"""Where the linear part begins, for voxels: too noisy to tell it themselves, they take what the scan's regions tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, FitResult, Given
from petkin.methods import Method


def with_t_star(
    choices: Choices, method: Method, given: Given, whole: NDArray[np.float64], regional: FitResult | None
) -> Choices:
    """Choices for voxels, with the t* of the regional fit, or without one of the whole-brain curve.

    Args:
        choices: what was asked; a t* that was given stays.
        method: what is fitted.
        given: what the scan gives.
        whole: whole-brain curve (K,), kBq/mL.
        regional: the method's regional result, or None.
    """
    if choices.t_star is not None:
        return choices
    told = regional if regional is not None else method.fit(whole[None], given, choices, False)
    return replace(choices, t_star=told.settings.get("t_star"))
