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
from petkin.fitting.results import Estimate, FitResult, Status

Array = NDArray[np.float64]

#: Start of the window where neither it nor t* is given, min.
_LATE = 30.0


def fit_uptake(
    label: str, curves: NDArray[np.floating], unit: Array, given: Given, choices: Choices, estimate: tuple[str, str]
) -> FitResult:
    """theta of every curve.

    Args:
        label: the method's, and the symbol of theta.
        curves: (N, K), kBq/mL.
        unit: g_k (K,), kBq/mL: frame values of a curve with theta = 1.
        given: frames and weights.
        choices: the window.
        estimate: unit of theta and what it is in words.

    Raises:
        InputError: no frame in the window, or no activity to divide by.
    """
    curves, frames = np.asarray(curves), given.observation.frames
    check_shapes(curves, given.weights, len(frames))
    inside, (start, end) = _window(given, choices, label)
    finite, usable = finite_curves(curves)
    d, w = frames.duration[inside], np.broadcast_to(given.weights, curves.shape)[:, inside]
    total = float(d @ unit[inside])
    if not total > 0:
        raise InputError(f"{label}: what is divided by holds no activity from {start:g} to {end:g} min.")
    value = (usable[:, inside] * d).sum(axis=1) / total
    predicted = np.full(curves.shape, np.nan)
    predicted[:, inside] = value[:, None] * unit[inside]
    count = int(inside.sum())
    with np.errstate(all="ignore"):
        variance = np.where(w > 0, d**2 / w, 0.0).sum(axis=1) / total**2
        leverage = 2.0 * d * unit[inside] / total
        freedom = np.where(w > 0, 1.0 - leverage, 0.0).sum(axis=1) + variance * (w * unit[inside] ** 2).sum(axis=1)
        wrss = (w * (usable - predicted)[:, inside] ** 2).sum(axis=1)
        chi2 = wrss / (freedom if count > 1 else np.nan)
        percent = 100.0 * np.sqrt(chi2 * variance) / np.abs(value)
    status = np.full(len(curves), Status.OK, np.uint8)
    status[percent > 100.0] = Status.NOT_IDENTIFIABLE
    status[~(usable.sum(axis=1) > 0)] = Status.NO_SIGNAL
    status[~finite] = Status.NOT_FINITE
    blank = np.where((status == Status.NO_SIGNAL) | (status == Status.NOT_FINITE), np.nan, 1.0)
    return FitResult(
        model=label,
        estimates=(Estimate(label, estimate[0], value * blank, percent * blank, estimate[1]),),
        chi2=chi2 * blank,
        aicc=np.full(len(curves), np.nan),
        status=status,
        weights=given.weights,
        predicted=predicted * blank[:, None],
        settings={"window": [start, end], "frames_used": count},
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
