"""What may be withheld: effects of the product's catalogue, the same in another form, and causes in no catalogue.

Written from the words of the effects' table, not from the product's code. A cause's size is scaled to a detectability;
what differs between scans besides, it draws for itself.
"""

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
    """What a cause draws besides its size: onset and length (min), a region, a frame, a sign, a weight a region."""

    onset: float
    region: int
    frame: int
    sign: float
    length: float
    weights: Array

    @property
    def chosen(self) -> Array:
        """1 in the region, 0 elsewhere (R, 1)."""
        return (np.arange(self.weights.size) == self.region).astype(float)[:, None]


@dataclass(frozen=True)
class Cause:
    """One cause.

    Args:
        name: in the catalogue's words; "" where it has none.
        stage: of the chain.
        build: the change.
        most: size beyond which it would not be plausible; a flag has none.
        onset, local, framed: whether it sets in at a time, acts in one region, concerns one frame.
        flag: there or not.
    """

    name: str
    stage: str
    build: Build
    most: float
    onset: bool = False
    local: bool = False
    framed: bool = False
    flag: bool = False


def draw(rng: np.random.Generator, subject: Subject) -> Draw:
    """Everything but the size; onsets lie after the bolus and before the last fifth of the scan."""
    end, regions = float(subject.frames.end[-1]), len(subject.rates)
    return Draw(
        onset=rng.uniform(0.12, 0.8) * end,
        region=int(rng.integers(regions)),
        frame=int(rng.integers(6, subject.frames.start.size - 2)),
        sign=float(rng.choice([-1.0, 1.0])),
        length=rng.uniform(5.0, 15.0),
        weights=rng.standard_normal(regions),
    )


def _blood(change: Callable[[Blood, float, Draw], Blood]) -> Build:
    return lambda size, d: Change(blood=lambda b: change(b, size, d))


def _scanner(change: Callable[[Array, Frames, float, Draw], Array]) -> Build:
    return lambda size, d: Change(scanner=lambda x, f: change(x, f, size, d))


def smeared(t: Array, u: Array, tau: float) -> Array:
    """(1/tau) e^{-t/tau} * u for u straight between times, exactly."""
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


def _dispersed(b: Blood, size: float, _: Draw) -> Blood:
    return _arrived(b, lambda u: smeared(b.t, u, size / 60.0))


def _dispersed_twice(b: Blood, size: float, _: Draw) -> Blood:
    """A gamma kernel of power 2, as of two mixing volumes in a row."""
    return _arrived(b, lambda u: smeared(b.t, smeared(b.t, u, size / 120.0), size / 120.0))


def _delayed(b: Blood, size: float, _: Draw) -> Blood:
    return _arrived(b, lambda u: np.interp(b.t - size / 60.0, b.t, u, left=0.0))


def _metabolised(power: float) -> Callable[[Blood, float, Draw], Blood]:
    def change(b: Blood, size: float, d: Draw) -> Blood:
        half = d.length
        return replace(b, parent=b.parent * (1.0 - d.sign * size * b.t**power / (b.t**power + half**power)))

    return change


def _metabolised_exponential(b: Blood, size: float, d: Draw) -> Blood:
    return replace(b, parent=b.parent * (1.0 - size * (1.0 - np.exp(-b.t / d.length))))


def _second_bolus(b: Blood, size: float, d: Draw) -> Blood:
    """Tracer from the line's dead volume arrives later, after the manual samples were taken."""
    s = np.maximum(b.t - d.onset, 0.0) / 1.5
    return replace(b, total=b.total + size * float(b.total.max()) * s * np.exp(1.0 - s))


def _area(t: Array, u: Array) -> Array:
    area = np.zeros(t.size)
    area[1:] = np.cumsum(0.5 * (u[1:] + u[:-1]) * np.diff(t))
    return area


def _trapped(back: float) -> Build:
    """Kb of the vessels' walls, with a slow return or none."""

    def added(grid: Grid, subject: Subject, size: float) -> Array:
        held = _area(grid.t, grid.whole[::2])
        if back:
            held = smeared(grid.t, grid.whole[::2], 1.0 / back) / back
        return subject.vB[:, None] * size * held

    return lambda size, d: Change(added=lambda grid, subject: added(grid, subject, size))


