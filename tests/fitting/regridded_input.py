"""The input function as the reference program convolves it: regridded, rectangle sum, read out linearly.

kinfitr 0.9.1 shifts the input, interpolates it onto 6000 points up to the last sample or the middle of the last frame,
and takes a discrete convolution there. Over 90 min a step is 0.9 s, and a rectangle sum that counts the newest value in
full acts as an input half a step early. Only to compare like with like.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from petkin.dynamics import PiecewiseLinear
from petkin.errors import InputError
from petkin.inputs.input_function import InputFunction

Array = NDArray[np.float64]

STEPS = 6000


@dataclass(frozen=True)
class RegriddedInput:
    """u on an equidistant grid from 0, convolved by y_n = h sum_{j <= n} e^{-a (t_n - t_j)} u_j, linear in between."""

    step: float
    values: Tensor

    @property
    def knots(self) -> Tensor:
        return self.step * torch.arange(len(self.values), dtype=torch.float64)

    def __call__(self, t: Tensor) -> Tensor:
        return PiecewiseLinear(self.knots, self.values)(t)

    def integral(self, t: Tensor, decay: float = 0.0) -> Tensor:
        return PiecewiseLinear(self.knots, self.values).integral(t, decay)

    def response(self, rates: Tensor | Array, t: Tensor | Array) -> Tensor:
        t = torch.as_tensor(t)
        below = (t / self.step).floor().long().clamp(0, len(self.values) - 2)
        share = t / self.step - below
        stops, place = torch.unique(torch.stack([below, below + 1]), return_inverse=True)
        y = self._at(torch.as_tensor(rates)[..., None], stops)
        return (1.0 - share) * y[..., place[0]] + share * y[..., place[1]]

    def response_integral(self, rates: Tensor, t: Tensor, decay: float = 0.0) -> Tensor:
        raise InputError("The reference evaluates curves in the middle of frames; it knows no integral.")

    def _at(self, a: Tensor, stops: Tensor) -> Tensor:
        """The rectangle sum at some grid points: what each stretch adds, then from stop to stop."""
        grid = torch.arange(len(self.values))
        owner = torch.searchsorted(stops, grid).clamp(max=len(stops) - 1)
        inside = grid <= stops[-1]
        lag = self.step * (stops[owner] - grid).clamp(min=0)
        added = torch.exp(-a * lag) * (self.step * self.values * inside)
        stretches = added @ torch.nn.functional.one_hot(owner, len(stops)).to(added.dtype)
        fade = torch.exp(-a * self.step * torch.diff(stops, prepend=stops[:1]))
        y = [stretches[..., 0]]
        for n in range(1, len(stops)):
            y.append(y[-1] * fade[..., n] + stretches[..., n])
        return torch.stack(y, dim=-1)


def as_the_reference_reads(time: Array, plasma: Array, blood: Array, delay: float, last_frame: float) -> InputFunction:
    """Shifted by `delay`, zero-filled in front or cut at 0, then regridded.

    Args:
        time: min.
        plasma: kBq/mL.
        blood: kBq/mL.
        delay: min.
        last_frame: middle of the last frame, min; the grid ends there or at the last sample, whichever is later.
    """
    shifted = time + delay
    if delay > 0:
        shifted, plasma, blood = (np.concatenate([[0.0], v]) for v in (shifted, plasma, blood))
    else:
        plasma, blood, shifted = plasma[shifted >= 0], blood[shifted >= 0], shifted[shifted >= 0]
    grid = np.linspace(0.0, max(time.max(), last_frame), STEPS)
    plasma, blood = (torch.tensor(np.interp(grid, shifted, v)) for v in (plasma, blood))
    return InputFunction(RegriddedInput(float(grid[1]), plasma), PiecewiseLinear(torch.tensor(grid), blood))
