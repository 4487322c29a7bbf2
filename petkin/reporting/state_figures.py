"""What a law of tissue lacks, region by region: against time, and against the state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from petkin.imaging import FrameSchedule
from petkin.reporting.canvas import FIT_INK, INK, QUIET, Picture, new_figure, picture
from petkin.reporting.canvas import square_root_time as spread_early

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

_SHOWN = 6
#: Ends of bands beyond these quantiles are cut, and so much room is left around the others.
_QUANTILES, _ROOM = (0.02, 0.98), 0.06


@dataclass(frozen=True)
class LackingTerm:
    """A term with its band and claims.

    Args:
        regions: names (R).
        frames: schedule (K).
        state: C_T (R, K), kBq/mL.
        term, low, high: what its derivative lacks (R, K), kBq/mL/min.
        claimed: where (R, K).
        text: what it shows, and what it does not.
    """

    regions: tuple[str, ...]
    frames: FrameSchedule
    state: Array
    term: Array
    low: Array
    high: Array
    claimed: NDArray[np.bool_]
    text: tuple[str, ...]


def state_pictures(lacking: LackingTerm) -> list[Picture]:
    """One picture a region, those with most claims first. Call within `canvas.drawing()`."""
    order = np.argsort(-lacking.claimed.sum(axis=1), kind="stable")[:_SHOWN]
    return [_picture(lacking, int(r)) for r in order]


def _picture(lacking: LackingTerm, r: int) -> Picture:
    frames, claimed = lacking.frames, lacking.claimed[r]
    figure = new_figure(9.0, 2.7)
    by_time, by_state = figure.add_axes((0.08, 0.2, 0.42, 0.75)), figure.add_axes((0.56, 0.2, 0.42, 0.75))
    _drawn(by_time, frames.mid, lacking, r)
    if np.median(frames.mid) < 0.25 * frames.end[-1]:
        spread_early(by_time, float(frames.end[-1]))
    by_time.set_xlabel("time (min)")
    by_time.set_ylabel("flux (kBq/mL/min)")
    _drawn(by_state, lacking.state[r], lacking, r)
    by_state.set_xlabel("C_T (kBq/mL)")
    by_state.tick_params(labelleft=False)
    name = lacking.regions[r]
    alt = f"{name}: missing flux against time and against C_T; {claimed.sum()} of {claimed.size} frames are claimed."
    return picture(figure, alt=alt, heading=name, caption=f"{claimed.sum()} of {claimed.size} frames claimed")


def _root(values: Array) -> Array:
    """Signed square root, so that what is small late stands beside what is large at the bolus."""
    return np.sign(values) * np.sqrt(np.abs(values))


def _square(values: Array) -> Array:
    return np.sign(values) * values**2


def _drawn(ax: Axes, x: Array, lacking: LackingTerm, r: int) -> None:
    """Points with their bands, in the order of time; claimed ones filled."""
    term, low, high, claimed = (part[r] for part in (lacking.term, lacking.low, lacking.high, lacking.claimed))
    bottom, top = np.quantile(np.append(np.concatenate([low, high]), 0.0), _QUANTILES)
    room = _ROOM * (top - bottom) or 1.0
    ax.set_yscale("function", functions=(_root, _square))
    ax.set_ylim(float(bottom - room), float(top + room))
    ax.axhline(0.0, color=INK, lw=0.7)
    ax.vlines(x, low, high, color=QUIET, lw=0.9)
    ax.plot(x, term, color=QUIET, lw=0.7)
    ax.plot(x[~claimed], term[~claimed], "o", ms=3.6, mfc="white", mec=QUIET, mew=0.8)
    ax.plot(x[claimed], term[claimed], "o", ms=3.6, color=FIT_INK)