def _leaked(late: float) -> Build:
    """Metabolites in the tissue: one compartment, or one behind another."""

    def added(grid: Grid, subject: Subject, size: float) -> Array:
        free = (grid.total - grid.plasma)[::2]
        held = smeared(grid.t, free, 10.0) * 10.0
        held = smeared(grid.t, held, late) if late else held
        return (1.0 - subject.vB[:, None]) * size * subject.rates[:, :1] * held

    return lambda size, d: Change(added=lambda grid, subject: added(grid, subject, size))


def _course(change: Callable[[Array, float, Draw], Array], *which: int, local: bool = False) -> Build:
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


def _step(t: Array, size: float, d: Draw) -> Array:
    return np.where(t >= d.onset, d.sign * size, 0.0)


def _ramp(t: Array, size: float, d: Draw) -> Array:
    return d.sign * size * np.clip((t - d.onset) / 5.0, 0.0, 1.0)


def _released(t: Array, size: float, d: Draw) -> Array:
    x = np.maximum(t - d.onset, 0.0) / d.length
    return size * x * np.exp(1.0 - x)


def _triangle(t: Array, size: float, d: Draw) -> Array:
    x = (t - d.onset) / d.length
    return size * np.clip(np.minimum(x, 2.0 - 0.6 * x), 0.0, None)


def _plateau(t: Array, size: float, d: Draw) -> Array:
    return size * np.clip((t - d.onset) / 4.0, 0.0, 1.0) * np.clip((d.onset + 2.5 * d.length - t) / 4.0, 0.0, 1.0)


def _wave(t: Array, size: float, d: Draw) -> Array:
    return size * np.sin(2.0 * np.pi * t / (2.0 * d.length) + d.weights[0])


def later(frames: Frames, onset: float, soft: float = 0.0) -> Array:
    """Share of every frame after the onset, or a smooth rise about it."""
    if soft:
        return 1.0 / (1.0 + np.exp(-(frames.mid - onset) / soft))
    return np.clip((frames.end - onset) / (frames.end - frames.start), 0.0, 1.0)


def _others(x: Array) -> Array:
    return (x.sum(axis=0) - x) / (len(x) - 1)


def _next(x: Array) -> Array:
    return np.roll(x, 1, axis=0)


def _passed(f: Frames) -> Array:
    return f.mid / f.end[-1]


def _hot(x: Array, f: Frames) -> Array:
    rate = x.mean(axis=0) * np.exp(-f.decay * f.mid)
    return rate / rate.max()


def _one_frame(x: Array, f: Frames, size: float, d: Draw) -> Array:
    return x * (1.0 + d.sign * size * (np.arange(f.start.size) == d.frame))


def _clipped(x: Array, f: Frames, size: float) -> Array:
    """var / value of a frame, in units of the noisiest."""
    variance = np.maximum(x, 0.05 * x.max(axis=1, keepdims=True)) / f.counted
    excess = variance / np.maximum(x, 0.05 * x.max(axis=1, keepdims=True))
    return x + size * x.mean(axis=0).max() * excess / excess.max()


def _wrong_half_life(excess: float) -> Callable[[Array, Frames, float, Draw], Array]:
    """Counts divided by what a wrong half-life makes of the frame; the excess is the size where it is 0."""

    def change(x: Array, f: Frames, size: float, d: Draw) -> Array:
        wrong = f.decay * (1.0 + (excess or d.sign * size))
        return x * f.counted * wrong / (np.exp(-wrong * f.start) - np.exp(-wrong * f.end))

    return change


def _corrected(excess: float) -> Build:
    return lambda size, d: Change(clock=Clock(excess=excess or d.sign * size))


_MEAN_LIFE = 1.0 / math.log(2.0) - 1.0

