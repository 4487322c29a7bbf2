"""Frame values of a subject with any changes in it: Runge-Kutta steps, trapezoids, frames.

    dC_1/dt = K1 m_1 C_P - (k2 m_2 + k3 m_3 o) C_1 + k4 m_4 C_2,    dC_2/dt = k3 m_3 o C_1 - (k4 m_4 + k5) C_2

m the course of the rates, o the free sites, k5 C_2 trapped for good (and still seen).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from petkin_bench.withheld.subject import Blood, Frames, Subject

Array = NDArray[np.float64]


class Clock(NamedTuple):
    """How frames and decay truly were: late by minutes, over-corrected by a share of decay, read at mid-frame."""

    late: float = 0.0
    excess: float = 0.0
    mid_frame: bool = False


_STATED = Clock()


class Grid(NamedTuple):
    """Times of steps (T,) and the blood that arrives at the tissue then, at times and between (2 T - 1,)."""

    t: Array
    plasma: Array
    total: Array
    whole: Array


@dataclass(frozen=True)
class Change:
    """What a cause changes; a part that is None is as always.

    Args:
        blood: the record -> what arrives.
        course: times -> factors of K1 k2 k3 k4 (R, 4, times).
        filling: share of the sites that are taken when a region is fullest, and whether they fill hyperbolically.
        trapped: k5, 1/min.
        spread: weights and factors of K1 and k2 of the parts of a region.
        added: what is seen besides tissue and blood (R, T).
        clock: frames and decay.
        scanner: frame values -> what the scanner makes of them.
    """

    blood: Callable[[Blood], Blood] | None = None
    course: Callable[[Array], Array] | None = None
    filling: tuple[float, bool] = (0.0, False)
    trapped: float = 0.0
    spread: tuple[tuple[float, float], ...] = ((1.0, 1.0),)
    added: Callable[[Grid, Subject], Array] | None = None
    clock: Clock = _STATED
    scanner: Callable[[Array, Frames], Array] | None = None


def observe(subject: Subject, changes: tuple[Change, ...] = ()) -> Array:
    """Frame values (R, K), corrected for decay as a file would hold them."""
    late = sum(c.clock.late for c in changes)
    grid = _grid(subject, changes, late)
    curves = _curves(grid, subject, changes)
    for change in changes:
        if change.added is not None:
            curves = curves + change.added(grid, subject)
    values = _framed(grid.t, curves, subject.frames, late, changes)
    for change in changes:
        if change.scanner is not None:
            values = change.scanner(values, subject.frames)
    return values


def _grid(subject: Subject, changes: tuple[Change, ...], late: float) -> Grid:
    blood = subject.blood
    for change in changes:
        blood = blood if change.blood is None else change.blood(blood)
    end = float(subject.frames.end[-1]) + max(late, 0.0)
    fine = [np.arange(0.0, 4.0, 1 / 120), np.arange(4.0, 12.0, 1 / 12), np.arange(12.0, end, 0.25)]
    edges = np.concatenate([subject.frames.start, subject.frames.end]) + late
    t = np.unique(np.concatenate([*fine, edges[edges > 0], [end]]).round(7))
    every = np.empty(2 * t.size - 1)
    every[::2], every[1::2] = t, 0.5 * (t[1:] + t[:-1])
    total, parent, whole = (
        np.interp(every - subject.delay, blood.t, c, left=0.0) for c in (blood.total, blood.parent, blood.whole)
    )
    return Grid(t, total * parent, total, whole)


def _curves(grid: Grid, subject: Subject, changes: tuple[Change, ...]) -> Array:
    parts: tuple[tuple[float, float], ...] = ((1.0, 1.0),)
    filling, hyperbolic, trapped = 0.0, False, 0.0
    course = np.ones((len(subject.rates), 4, 1))
    every = np.empty(grid.plasma.size)
    every[::2], every[1::2] = grid.t, 0.5 * (grid.t[1:] + grid.t[:-1])
    for change in changes:
        parts = change.spread if len(change.spread) > 1 else parts
        filling, hyperbolic = change.filling if change.filling[0] else (filling, hyperbolic)
        trapped += change.trapped
        if change.course is not None:
            course = course * change.course(every)
    total = np.zeros((len(subject.rates), grid.t.size))
    for weight, factor in parts:
        rates = subject.rates * np.array([factor, factor, 1.0, 1.0])
        top = np.ones(len(rates))
        if filling:
            none = np.zeros(len(rates))
            top = tissue(grid.t, grid.plasma, rates, np.ones((len(rates), 4, 1)), none, False, 0.0)[1].max(axis=1)
        filled = filling / np.maximum(top, 1e-9)
        total += weight * tissue(grid.t, grid.plasma, rates, course, filled, hyperbolic, trapped)[0]
    vB = subject.vB[:, None]
    return (1.0 - vB) * total + vB * grid.whole[::2]


@njit(cache=True, error_model="numpy")
def _slope(a, b, u, rates, k5, fill, hyperbolic):
    K1, k2, k3, k4 = rates
    taken = fill * b
    free = 1.0 / (1.0 + taken) if hyperbolic else max(1.0 - taken, 0.0)
    bound = k3 * free * a
    return K1 * u - k2 * a - bound + k4 * b, bound - (k4 + k5) * b


@njit(cache=True, error_model="numpy")
def _rates(rates, course, i):
    return rates[0] * course[0, i], rates[1] * course[1, i], rates[2] * course[2, i], rates[3] * course[3, i]


@njit(cache=True, error_model="numpy")
def tissue(t, u, rates, course, fill, hyperbolic, k5):
    """All tracer in the tissue (R, T), and that of the second compartment, by Runge-Kutta steps of fourth order."""
    whole, second = np.zeros((rates.shape[0], t.size)), np.zeros((rates.shape[0], t.size))
    still = course.shape[2] == 1
    for r in range(rates.shape[0]):
        a = b = c = 0.0
        p = q = s = _rates(rates[r], course[r], 0)
        for i in range(t.size - 1):
            h = t[i + 1] - t[i]
            if not still:
                p, q, s = s, _rates(rates[r], course[r], 2 * i + 1), _rates(rates[r], course[r], 2 * i + 2)
            a1, b1 = _slope(a, b, u[2 * i], p, k5, fill[r], hyperbolic)
            a2, b2 = _slope(a + 0.5 * h * a1, b + 0.5 * h * b1, u[2 * i + 1], q, k5, fill[r], hyperbolic)
            a3, b3 = _slope(a + 0.5 * h * a2, b + 0.5 * h * b2, u[2 * i + 1], q, k5, fill[r], hyperbolic)
            a4, b4 = _slope(a + h * a3, b + h * b3, u[2 * i + 2], s, k5, fill[r], hyperbolic)
            before = b
            a += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
            b += h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
            c += 0.5 * h * k5 * (before + b)
            whole[r, i + 1], second[r, i + 1] = a + b + c, b
    return whole, second


def _framed(t: Array, curves: Array, frames: Frames, late: float, changes: tuple[Change, ...]) -> Array:
    if any(c.clock.mid_frame for c in changes):
        return np.stack([np.interp(frames.mid, t, row) for row in curves])
    excess = sum(c.clock.excess for c in changes)
    weighted = curves * np.exp(-frames.decay * (1.0 - excess) * t)
    pieces = 0.5 * (weighted[:, 1:] + weighted[:, :-1]) * np.diff(t)
    area = np.concatenate([np.zeros((len(curves), 1)), np.cumsum(pieces, axis=1)], axis=1)
    start, end = (np.stack([np.interp(e + late, t, row, left=0.0) for row in area]) for e in (frames.start, frames.end))
    return (end - start) / frames.counted
