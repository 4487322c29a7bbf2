"""Where the linear part of a method begins: one start a scan, told by its regional curves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting.linear import LinearDesign
from petkin.fitting.regression import Regression, fit_linear
from petkin.imaging import FrameSchedule

Array = NDArray[np.float64]

#: Bias that is left, per drift that is seen: 1 for Patlak's, 1.8 for Logan's on noise-free two-tissue curves.
_BIAS_PER_DRIFT = 2.0
#: Share of the largest outcome below which one is rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class TStar:
    """The start that was found, and what it was found from.

    Args:
        minutes: start of the first frame that takes part, min.
        starts: candidates (C,), min.
        outcomes: what the method is used for (N, C), a column a candidate.
        drift: by how much the median curve changes when the first half of the frames is left out (C,), a share.
        error: median standard error (C,), a share.
    """

    minutes: float
    starts: Array
    outcomes: Array
    drift: Array
    error: Array


def from_t_star(design: LinearDesign, frames: FrameSchedule, t_star: float, label: str) -> LinearDesign:
    """The equation in frames whose middle comes at or after t* (min).

    Raises:
        InputError: too few of them have weight.
    """
    late = replace(design, weights=np.where(frames.mid >= t_star, design.weights, 0.0))
    if len(late.used) <= late.unknowns:
        raise InputError(
            f"{label}: only {len(late.used)} frames with weight lie after t* = {t_star:g} min; "
            f"a line with an error needs {late.unknowns + 1}: choose an earlier --t-star."
        )
    return late


def find_t_star(
    curves: NDArray[np.floating], design: LinearDesign, frames: FrameSchedule, regression: Regression
) -> TStar:
    """The start with the least mean squared error that can be told from the curves themselves.

    A later start takes bias off and adds noise. The bias left at a start is told by the drift d of the outcome when
    the first half of its frames is left out, the noise by the standard error s; both are medians over curves, and
    (2 d)^2 + s^2 is made least.

    Args:
        curves: (N, K), kBq/mL; those that cannot be fitted have no say.
        design: the equation in all frames.
        frames: schedule.
        regression: what the unknowns mean.

    Raises:
        InputError: no curve, or too few frames to compare two starts.
    """
    used, least = design.used, design.unknowns + 1
    starts = range(len(used) - least + 1)
    candidates = [i for i in starts if len(used) - _half(i, len(used)) >= least]
    if not candidates:
        raise InputError(
            f"{regression.label}: {len(used)} frames with weight are too few to find t*; give it with --t-star."
        )
    outcomes, errors = np.empty((len(starts), len(curves))), np.empty((len(starts), len(curves)))
    for i in starts:
        late = replace(design, weights=np.where(np.arange(len(frames)) >= used[i], design.weights, 0.0))
        result = fit_linear(curves, late, regression, settings={}, keep_predicted=False)
        outcome = result.estimates[regression.outcome]
        outcomes[i], errors[i] = outcome.value, outcome.percent_se / 100.0
    # Of a reference region against itself the outcome is zero but for rounding: it tells of no change.
    rounding = _ROUNDING * np.abs(outcomes[np.isfinite(outcomes)]).max(initial=0.0)
    told = (np.isfinite(outcomes) & (np.abs(outcomes) > rounding)).all(axis=0)
    if not told.any():
        raise InputError(f"{regression.label}: no curve tells where its linear part begins; give it with --t-star.")
    later = outcomes[[_half(i, len(used)) for i in candidates]]
    outcomes, errors = outcomes[: len(candidates)], errors[: len(candidates)]
    drift = np.median(outcomes[:, told] / later[:, told] - 1.0, axis=1)
    error = np.median(errors[:, told], axis=1)
    best = int(np.argmin((_BIAS_PER_DRIFT * drift) ** 2 + error**2))
    times = frames.start[used[: len(candidates)]]
    return TStar(float(times[best]), times, outcomes.T, drift, error)


def _half(i: int, count: int) -> int:
    """First of the later half of the frames i .. count - 1."""
    return i + (count - i) // 2