#: As the catalogue words it.
KNOWN: tuple[Cause, ...] = (
    Cause("arterial_delay", "input", _blood(_delayed), 60.0),
    Cause("dispersion", "input", _blood(_dispersed), 15.0),
    Cause("parent_fraction", "input", _blood(_metabolised(2.0)), 0.9),
    Cause("vascular_trapping", "vascular", _trapped(0.0), 1.5),
    Cause("tissue_metabolite", "tissue", _leaked(0.0), 1.0),
    Cause("tissue_heterogeneity", "tissue", lambda s, d: Change(spread=((0.5, 1 + s), (0.5, 1 - s))), 0.85),
    Cause("time_varying_kinetics", "tissue", _course(_released, 1, local=True), 3.0, onset=True, local=True),
    Cause("flow_change", "tissue", _course(_step, 0, 1), 0.7, onset=True),
    Cause("saturable_binding", "tissue", lambda s, d: Change(filling=(s, False)), 0.95),
    Cause(
        "partial_volume", "imaging", _scanner(lambda x, f, s, d: x + s * d.chosen * (_others(x) - x)), 0.4, local=True
    ),
    Cause(
        "motion_step",
        "imaging",
        _scanner(lambda x, f, s, d: x + s * d.chosen * later(f, d.onset) * (_others(x) - x)),
        0.4,
        onset=True,
        local=True,
    ),
    Cause(
        "motion_drift",
        "imaging",
        _scanner(lambda x, f, s, d: x + s * d.chosen * _passed(f) * (_others(x) - x)),
        0.4,
        local=True,
    ),
    Cause(
        "attenuation_mismatch",
        "imaging",
        _scanner(lambda x, f, s, d: x * (1 + d.sign * s * d.chosen * later(f, d.onset))),
        0.4,
        onset=True,
        local=True,
    ),
    Cause("scatter_background", "imaging", _scanner(lambda x, f, s, d: x + s * x.mean(axis=0)), 0.25),
    Cause(
        "randoms_offset",
        "imaging",
        _scanner(lambda x, f, s, d: x + d.sign * s * x.mean(axis=0).max() * np.exp(f.decay * (f.mid - f.end[-1]))),
        0.08,
    ),
    Cause("dead_time", "imaging", _scanner(lambda x, f, s, d: x * (1 - s * _hot(x, f))), 0.4),
    Cause("gain_drift", "imaging", _scanner(lambda x, f, s, d: x * (1 + d.sign * s * _passed(f))), 0.1),
    Cause(
        "gain_step", "imaging", _scanner(lambda x, f, s, d: x * (1 + d.sign * s * later(f, d.onset))), 0.2, onset=True
    ),
    Cause("frame_offset", "clock", lambda s, d: Change(clock=Clock(late=s / 60.0)), 30.0),
    Cause("frame_duration", "clock", _scanner(_one_frame), 0.8, framed=True),
    Cause("half_life_error", "clock", _corrected(0.0), 0.1),
    Cause("mean_life_swap", "clock", _corrected(_MEAN_LIFE), 1.0, flag=True),
    Cause("decay_applied_twice", "clock", _corrected(1.0), 1.0, flag=True),
    Cause("decay_not_applied", "clock", _corrected(-1.0), 1.0, flag=True),
    Cause("nonnegativity_bias", "noise", _scanner(lambda x, f, s, d: _clipped(x, f, s)), 0.3),
)

