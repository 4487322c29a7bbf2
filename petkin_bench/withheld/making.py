"""Causes at a strength: what a simulator that lacks them leaves of their curves is as large as was asked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.causes import Cause, draw
from petkin_bench.withheld.changes import Draw
from petkin_bench.withheld.noise import NoiseLaw, law
from petkin_bench.withheld.observe import Change, observe
from petkin_bench.withheld.subject import Subject
from petkin_bench.withheld.visibility import Seen, Simulator, seen

Array = NDArray[np.float64]

#: Bins of d' from which a strength is drawn; it is right within this.
BINS, _CLOSE = ((4.0, 5.0), (6.0, 8.0), (8.0, 12.0), (12.0, 20.0)), 0.08


@dataclass(frozen=True)
class Scene:
    rng: np.random.Generator
    subject: Subject
    simulator: Simulator
    percent: float
    share: float

    def law(self, values: Array) -> NoiseLaw:
        return law(values, self.subject.frames, self.percent, self.share, self.subject.noisiness)

    def seen(self, values: Array) -> Seen:
        return seen(values, self.simulator, self.subject, self.law(values))


@dataclass(frozen=True)
class Made:
    """A cause at its size: the curves with it, and what a refit leaves of them."""

    cause: Cause
    drawn: Draw
    size: float
    change: Change
    subject: Subject
    simulator: Simulator
    values: Array
    seen: Seen
    percent: float


def drawn_target(scene: Scene) -> float:
    return float(scene.rng.uniform(*BINS[int(scene.rng.integers(len(BINS)))]))


def made_of(scene: Scene, cause: Cause, drawn: Draw, size: float) -> Made:
    """A cause at a size."""
    change = cause.build(size, drawn)
    values = observe(scene.subject, (change,))
    return Made(cause, drawn, size, change, scene.subject, scene.simulator, values, scene.seen(values), scene.percent)


def scaled(scene: Scene, cause: Cause, drawn: Draw, target: float) -> Made | None:
    if cause.flag:
        made = made_of(scene, cause, drawn, 1.0)
        return made if made.seen.detectability >= BINS[0][0] else None
    return _at_strength(lambda size: made_of(scene, cause, drawn, size), cause.most, target)


def _at_strength(make: Callable[[float], Made], most: float, target: float) -> Made | None:
    size = 0.3 * most
    for _ in range(6):
        made = make(size)
        reached = made.seen.detectability
        if abs(reached / target - 1.0) < _CLOSE:
            return made
        wanted = size * target / max(reached, 1e-6)
        if wanted > 2.0 * most or (size >= most and reached < target):
            return None
        size = min(wanted, most)
    return None


def withheld_part(scene: Scene) -> Made:
    """A part of the simulator that the subject has and the simulator lacks, made as weak as its strength asks."""
    which = int(scene.rng.integers(3))
    simulator = Simulator(which != 0, which != 1, which != 2)
    name = ("second_tissue", "blood_volume", "arterial_delay")[which]
    cause = Cause(name, ("tissue", "vascular", "input")[which], lambda size, d: Change(), 1.0)
    drawn, late = draw(scene.rng, scene.subject), float(scene.rng.choice([-1.0, 1.0]))

    def make(size: float) -> Made:
        subject = scene.subject
        if which == 0:
            subject = replace(subject, rates=subject.rates * np.array([1.0, 1.0, size, 1.0]))
        elif which == 1:
            subject = replace(subject, vB=subject.vB * size)
        else:
            subject = replace(subject, delay=late * size / 3.0)
        there = replace(scene, subject=subject, simulator=simulator)
        values = observe(subject)
        return Made(cause, drawn, size, Change(), subject, simulator, values, there.seen(values), scene.percent)

    target = drawn_target(scene)
    return _at_strength(make, 1.5, target) or make(1.0)
