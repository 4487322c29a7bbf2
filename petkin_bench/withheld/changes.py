"""What a cause does to blood, tissue, clock and scanner, as functions of its size and of what it drew."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.observe import Change, Clock, Grid
from petkin_bench.withheld.subject import Blood, Frames, Subject

Array = NDArray[np.float64]
#: size, and what the cause drew, to a change.
Build = Callable[[float, "Draw"], Change]


@dataclass(frozen=True)
class Draw:
    """What a cause draws besides its size: onset and length (min), a region, a frame, a sign, a weight a region.

    `sizes`, where given, are those of all regions of a local cause, in place of 1 in its region.
    """

    onset: float
    region: int
    frame: int
    sign: float
    length: float
    weights: Array
    sizes: Array | None = None

    @property
    def chosen(self) -> Array:
        """1 in the region, 0 elsewhere (R, 1)."""
        if self.sizes is not None:
            return self.sizes[:, None]
        return (np.arange(self.weights.size) == self.region).astype(float)[:, None]


def blood(change: Callable[[Blood, float, Draw], Blood]) -> Build:
    return lambda size, d: Change(blood=lambda b: change(b, size, d))


def scanner(change: Callable[[Array, Frames, float, Draw], Array]) -> Build:
    return lambda size, d: Change(scanner=lambda x, f: change(x, f, size, d))


def smeared(t: Array, u: Array, tau: float) -> Array:
    """(1/tau) e^{-t/tau} * u for u straight between times, exactly; u itself where tau is 0."""
    if tau == 0.0:
        return u
    out = np.zeros_like(u)
    for i, h in enumerate(np.diff(t)):
        keep = math.exp(-h / tau)
        slope = (u[i + 1] - u[i]) / h
        out[i + 1] = out[i] * keep + u[i] * (1.0 - keep) + slope * (h - tau * (1.0 - keep))
    return out


def _arrived(b: Blood, change: Callable[[Array], Array]) -> Blood:
    tracer = change(b.total * b.parent)
    total = change(b.total)
    return Blood(b.t, total, np.where(total > 0, tracer / np.maximum(total, 1e-12), 1.0), change(b.whole))


def dispersed(b: Blood, size: float, _: Draw) -> Blood:
    return _arrived(b, lambda u: smeared(b.t, u, size / 60.0))


def dispersed_twice(b: Blood, size: float, _: Draw) -> Blood:
    """A gamma kernel of power 2, as of two mixing volumes in a row."""
    return _arrived(b, lambda u: smeared(b.t, smeared(b.t, u, size / 120.0), size / 120.0))


def delayed(b: Blood, size: float, _: Draw) -> Blood:
    return _arrived(b, lambda u: np.interp(b.t - size / 60.0, b.t, u, left=0.0))


def metabolised(power: float) -> Callable[[Blood, float, Draw], Blood]:
    def change(b: Blood, size: float, d: Draw) -> Blood:
        half = d.length
        return replace(b, parent=b.parent * (1.0 - d.sign * size * b.t**power / (b.t**power + half**power)))

    return change


def metabolised_exponential(b: Blood, size: float, d: Draw) -> Blood:
    return replace(b, parent=b.parent * (1.0 - size * (1.0 - np.exp(-b.t / d.length))))


def metabolised_power(b: Blood, size: float, d: Draw) -> Blood:
    """A power of the fraction: it falls as if its logarithm were read too small, or too large."""
    return replace(b, parent=b.parent ** (1.0 + d.sign * size))


def more_metabolites(b: Blood, size: float, d: Draw) -> Blood:
    """All metabolites by a share more than were found, or fewer; no more than all of the plasma."""
    return replace(b, parent=np.clip(1.0 - (1.0 + d.sign * size) * (1.0 - b.parent), 0.0, 1.0))


def sooner_metabolised(b: Blood, size: float, d: Draw) -> Blood:
    """Odds of metabolites larger by a factor, or smaller: the fraction runs faster, or more slowly."""
    odds = (1.0 - b.parent) / b.parent * np.exp(d.sign * size)
    return replace(b, parent=1.0 / (1.0 + odds))


def second_bolus(b: Blood, size: float, d: Draw) -> Blood:
    """Tracer from the line's dead volume arrives later, after the manual samples were taken."""
    s = np.maximum(b.t - d.onset, 0.0) / 1.5
    return replace(b, total=b.total + size * float(b.total.max()) * s * np.exp(1.0 - s))


def trickle(b: Blood, size: float, d: Draw) -> Blood:
    """The pump goes on at a steady rate for a while, which the record does not know."""
    gone_on = np.clip((b.t - d.onset) / 0.5, 0.0, 1.0) * np.clip((d.onset + d.length - b.t) / 0.5, 0.0, 1.0)
    return replace(b, total=b.total + size * float(b.total.max()) * gone_on)


def misread(b: Blood, size: float, d: Draw) -> Blood:
    """Samples around a time were counted wrongly."""
    return replace(b, total=b.total * (1.0 + size * np.exp(-0.5 * ((b.t - d.onset) / d.length) ** 2)))


