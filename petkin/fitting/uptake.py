"""Uptake in a window of time, in units of something else: of the injected dose, or of a reference region.

    theta = sum_k d_k y_k / sum_k d_k g_k,  frames k in the window, d_k their durations,

the ratio of two mean activities. With weights w that are inverse variances up to a factor s^2, and n frames,

    var theta = s^2 V,   V = sum_k d_k^2 / w_k / (sum_k d_k g_k)^2,
    s^2 = sum_k w_k (y_k - theta g_k)^2 / (n - 2 + V sum_k w_k g_k^2),

whose denominator is the expectation of the sum over s^2: what departs from a constant ratio, noise and drift alike,
counts as error.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting.choices import Choices
from petkin.fitting.curves import check_shapes, finite_curves
from petkin.fitting.given import Given
from petkin.fitting.parts import in_parts
from petkin.fitting.regression import weights_and_noise
from petkin.fitting.results import Estimate, FitResult, Status

Array = NDArray[np.float64]

#: Start of the window where neither it nor t* is given, min.
_LATE = 30.0


def fit_uptake(
    label: str,
    curves: NDArray[np.floating],
    unit: Array,
    given: Given,
    choices: Choices,
    meaning: tuple[str, str],
    *,
    keep_predicted: bool,
) -> FitResult:
    """theta of every curve.

    Args:
        label: the method's, and the symbol of theta.
        curves: (N, K), kBq/mL.
        unit: g_k (K,), kBq/mL: frame values of a curve with theta = 1.
        given: frames and weights.
        choices: the window.
        meaning: unit of theta and what it is in words.
        keep_predicted: return theta g_k, NaN outside the window.

    Raises:
        InputError: no frame in the window, no activity to divide by, or weights that differ between curves.
    """
    curves, frames = np.asarray(curves), given.observation.frames
    weights, noise = weights_and_noise(given.weights, label)
    check_shapes(curves, weights, len(frames))
    inside, (start, end) = _window(given, choices, label)
    d, g, w = frames.duration[inside], unit[inside], weights[inside]
    total = float(d @ g)
    if not total > 0:
        raise InputError(f"{label}: what is divided by holds no activity from {start:g} to {end:g} min.")
    variance = float(d**2 @ noise[inside]) / total**2
    freedom = float(np.sum((w > 0) * (1.0 - 2.0 * d * g / total))) + variance * float(w @ g**2)
    value, chi2 = (np.empty(len(curves)) for _ in range(2))
    status = np.empty(len(curves), np.uint8)

    def look_at(rows: slice) -> None:
        finite, usable = finite_curves(curves[rows])
        late = usable[:, inside]
        value[rows] = (late * d).sum(axis=1) / total
        wrss = (w * (late - value[rows, None] * g) ** 2).sum(axis=1)
        chi2[rows] = wrss / (freedom if len(d) > 1 else np.nan)
        signal = usable.sum(axis=1) > 0
        status[rows] = np.where(finite, np.where(signal, Status.OK, Status.NO_SIGNAL), Status.NOT_FINITE)

    in_parts(look_at, len(curves))
    with np.errstate(all="ignore"):
        percent = 100.0 * np.sqrt(chi2 * variance) / np.abs(value)
        status[(status == Status.OK) & (percent > 100.0)] = Status.NOT_IDENTIFIABLE
    blank = np.where((status == Status.NO_SIGNAL) | (status == Status.NOT_FINITE), np.nan, 1.0)
    value *= blank
    return FitResult(
        model=label,
        estimates=(Estimate(label, meaning[0], value, percent * blank, meaning[1]),),
        chi2=chi2 * blank,
        aicc=np.full(len(curves), np.nan),
        status=status,
        weights=weights,
        predicted=np.outer(value, np.where(inside, unit, np.nan)) if keep_predicted else None,
        settings={"window": [start, end], "frames_used": len(d)},
    )


def _window(given: Given, choices: Choices, label: str) -> tuple[NDArray[np.bool_], tuple[float, float]]:
    """Frames whose middle lies in the window, and when the first starts and the last ends."""
    frames = given.observation.frames
    since = _LATE if choices.t_star is None else choices.t_star
    low, high = choices.window or (since, float(frames.end[-1]))
    inside = (frames.mid >= low) & (frames.mid <= high)
    if not inside.any():
        raise InputError(
            f"{label}: no frame's middle lies from {low:g} to {high:g} min; the frames cover {frames.start[0]:g} to "
            f"{frames.end[-1]:g} min: give --window START:END."
        )
    return inside, (float(frames.start[inside][0]), float(frames.end[inside][-1]))
