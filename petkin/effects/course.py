"""Tissue whose rates change while it is watched, or bind ever less: the departure from constant rates, by small steps.

    dC_1/dt = K1 m(t) C_P - (k2 m(t) n(t) + k3 o) C_1 + k4 C_2,     dC_2/dt = k3 o C_1 - k4 C_2,

m the flow, n the release (both 1 before their onset), o = 1 - s C_2 / max C_2 of free sites. Only the difference to
constant rates is taken from the steps (implicit trapezoid), so that their error is that of a small quantity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import Forcing
from petkin.imaging import FrameObservation
from petkin.jit import njit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Course:
    """How rates depart from constant ones; every amplitude is a number or one a region.

    Args:
        flow: relative change of K1 and k2.
        changed: from when on, min.
        release: relative change of k2 at its peak.
        released: when it begins, min.
        width: from then to the peak, min.
        saturation: share of the sites that the fullest moment of a region occupies.
    """

    flow: Any = 0.0
    changed: float = 0.0
    release: Any = 0.0
    released: float = 0.0
    width: float = 10.0
    saturation: Any = 0.0

    def _amplitudes(self, shape: tuple[int, ...]) -> Array:
        """Of flow, release and saturation (3, curves)."""
        found = np.empty((3, *shape))
        found[0], found[1], found[2] = self.flow, self.release, self.saturation
        return found.reshape(3, -1)

    def departure(self, rates: Array, plasma: Forcing, clock: FrameObservation) -> Array:
        """Frame values with this course less those at constant rates.

        Args:
            rates: K1, k2, k3, k4 (..., C, 4).
            plasma: C_P.
            clock: frames.

        Returns:
            (..., C, K), kBq/mL.
        """
        edges = np.concatenate([clock.frames.start, clock.frames.end, [0.0]])
        onsets = [onset for size, onset in ((self.flow, self.changed), (self.release, self.released)) if np.any(size)]
        times = _steps(edges[edges >= 0], onsets, plasma)
        flow, release, saturation = self._amplitudes(rates.shape[:-1])
        since = times - self.released
        rise = np.where(since > 0, since / self.width * np.exp(1.0 - since / self.width), 0.0)
        started = _part_after(times, self.changed)
        u = np.asarray(plasma(times))
        curves = _difference(times, u, rates.reshape(-1, 4), flow, release, saturation, rise, started)
        return _framed(times, curves, clock).reshape(*rates.shape[:-1], -1)


def _steps(edges: Array, onsets: list[float], plasma: Forcing) -> Array:
    """2 s while the input is sharp, half a minute later, and never across an edge or an onset."""
    end = edges.max()
    knots = np.asarray(plasma.knots)
    arrival = max(float(knots[0]), 0.0)
    fine = [np.arange(0.0, min(arrival + 5.0, end), 1 / 30), np.arange(min(arrival + 5.0, end), end, 0.5)]
    times = np.concatenate([*fine, edges, np.clip(onsets, 0.0, end)])
    return np.unique(np.round(times.astype(np.float64), 9))


def _part_after(times: Array, onset: float) -> Array:
    """1 in steps after the onset, which lies on a time; one a step, the first padded."""
    return (times >= onset - 1e-9).astype(float)


@njit()
def _difference(times, u, rates, flow, release, saturation, rise, started):
    curves = np.zeros((rates.shape[0], times.size))
    for c in range(rates.shape[0]):
        K1, k2, k3, k4 = rates[c]
        top = 0.0
        for changed in range(2):
            one = two = 0.0
            for i in range(times.size - 1):
                d = times[i + 1] - times[i]
                m = p = 1.0
                q, free = 1.0, 1.0
                if changed:
                    m = 1.0 + flow[c] * started[i]
                    p = m * (1.0 + release[c] * rise[i])
                    q = m * (1.0 + release[c] * rise[i + 1])
                    free = max(1.0 - saturation[c] * two / top, 0.0) if top > 0 else 1.0
                into = k3 * free
                r1 = one + 0.5 * d * (K1 * m * (u[i] + u[i + 1]) - (k2 * p + into) * one + k4 * two)
                r2 = two + 0.5 * d * (into * one - k4 * two)
                a11, a12 = 1.0 + 0.5 * d * (k2 * q + into), -0.5 * d * k4
                a21, a22 = -0.5 * d * into, 1.0 + 0.5 * d * k4
                det = a11 * a22 - a12 * a21
                one, two = (a22 * r1 - a12 * r2) / det, (a11 * r2 - a21 * r1) / det
                if changed:
                    curves[c, i + 1] += one + two
                else:
                    curves[c, i + 1] -= one + two
                    top = max(top, two)
    return curves


def _framed(times: Array, curves: Array, clock: FrameObservation) -> Array:
    """Decay-weighted means of straight pieces over frames, whose edges are among the times."""
    start, end = (
        np.searchsorted(times, np.round(np.maximum(e, 0.0), 9)) for e in (clock.frames.start, clock.frames.end)
    )
    return _integrals(times, curves, np.exp(-clock.decay * times), start, end) / clock.divisor


@njit()
def _integrals(times, curves, weight, start, end):
    found, area = np.empty((curves.shape[0], start.size)), np.zeros(times.size)
    for c in range(curves.shape[0]):
        for i in range(times.size - 1):
            here, there = curves[c, i] * weight[i], curves[c, i + 1] * weight[i + 1]
            area[i + 1] = area[i] + 0.5 * (here + there) * (times[i + 1] - times[i])
        for k in range(start.size):
            found[c, k] = area[end[k]] - area[start[k]]
    return found