def _area(t: Array, u: Array) -> Array:
    area = np.zeros(t.size)
    area[1:] = np.cumsum(0.5 * (u[1:] + u[:-1]) * np.diff(t))
    return area


def trapped(back: float) -> Build:
    """Kb of the vessels' walls, with a slow return or none."""

    def added(grid: Grid, subject: Subject, size: float) -> Array:
        held = _area(grid.t, grid.whole[::2])
        if back:
            held = smeared(grid.t, grid.whole[::2], 1.0 / back) / back
        return subject.vB[:, None] * size * held

    return lambda size, d: Change(added=lambda grid, subject: added(grid, subject, size))


def leaked(late: float) -> Build:
    """Metabolites in the tissue: one compartment, or one behind another."""

    def added(grid: Grid, subject: Subject, size: float) -> Array:
        free = (grid.total - grid.plasma)[::2]
        held = smeared(grid.t, free, 10.0) * 10.0
        held = smeared(grid.t, held, late) if late else held
        return (1.0 - subject.vB[:, None]) * size * subject.rates[:, :1] * held

    return lambda size, d: Change(added=lambda grid, subject: added(grid, subject, size))


def course(change: Callable[[Array, float, Draw], Array], *which: int, local: bool = False) -> Build:
    """Factors 1 + change of the rates named by their place."""

    def build(size: float, d: Draw) -> Change:
        def course(t: Array) -> Array:
            found = np.ones((d.weights.size, 4, t.size))
            where = d.chosen if local else np.ones((d.weights.size, 1))
            for rate in which:
                found[:, rate] += where * change(t, size, d)
            return found

        return Change(course=course)

    return build


def step_course(t: Array, size: float, d: Draw) -> Array:
    return np.where(t >= d.onset, d.sign * size, 0.0)


def ramp_course(t: Array, size: float, d: Draw) -> Array:
    return d.sign * size * np.clip((t - d.onset) / 5.0, 0.0, 1.0)


def released(t: Array, size: float, d: Draw) -> Array:
    x = np.maximum(t - d.onset, 0.0) / d.length
    return size * x * np.exp(1.0 - x)


def triangle_course(t: Array, size: float, d: Draw) -> Array:
    x = (t - d.onset) / d.length
    return size * np.clip(np.minimum(x, 2.0 - 0.6 * x), 0.0, None)


def plateau_course(t: Array, size: float, d: Draw) -> Array:
    return size * np.clip((t - d.onset) / 4.0, 0.0, 1.0) * np.clip((d.onset + 2.5 * d.length - t) / 4.0, 0.0, 1.0)


def wave_course(t: Array, size: float, d: Draw) -> Array:
    return size * np.sin(2.0 * np.pi * t / (2.0 * d.length) + d.weights[0])


def later(frames: Frames, onset: float, soft: float = 0.0) -> Array:
    """Share of every frame after the onset, or a smooth rise about it."""
    if soft:
        return 1.0 / (1.0 + np.exp(-(frames.mid - onset) / soft))
    return np.clip((frames.end - onset) / (frames.end - frames.start), 0.0, 1.0)


def from_others(x: Array) -> Array:
    """What comes in from other regions; where there are none, nothing changes."""
    return (x.sum(axis=0) - x) / (len(x) - 1) if len(x) > 1 else x


def from_next(x: Array) -> Array:
    return np.roll(x, 1, axis=0)


def passed(f: Frames) -> Array:
    return f.mid / f.end[-1]


def hot(x: Array, f: Frames) -> Array:
    rate = x.mean(axis=0) * np.exp(-f.decay * f.mid)
    return rate / rate.max()


def one_frame(x: Array, f: Frames, size: float, d: Draw) -> Array:
    return x * (1.0 + d.sign * size * (np.arange(f.start.size) == d.frame))


def clipped(x: Array, f: Frames, size: float) -> Array:
    """var / value of a frame, in units of the noisiest."""
    variance = np.maximum(x, 0.05 * x.max(axis=1, keepdims=True)) / f.counted
    excess = variance / np.maximum(x, 0.05 * x.max(axis=1, keepdims=True))
    return x + size * x.mean(axis=0).max() * excess / excess.max()


def wrong_half_life(excess: float) -> Callable[[Array, Frames, float, Draw], Array]:
    """Counts divided by what a wrong half-life makes of the frame; the excess is the size where it is 0."""

    def change(x: Array, f: Frames, size: float, d: Draw) -> Array:
        wrong = f.decay * (1.0 + (excess or d.sign * size))
        return x * f.counted * wrong / (np.exp(-wrong * f.start) - np.exp(-wrong * f.end))

    return change


def corrected(excess: float) -> Build:
    return lambda size, d: Change(clock=Clock(excess=excess or d.sign * size))


MEAN_LIFE = 1.0 / math.log(2.0) - 1.0


def shapes(x: Array, f: Frames, size: float, d: Draw) -> Array:
    """Every region drifts by its own smooth curve."""
    p = 2.0 * passed(f) - 1.0
    curves = np.stack([np.cos(np.pi * (k % 3 + 1) * p + w) for k, w in enumerate(d.weights)])
    return x * (1.0 + size * curves)
