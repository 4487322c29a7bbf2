"""The dispersion of a sampling line as the curves tell it, where no file does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting.arrival import estimate_arrival
from petkin.imaging import FrameObservation
from petkin.inputs import InputFunction
from petkin.io import RegionalCurves, Remark
from petkin.io.remarks import warning
from petkin.kinetics import TWO_TISSUE
from petkin.study.arterial import arterial_input
from petkin.study.request import FitRequest
from petkin.study.sources import Source
from petkin.study.whole_brain import seen_for_delay
from petkin.units import SECONDS_PER_MINUTE


def freed_input(
    source: Source,
    whole: NDArray[np.float64],
    observation: FrameObservation,
    weights: NDArray[np.float64],
    request: FitRequest,
    curves: RegionalCurves | None,
) -> tuple[InputFunction, Remark]:
    """The input freed from the dispersion that fits best, and a remark on how well that is told.

    Raises:
        InputError: there is no autosampler record, whose dispersion alone can be corrected.
    """
    if source.blood is None or len(source.blood.tables) < 2:
        raise InputError(f"{source.label}: --dispersion estimate needs the record of an autosampler; there is none.")

    def freed(tau: float) -> InputFunction:
        asked = replace(request, dispersion_s=tau * SECONDS_PER_MINUTE, estimate_dispersion=False)
        return arterial_input(source, asked)

    seen = seen_for_delay(whole, observation, request, curves)
    rates = request.choices.rate_bounds
    arrival = estimate_arrival(seen, freed, observation, weights, TWO_TISSUE, rate_bounds=rates)
    return freed(arrival.dispersion), warning("dispersion-estimated", source.label, arrival.sentence)