#: The same effects in another mathematical form: seen in training, and kept for the score.
OTHER_FORMS: dict[str, tuple[Cause, ...]] = {
    "training": (
        Cause("parent_fraction", "input", _blood(_metabolised(1.3)), 0.9),
        Cause("time_varying_kinetics", "tissue", _course(_triangle, 1, local=True), 3.0, onset=True, local=True),
        Cause(
            "gain_step",
            "imaging",
            _scanner(lambda x, f, s, d: x * (1 + d.sign * s * later(f, d.onset, 1.0))),
            0.2,
            onset=True,
        ),
        Cause("gain_drift", "imaging", _scanner(lambda x, f, s, d: x * (1 + d.sign * s * _passed(f) ** 2)), 0.1),
        Cause(
            "motion_step",
            "imaging",
            _scanner(lambda x, f, s, d: x + s * later(f, d.onset) * (_others(x) - x)),
            0.4,
            onset=True,
        ),
        Cause("vascular_trapping", "vascular", _trapped(0.01), 1.5),
    ),
    "scored": (
        Cause("dispersion", "input", _blood(_dispersed_twice), 20.0),
        Cause("parent_fraction", "input", _blood(_metabolised_exponential), 0.9),
        Cause("tissue_metabolite", "tissue", _leaked(4.0), 1.0),
        Cause(
            "tissue_heterogeneity",
            "tissue",
            lambda s, d: Change(spread=((0.25, 1 - s), (0.5, 1.0), (0.25, 1 + s))),
            0.85,
        ),
        Cause("time_varying_kinetics", "tissue", _course(_plateau, 1, local=True), 3.0, onset=True, local=True),
        Cause("flow_change", "tissue", _course(_ramp, 0, 1), 0.7, onset=True),
        Cause("saturable_binding", "tissue", lambda s, d: Change(filling=(s, True)), 3.0),
        Cause(
            "motion_step",
            "imaging",
            _scanner(lambda x, f, s, d: x + s * d.chosen * later(f, d.onset) * (_next(x) - x)),
            0.4,
            onset=True,
            local=True,
        ),
        Cause(
            "attenuation_mismatch",
            "imaging",
            _scanner(lambda x, f, s, d: x * np.exp(d.sign * s * d.chosen * later(f, d.onset, 0.7))),
            0.4,
            onset=True,
            local=True,
        ),
        Cause("dead_time", "imaging", _scanner(lambda x, f, s, d: x * np.exp(-s * _hot(x, f) ** 2)), 0.4),
        Cause(
            "gain_drift",
            "imaging",
            _scanner(lambda x, f, s, d: x * (1 + d.sign * s * (1 - np.exp(-3 * _passed(f))))),
            0.1,
        ),
        Cause(
            "gain_step",
            "imaging",
            _scanner(lambda x, f, s, d: x * (1 + d.sign * s * later(f, d.onset, 0.7))),
            0.2,
            onset=True,
        ),
        Cause("half_life_error", "clock", _scanner(_wrong_half_life(0.0)), 0.1),
        Cause("mean_life_swap", "clock", _scanner(_wrong_half_life(_MEAN_LIFE)), 1.0, flag=True),
        Cause("decay_applied_twice", "clock", _scanner(_wrong_half_life(1.0)), 1.0, flag=True),
    ),
}


def _shapes(x: Array, f: Frames, size: float, d: Draw) -> Array:
    """Every region drifts by its own smooth curve."""
    p = 2.0 * _passed(f) - 1.0
    curves = np.stack([np.cos(np.pi * (k % 3 + 1) * p + w) for k, w in enumerate(d.weights)])
    return x * (1.0 + size * curves)


#: Causes that no entry of the catalogue is: seen in training, and kept for the score.
UNKNOWN: dict[str, tuple[Cause, ...]] = {
    "training": (
        Cause(
            "", "imaging", _scanner(lambda x, f, s, d: x * (1 + s * np.sin(2.2 * np.sqrt(f.mid) + d.weights[0]))), 0.6
        ),
        Cause(
            "",
            "imaging",
            _scanner(lambda x, f, s, d: x * (1 + s * d.chosen * np.exp(-0.5 * ((f.mid - d.onset) / d.length) ** 2))),
            0.6,
        ),
        Cause("", "imaging", _scanner(lambda x, f, s, d: x * np.maximum(x / x.max(), 0.01) ** (d.sign * s)), 0.5),
        Cause("", "tissue", _course(_wave, 0), 0.9),
    ),
    "scored": (
        Cause("", "input", _blood(_second_bolus), 0.5),
        Cause("", "tissue", lambda s, d: Change(trapped=s), 0.2),
        Cause("", "tissue", _course(_wave, 2, local=False), 0.95),
        Cause("", "imaging", _scanner(_shapes), 0.4),
        Cause(
            "",
            "imaging",
            _scanner(
                lambda x, f, s, d: (
                    x * (1 + s * np.sign(d.weights)[:, None] * np.sin(2 * np.pi * f.mid / (2.5 * d.length)))
                )
            ),
            0.5,
        ),
        Cause(
            "",
            "imaging",
            _scanner(lambda x, f, s, d: x * (1 + s * np.exp(-0.5 * ((f.mid - d.onset) / d.length) ** 2))),
            0.5,
        ),
    ),
}
