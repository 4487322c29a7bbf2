"""What is asked of every regional fit: is it the only one, is it the best one, and are its errors right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.certificate import certify
from petkin.fitting.curvature import asymmetry
from petkin.fitting.minima import with_second_minimum
from petkin.fitting.nonlinear import NonlinearSettings
from petkin.fitting.results import FitResult
from petkin.fitting.table import BasisTable

#: A regional proof ends here, as a share of the cost.
_WITHIN, _MOST = 1e-5, 2000


def looked_into(
    result: FitResult, curves: NDArray[np.floating], table: BasisTable, settings: NonlinearSettings
) -> FitResult:
    """A regional fit with second minima, asymmetric estimates and the proven gap to the best of all fits.

    Args:
        result: fit of the curves.
        curves: (N, K), kBq/mL.
        table: basis table that they were fitted with.
        settings: as they were fitted with.
    """
    result = with_second_minimum(result, curves, table, settings)
    gap = certify(curves, result, table, settings, within=_WITHIN, most=_MOST)
    asymmetric = asymmetry(result, table, settings)
    named = asymmetric.values > 0
    remarks = (_remark(result, asymmetric.levels or {}, asymmetric.values),) if named.any() else ()
    return replace(result, columns=(*result.columns, asymmetric, gap), remarks=(*result.remarks, *remarks))


def certified(
    result: FitResult, curves: NDArray[np.floating], table: BasisTable, settings: NonlinearSettings
) -> FitResult:
    """A fit of voxels with the proven gap to the best of all fits, to 0.1 percent of the cost; arguments as above."""
    return replace(result, columns=(*result.columns, certify(curves, result, table, settings)))


def _remark(result: FitResult, symbols: dict[int, str], codes: NDArray[np.int16]) -> str:
    counts = {symbol: int(np.count_nonzero(codes & bit)) for bit, symbol in symbols.items()}
    said = ", ".join(f"{symbol} ({count})" for symbol, count in counts.items() if count)
    return (
        f"{result.model}: intervals are not estimate plus and minus standard errors for {said} of {len(codes)} curves; "
        "ask for their profile likelihood or a bootstrap."
    )
