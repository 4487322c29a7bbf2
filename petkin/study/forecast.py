"""Frames that were not fitted, forecast by what was fitted before them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, Column, FitResult, Given
from petkin.io import RegionalCurves
from petkin.methods import Method
from petkin.study.whole_brain import after


def with_forecast(
    result: FitResult, method: Method, curves: RegionalCurves, given: Given, choices: Choices, until: float
) -> FitResult:
    """Predicted values of the later frames, and how far they are from what was measured.

    Methods that do not say what every frame holds (plots, regressions) stay as they are.

    Args:
        result: the fit of the earlier frames.
        method: its method.
        curves: what was fitted.
        given: what the scan gave it.
        choices: what the user chose.
        until: min; later frames are forecast.
    """
    if result.predicted is None:
        return result
    later = after(curves.frames, until)
    predicted = result.predicted.copy()
    if method.nonlinear is not None:
        predicted[:, later] = _of_model(result, method, given, choices)[:, later]
    if not np.isfinite(predicted[:, later]).any():
        return result
    off = np.sqrt(np.mean((predicted - curves.values)[:, later] ** 2, axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        percent = 100.0 * off / np.abs(curves.values[:, later].mean(axis=1))
    meaning = f"root mean square of forecast minus measured, frames that end after {until:g} min, over their mean"
    column = Column("forecast", percent, meaning, "percent", mapped=False)
    return replace(result, predicted=predicted, columns=(*result.columns, column))


def _of_model(result: FitResult, method: Method, given: Given, choices: Choices) -> NDArray[np.float64]:
    """Frame values of a compartment model at its estimates (N, K)."""
    import torch

    assert method.nonlinear is not None
    model = method.nonlinear(choices, False).model
    found = {e.symbol: np.asarray(e.value, np.float64) for e in result.estimates}
    count = len(result.status)
    parameters = [found.get(s, np.full(count, choices.fixed.get(s, 0.0))) for s in model.parameters.symbols]
    values = np.stack(parameters, axis=-1)
    usable = np.isfinite(values).all(axis=1)
    frames = np.full((count, len(given.observation.frames)), np.nan)
    if usable.any():
        arterial = given.input(method.label)
        frames[usable] = model.frame_values(torch.tensor(values[usable]), arterial, given.observation).numpy()
    return frames
