"""Plasma curves as formulas, for simulation.

The presets are in the unit of their sources (uCi/mL); pass `factor=37.0` for kBq/mL.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import ExponentialSum, Forcing, PiecewiseLinear
from petkin.errors import InputError
from petkin.inputs.input_function import InputFunction
from petkin.inputs.linearise import piecewise_linear

if TYPE_CHECKING:
    from torch import Tensor

#: A2, A3 (uCi/mL) and the rates (1/min, negative: the printed positive ones would explode) of both presets.
_FENG = {"A2": 21.8798, "A3": 20.8113, "rates": (-4.133859, -0.1190996, -0.01043449)}
_PAPER = {"A2": 21.8798, "A3": 20.8113, "rates": (-4.1339, -0.1191, -0.0104)}
_FENG_A1 = 851.1225


def feng(
    A1: float | Tensor,
    A2: float,
    A3: float,
    rates: tuple[float, float, float],
    *,
    onset: float = 0.0,
    factor: float = 1.0,
) -> ExponentialSum:
    """Feng's plasma curve after a bolus: C_P(s) = (A1 s - A2 - A3) e^{l1 s} + A2 e^{l2 s} + A3 e^{l3 s}, s = t - onset.

    Args:
        A1: rise, activity concentration/min; a number, or a tensor of any shape for a batch of curves.
        A2: activity concentration.
        A3: activity concentration.
        rates: l1, l2, l3 (1/min), all negative.
        onset: time of arrival, min.
        factor: multiplies the whole curve, e.g. 37.0 from uCi/mL to kBq/mL.

    Returns:
        The forcing, float64, of the shape of A1.

    Raises:
        InputError: a rate that is not negative.

    Reference: Feng D, Huang SC, Wang X. Int J Biomed Comput 1993;32:95-110. doi:10.1016/0020-7101(93)90049-C
    """
    import torch

    if max(rates) >= 0:
        raise InputError(f"The rates of a plasma curve must be negative (the curve falls); got {rates}.")
    rise = factor * torch.as_tensor(A1, dtype=torch.float64)
    level = torch.full_like(rise, factor)
    coefficients = torch.stack([rise, -(A2 + A3) * level, A2 * level, A3 * level], dim=-1)
    exponents = torch.tensor([rates[0], *rates], dtype=torch.float64)
    return ExponentialSum(coefficients, exponents, powers=(1, 0, 0, 0), onset=onset)


def paper_plasma(A1: float | Tensor = 150.0, *, onset: float = 0.0, factor: float = 1.0) -> ExponentialSum:
    """The preset `paper`: A1 in [100, 200] uCi/mL/min; A2, A3 = 21.8798, 20.8113 uCi/mL; l = -4.1339, -0.1191, -0.0104.

    Reference: Ye Y et al. Unsupervised learning of hybrid latent dynamics: a learn-to-identify framework, 2024,
    arXiv:2403.08194, whose appendix prints the rates without their sign.
    """
    return feng(A1, _PAPER["A2"], _PAPER["A3"], _PAPER["rates"], onset=onset, factor=factor)


def feng_plasma(A1: float | Tensor = _FENG_A1, *, onset: float = 0.0, factor: float = 1.0) -> ExponentialSum:
    """The preset `feng`: Feng's own numbers, A1 = 851.1225 uCi/mL/min; `onset` is the arrival time (min).

    Reference: Feng D, Huang SC, Wang X. Int J Biomed Comput 1993;32:95-110. doi:10.1016/0020-7101(93)90049-C
    """
    return feng(A1, _FENG["A2"], _FENG["A3"], _FENG["rates"], onset=onset, factor=factor)


#: Presets by name, for options and configuration files.
PLASMA_PRESETS = {"paper": paper_plasma, "feng": feng_plasma}


def exponentials(amplitudes: list[float], rates: list[float], *, onset: float = 0.0) -> ExponentialSum:
    """C(t) = sum_j A_j e^{l_j (t - onset)} from `onset` on, zero before.

    Args:
        amplitudes: A_j, kBq/mL.
        rates: l_j, 1/min, as many; zero for a constant level.
        onset: min.
    """
    import torch

    terms = torch.tensor([amplitudes, rates], dtype=torch.float64)
    return ExponentialSum(*terms, powers=(0,) * len(rates), onset=onset)


def linear_rise(
    amplitudes: list[float],
    rates: list[float],
    *,
    onset: float,
    peak: float,
    end: float,
    tolerance: float = 1e-4,
) -> PiecewiseLinear:
    """A straight rise from `onset` to `peak`, then C(t) = sum_j A_j e^{l_j (t - peak)}, as straight pieces up to `end`.

    Args:
        amplitudes: A_j, kBq/mL; the peak is their sum.
        rates: l_j, 1/min, as many.
        onset: start of the rise, min.
        peak: end of the rise, min.
        end: last time, min.
        tolerance: largest relative departure of the straight pieces from the formula.

    Raises:
        InputError: the times do not ascend.
    """
    if not onset < peak < end:
        raise InputError(
            f"A linear rise needs onset < peak < end; got {onset:g}, {peak:g} and {end:g} min: put them in order."
        )
    A, rate = np.asarray(amplitudes, dtype=float), np.asarray(rates, dtype=float)

    def curve(t: NDArray[np.float64]) -> NDArray[np.float64]:
        rise = A.sum() * (t - onset) / (peak - onset)
        fall = (A * np.exp(rate * np.maximum(t - peak, 0.0)[:, None])).sum(axis=1)
        return np.where(t < peak, rise, fall)

    return piecewise_linear(curve, np.array([onset, peak, end]), tolerance=tolerance)


def analytic_input(plasma: Forcing, *, whole_blood: Forcing | None = None) -> InputFunction:
    """An input function from formulas; without `whole_blood` the vessels hold C_P, and a remark says so."""
    if whole_blood is not None:
        return InputFunction(plasma, whole_blood, end=math.inf)
    remark = "Whole blood was not given and is taken equal to the plasma curve."
    return InputFunction(plasma, plasma, end=math.inf, remarks=(remark,))
