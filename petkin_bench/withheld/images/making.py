"""A cause put into a picture, at a size or at a strength, and what a refit of the simulator leaves of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.causes import draw
from petkin_bench.withheld.images.causes import Cause, Place
from petkin_bench.withheld.images.head import NAMES
from petkin_bench.withheld.images.strength import Filter, matched
from petkin_bench.withheld.images.taking import AS_ALWAYS, Grain, Scanned, Shot, grain, means, pieces, taken
from petkin_bench.withheld.noise import law
from petkin_bench.withheld.observe import Change, observe
from petkin_bench.withheld.subject import Subject
from petkin_bench.withheld.visibility import Simulator, seen

Array = NDArray[np.float64]

_CLOSE = 0.1
#: kBq/mL of a frame before the tracer is there.
_NOTHING = 1e-9


@dataclass(frozen=True)
class Scene:
    """What a cause is put into.

    Args:
        rng: of the case.
        scanned: who is scanned, and how.
        simulator: what the product's simulator has.
        percent, share, freedom: of noise, as of `taking.grain`.
    """

    rng: np.random.Generator
    scanned: Scanned
    simulator: Simulator
    percent: float
    share: float
    freedom: int

    def grain(self, image: Array) -> Grain:
        scanned = self.scanned
        return grain(image, scanned.head, scanned.subject.frames, self.percent, self.share, self.freedom)


@dataclass(frozen=True)
class Made:
    """A cause at its size: the picture with it, and what a refit leaves of it."""

    cause: Cause
    place: Place
    size: float
    scene: Scene
    image: Array
    filter: Filter
    fitted: Subject
    left: Array
    detectability: float

    @property
    def of_simulator(self) -> bool:
        """Whether the cause is a part that the simulator lacks."""
        return self.scene.simulator != Simulator()


def at_strength(make: Callable[[float], Made], most: float, target: float) -> Made | None:
    """A cause of the wanted d', none where it would have to be larger than `most`."""
    size = 0.3 * most
    for _ in range(6):
        made = make(size)
        if abs(made.detectability / target - 1.0) < _CLOSE:
            return made
        wanted = size * target / max(made.detectability, 1e-6)
        if wanted > 2.0 * most or (size >= most and made.detectability < target):
            return None
        size = min(wanted, most)
    return None


def made_of(scene: Scene, cause: Cause, place: Place, size: float, shot: Shot | None = None) -> Made:
    """The picture with a cause, and what is left of it once the simulator's kinetics and delay are refitted.

    How kinetics vary within regions nobody knows: it is noise of the picture, and no part of what the cause changes.
    """
    scanned = scene.scanned
    shot = cause.build(size, place) if shot is None else shot
    image = taken(scanned, shot)
    fitted = _fitted(scene, shot)
    here = replace(scanned, subject=fitted)
    plain = taken(here, varied=False)
    filtered = matched(here, *pieces(fitted, Change()), scene.grain(image), _refitted(here, scene.simulator, plain))
    change = taken(scanned, shot, varied=False) - plain
    reached = filtered.detectability(change)
    return Made(cause, place, size, scene, image, filtered, fitted, filtered.left(change), reached)


def _fitted(scene: Scene, shot: Shot) -> Subject:
    """The simulator's subject: what it refits to sharp curves that a cause changes; else who is there.

    What a camera adds changes sharp curves as it does the means of regions. What a picture changes besides is small and
    left to the projection.
    """
    scanned, subject = scene.scanned, scene.scanned.subject
    unchanged = shot.change is AS_ALWAYS.change and shot.camera is None
    if unchanged and scene.simulator == Simulator():
        return subject
    wanted = observe(subject, (shot.change,))
    if shot.camera is not None:
        plain = taken(scanned, varied=False)
        shown, held = (means(picture, scanned.head) for picture in (shot.camera(plain, subject.frames), plain))
        wanted[: len(held)] *= shown / np.maximum(held, _NOTHING)
    return seen(wanted, scene.simulator, subject, law(wanted, subject.frames, scene.percent / 10.0, 0.0)).fitted


def _refitted(scanned: Scanned, simulator: Simulator, plain: Array) -> list[Array]:
    """What else is refitted: delay and the width of a point spread, where the simulator has them."""
    late = replace(scanned, subject=replace(scanned.subject, delay=scanned.subject.delay + 0.01))
    found = [taken(late, varied=False) - plain] if simulator.delay else []
    if scanned.width > 0:
        found.append(taken(replace(scanned, width=scanned.width + 0.3), varied=False) - plain)
        found.append(taken(replace(scanned, width=0.0), varied=False) - plain)
    return found


def place_in(scene: Scene, rng: np.random.Generator) -> Place:
    """What a cause draws besides its size."""
    drawn = draw(rng, scene.scanned.subject)
    drawn = replace(drawn, region=int(rng.integers(len(NAMES))))
    return Place(drawn, int(rng.integers(3)), scene.scanned.head)


def possible(cause: Cause, scene: Scene) -> bool:
    """Blur is withheld only where the simulator has none; a head moves only where there is some, else voxels jump."""
    blurred = scene.scanned.width > 0
    return not blurred if cause.name == "partial_volume" else blurred or not cause.name.startswith("motion")
