"""What a way of fitting is, to those who offer it and to those who call it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, FitResult, Given, Need, NonlinearSettings

#: Value and percent standard error, by symbol, of what all curves have in common.
Share = Callable[[NDArray[np.floating], Given, Choices, bool], dict[str, tuple[float, float]]]
#: curves (N, K) in kBq/mL, what the scan gives, what the user chose, whether the curves are voxels.
Fit = Callable[[NDArray[np.floating], Given, Choices, bool], FitResult]


@dataclass(frozen=True)
class Method:
    """One method.

    Args:
        label: BEP023 model label.
        name: what it is called in full.
        fit: how it is done.
        symbols: parameters that `Choices` may bound or fix.
        outcome: the quantity it is used for, e.g. VT, Ki or BPND.
        equation: its equation as text.
        how: how it is fitted and where its errors come from, a paragraph for reports.
        reference: where it comes from.
        needs: what it cannot do without.
        share: how what all curves have in common is found, from the same as `fit`, which does it itself where `Choices`
            does not fix it; None where they share nothing.
        comparable: whether its AICc is over frame values and may be compared with another's.
        shareable: what the regions of a scan may have in common.
        regions_only: whether it fits all regions of a scan at once, and no voxels.
        nonlinear: settings of its fit (choices, whether voxels), where it is a compartment model's; for what only those
            can tell: profile likelihoods, and how far from the best of all fits a fit can be.
    """

    label: str
    name: str
    fit: Fit
    symbols: tuple[str, ...]
    outcome: str
    equation: str
    how: str
    reference: str
    needs: frozenset[Need] = frozenset({Need.INPUT})
    share: Share | None = None
    comparable: bool = False
    shareable: tuple[str, ...] = ()
    regions_only: bool = False
    nonlinear: Callable[[Choices, bool], NonlinearSettings] | None = None
