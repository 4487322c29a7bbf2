"""Methods whose equation holds from some time t* on: the fit, and the pictures that show whether it does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting import Choices, FitResult, Given, Plot
from petkin.fitting.curves import check_shapes
from petkin.fitting.linear import LinearDesign
from petkin.fitting.regression import Regression, fit_linear
from petkin.fitting.t_star import TStar, find_t_star, from_t_star

Array = NDArray[np.float64]

#: Curves in a picture.
_SHOWN = 6


@dataclass(frozen=True)
class Axes:
    """How a method's line is drawn.

    Args:
        x_label, y_label: with units.
        of: design, tissue curves to integrate (N, K) and values to draw (N, K), to x and y (N, K); values that solve
            the equation lie on the line.
    """

    x_label: str
    y_label: str
    of: Callable[[LinearDesign, Array, Array], tuple[Array, Array]]


@dataclass(frozen=True)
class LateEquation:
    """An equation that holds from t* on.

    Args:
        regression: what its unknowns mean.
        design: the equation in all frames, from what the scan gives and the blood volume taken off beforehand.
        axes: of the plot in which it is a line.
    """

    regression: Regression
    design: Callable[[Given, float], LinearDesign]
    axes: Axes


def fit_late(
    equation: LateEquation, curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool
) -> FitResult:
    """The equation in frames from t* on, t* as chosen or, if that was left to the curves, as they tell.

    Raises:
        InputError: too few frames after t*, weights of each curve its own, or a blood volume outside [0, 1).
    """
    label, frames = equation.regression.label, given.observation.frames
    check_shapes(np.asarray(curves), np.asarray(given.weights), len(frames))
    vB = choices.fixed.get("vB", 0.0)
    design = equation.design(given, vB)
    found, t_star = None, choices.t_star
    if t_star is None:
        found = find_t_star(curves, design, frames, equation.regression)
        t_star = found.minutes
    late = from_t_star(design, frames, t_star, label)
    settings = {"t_star": t_star, "t_star_from": "choice" if found is None else "curves", "vB": vB}
    result = fit_linear(curves, late, equation.regression, settings=settings, keep_predicted=not voxels)
    if voxels:
        return result
    return replace(result, plots=_plots(equation, late, result, np.asarray(curves, np.float64), t_star, found))


def without_blood(given: Given, vB: float, label: str) -> tuple[Array, float]:
    """Blood to take off every curve (K,), kBq/mL, and what the rest is multiplied by to be tissue alone.

    Raises:
        InputError: the volume is no fraction of the tissue.
    """
    if not 0.0 <= vB < 1.0:
        raise InputError(f"A blood volume fraction of {vB:g} cannot be taken off; it lies in [0, 1).")
    if vB == 0.0:
        return np.zeros(len(given.observation.frames)), 1.0
    return vB * np.asarray(given.observation.of_forcing(given.input(label).whole_blood)), 1.0 / (1.0 - vB)


def _plots(
    equation: LateEquation, late: LinearDesign, result: FitResult, curves: Array, t_star: float, found: TStar | None
) -> tuple[Plot, ...]:
    outcome = result.estimates[0]
    shown = _spread(np.asarray(outcome.value, np.float64))
    if not len(shown):
        return ()
    assert result.predicted is not None
    tissue = (curves[shown] - late.offset) * late.scale
    fitted = (result.predicted[shown] - late.offset) * late.scale
    with np.errstate(all="ignore"):
        x, y = equation.axes.of(late, tissue, tissue)
        line_x, line_y = equation.axes.of(late, tissue, fitted)
    names = [str(n + 1) for n in shown]
    used = late.used
    mark = float(x[0, used[0]]) if (x == x[0]).all() else None
    line = Plot(
        title=f"{equation.regression.label} plot",
        x_label=equation.axes.x_label,
        y_label=equation.axes.y_label,
        points=tuple((name, a, b) for name, a, b in zip(names, x, y)),
        lines=tuple((name, a[used], b[used]) for name, a, b in zip(names, line_x, line_y)),
        mark=mark,
        text=f"Points: frames; lines: the fit, over the {len(used)} frames from t* = {t_star:.4g} min on.",
    )
    return (line,) if found is None else (line, _search(found, shown, names, outcome.symbol, outcome.unit))


def _search(found: TStar, shown: NDArray[np.intp], names: list[str], symbol: str, unit: str) -> Plot:
    chosen = int(np.flatnonzero(found.starts == found.minutes)[0])
    change = 100.0 / (1.0 + found.drift[chosen]) - 100.0
    return Plot(
        title="Choice of t*",
        x_label="start of the first frame used (min)",
        y_label=f"{symbol} ({unit})",
        points=tuple((name, found.starts, found.outcomes[n]) for name, n in zip(names, shown)),
        mark=found.minutes,
        text=f"t* = {found.minutes:.4g} min. Without the earlier half of the frames after it {symbol} of the median "
        f"curve would change by {change:+.1f} %; its standard error is {100 * found.error[chosen]:.1f} %.",
    )


def _spread(values: Array) -> NDArray[np.intp]:
    """A few curves from the lowest value to the highest."""
    order = np.argsort(values, kind="stable")[: int(np.isfinite(values).sum())]
    return order[np.unique(np.linspace(0, len(order) - 1, min(_SHOWN, len(order))).round().astype(int))]
