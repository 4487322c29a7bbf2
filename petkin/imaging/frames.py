"""When the scanner counted: one `FrameSchedule` for all frame geometry, and what a frame reports of a curve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petkin.dynamics.arrays import alike
from petkin.errors import InputError
from petkin.units import SECONDS_PER_MINUTE

if TYPE_CHECKING:
    from jaxtyping import Float

Array = NDArray[np.float64]

#: Frame edges in files are rounded; overlaps below this (min) are rounding.
_EDGE_TOLERANCE = 1e-3


@dataclass(frozen=True)
class FrameSchedule:
    """Frames in minutes from time zero; ascending, not overlapping, gaps allowed (interrupted scans).

    Args:
        start: frame starts, min.
        end: frame ends, min.
        where: file or option that they came from, for messages.
    """

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    where: str = "the frame schedule"

    def __post_init__(self) -> None:
        start, end = np.asarray(self.start, np.float64), np.asarray(self.end, np.float64)
        object.__setattr__(self, "start", start)
        object.__setattr__(self, "end", end)
        if start.ndim != 1 or start.shape != end.shape or start.size == 0:
            raise InputError(f"{self.where}: {start.size} frame starts but {end.size} ends; give one of each a frame.")
        if not (np.isfinite(start).all() and np.isfinite(end).all()):
            raise InputError(f"{self.where}: a frame time is not a finite number.")
        for k in range(start.size):
            if end[k] <= start[k]:
                raise InputError(
                    f"{self.where}: frame {k + 1} lasts {(end[k] - start[k]) * SECONDS_PER_MINUTE:g} s; "
                    "every frame must last longer than 0 s."
                )
            if k and start[k] < end[k - 1] - _EDGE_TOLERANCE:
                raise InputError(
                    f"{self.where}: frame {k + 1} starts at {start[k] * SECONDS_PER_MINUTE:g} s but frame {k} ends at "
                    f"{end[k - 1] * SECONDS_PER_MINUTE:g} s; frames must not overlap: check FrameTimesStart."
                )

    @classmethod
    def from_seconds(
        cls, start_s: ArrayLike, duration_s: ArrayLike, *, where: str = "the frame schedule"
    ) -> FrameSchedule:
        """From starts and durations in seconds, as sidecars give them."""
        start, duration = np.asarray(start_s, np.float64), np.asarray(duration_s, np.float64)
        if start.shape != duration.shape:
            raise InputError(f"{where}: {start.size} values in FrameTimesStart but {duration.size} in FrameDuration.")
        return cls(start / SECONDS_PER_MINUTE, (start + duration) / SECONDS_PER_MINUTE, where=where)

    @classmethod
    def uniform(cls, count: int, duration: float) -> FrameSchedule:
        """`count` frames of `duration` minutes from time zero."""
        edges = np.linspace(0.0, count * duration, count + 1)
        return cls(edges[:-1], edges[1:])

    def __len__(self) -> int:
        return self.start.size

    @property
    def duration(self) -> NDArray[np.float64]:
        return self.end - self.start

    @property
    def mid(self) -> NDArray[np.float64]:
        return 0.5 * (self.start + self.end)

    @property
    def gaps(self) -> NDArray[np.float64]:
        """Uncounted minutes before each frame but the first."""
        return np.maximum(self.start[1:] - self.end[:-1], 0.0)


@dataclass(frozen=True)
class FrameObservation:
    """What frames report of a decay-corrected curve C(t).

    * `FrameObservation(frames, lam)`: x_k = int_k C e^{-lam t} dt / int_k e^{-lam t} dt, what a scanner's
      decay-corrected frame holds; lam = 0 is the plain time average.
    * `corrected=False`: x_k = 1/(t_k - t_{k-1}) int_k C e^{-lam t} dt, the paper's observation, not decay-corrected.
    * `mid_frame=True`: x_k = C at mid-frame: wrong by up to percents; only to compare with other programs.

    Args:
        frames: the schedule.
        decay: lam, 1/min.
        corrected: divide by the mean decay over the frame.
        mid_frame: evaluate instead of averaging.
        gain: factor (K,) on every value, of a processing that erred; None is none.
    """

    frames: FrameSchedule
    decay: float = 0.0
    corrected: bool = True
    mid_frame: bool = False
    gain: NDArray[np.float64] | None = None

    def of_forcing(self, forcing) -> Any:
        """x_k of the forcing itself (*b, frames): a tensor if the forcing holds tensors, else an array."""
        return self._observe(forcing, lambda t: forcing.integral(t, self.decay))

    def of_response(self, forcing, rates: Any) -> Any:
        """x_k of e^{-a t} * forcing for every rate a (1/min), (*rb, frames): a tensor if forcing or rates are."""
        return self._observe(
            lambda t: forcing.response(rates, t), lambda t: forcing.response_integral(rates, t, self.decay)
        )

    def _observe(self, curve: Callable[[Array], Any], cumulative: Callable[[Array], Any]) -> Any:
        if self.mid_frame:
            values, gain = alike(curve(self.frames.mid), self.gain_or_one)
            return values * gain
        both = np.concatenate([self.frames.start, self.frames.end])
        edges, place = np.unique(both, return_inverse=True)  # most ends are the next start
        areas, divisor = alike(cumulative(edges), self.divisor)
        areas = areas[..., place]
        return (areas[..., len(self.frames) :] - areas[..., : len(self.frames)]) / divisor

    @cached_property
    def divisor(self) -> Float[Array, " frames"]:
        """What the frame's integral is divided by to give its value, min."""
        plain = self.mean_decay_times_duration if self.corrected else self.frames.duration
        return plain if self.gain is None else plain / self.gain

    @property
    def gain_or_one(self) -> Float[Array, " frames"]:
        return np.ones(len(self.frames)) if self.gain is None else self.gain

    @cached_property
    def mean_decay_times_duration(self) -> Float[Array, " frames"]:
        """int_k e^{-lam t} dt, min."""
        start, duration = self.frames.start, self.frames.duration
        if self.decay == 0.0:
            return duration
        return np.exp(-self.decay * start) * -np.expm1(-self.decay * duration) / self.decay
