"""How catalogued effects look in the picture where a cause is withheld, and what that says of the cause."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld import causes as regional
from petkin_bench.withheld.classes import same_of_its_size
from petkin_bench.withheld.images.causes import KNOWN, Cause, Place
from petkin_bench.withheld.images.head import NAMES
from petkin_bench.withheld.images.making import Made, place_in, possible
from petkin_bench.withheld.images.taking import retaken, taken
from petkin_bench.withheld.making import Made as MadeCurves
from petkin_bench.withheld.noise import law
from petkin_bench.withheld.observe import Change, observe
from petkin_bench.withheld.visibility import cosines, perpendicular, seen

Array = NDArray[np.float64]

#: Share of a cause's largest size at which columns are taken: what is weak is linear.
WEAK = 0.15
_SAME, _FILTERED = 0.95, 400


def columns_of(
    made: Made, causes: tuple[Cause, ...] = KNOWN, onsets: Sequence[float] = ()
) -> Iterator[tuple[str, Array]]:
    """What the refit leaves of catalogued effects at a weak size (`WEAK`), along all axes and in all regions.

    Args:
        made: the cause that is there.
        causes: those that are wanted.
        onsets: of causes that have one, min; none for the onset that was drawn.
    """
    scanned = replace(made.scene.scanned, subject=made.fitted)
    plain = taken(scanned, varied=False)
    for cause in causes:
        if not possible(cause, made.scene):
            continue
        for place in _places(made, cause, onsets if cause.onset else ()):
            change = retaken(scanned, cause.build(WEAK * cause.most, place), plain) - plain
            left = made.filter.left(change)
            if np.linalg.norm(left) > 1e-6:
                yield cause.name, left


def drawn_columns(made: Made, causes: tuple[Cause, ...], count: int, rng: np.random.Generator) -> Iterator[Array]:
    """What the refit leaves of causes at a weak size, so many draws of each."""
    scanned = replace(made.scene.scanned, subject=made.fitted)
    plain = taken(scanned, varied=False)
    for cause in causes:
        for _ in range(count):
            shot = cause.build(WEAK * cause.most, place_in(made.scene, rng))
            yield made.filter.left(retaken(scanned, shot, plain) - plain)


def unit_columns(made: Made, causes: tuple[Cause, ...] = KNOWN) -> list[tuple[str, Array]]:
    """Those columns, each of length 1."""
    return [(name, left / float(np.linalg.norm(left))) for name, left in columns_of(made, causes)]


def _places(made: Made, cause: Cause, onsets: Sequence[float] = ()) -> list[Place]:
    if onsets:
        return [
            replace(place, drawn=replace(place.drawn, onset=onset))
            for place in _places(made, cause)
            for onset in onsets
        ]
    if cause.spatial and cause.name != "partial_volume" and not cause.local:
        return [replace(made.place, axis=axis) for axis in range(3)]
    if cause.local:
        drawn = made.place.drawn
        return [replace(made.place, drawn=replace(drawn, region=r)) for r in range(len(NAMES))]
    return [made.place]


def class_of(made: Made, columns: list[tuple[str, Array]]) -> tuple[str, ...]:
    """The cause's name and those of what nobody could tell from it."""
    alike = cosines(np.stack([made.left, *(c for _, c in columns)], axis=1))[0, 1:]
    same = {name for (name, _), c in zip(columns, alike) if c >= _SAME}
    return tuple(sorted({made.cause.name} | same | (_same_in_curves(made) if made.of_simulator else set())))


def _same_in_curves(made: Made) -> set[str]:
    """Names of what looks the same as a part that the simulator lacks in sharp curves, as large as it is."""
    scene, cause = made.scene, made.cause
    subject = scene.scanned.subject
    values = observe(subject)
    noise = law(values, subject.frames, scene.percent / 10.0, 0.0)
    refitted = seen(values, scene.simulator, subject, noise)
    part = regional.Cause(cause.name, cause.stage, lambda size, drawn: Change(), cause.most)
    curves = MadeCurves(
        part, made.place.drawn, made.size, Change(), subject, scene.simulator, values, refitted, scene.percent
    )
    return same_of_its_size(curves, noise)


def beyond(made: Made, others: list[Array]) -> float:
    """Share of d' that no one and no two of the others explain, times d'."""
    return made.detectability * perpendicular(made.left, others) / max(float(np.linalg.norm(made.left)), 1e-300)


def ceiling(made: Made, columns: list[tuple[str, Array]], same: tuple[str, ...], rng: np.random.Generator) -> float:
    """Share of noise draws in which the best matched filter, one a name and place, is one of the class."""
    own = made.left / np.linalg.norm(made.left)
    unit = np.stack([own, *(c for _, c in columns)], axis=1)
    names = [made.cause.name, *(name for name, _ in columns)]
    gram = unit.T @ unit
    values, vectors = np.linalg.eigh(gram)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    scores = np.abs(made.detectability * gram[0] + rng.standard_normal((_FILTERED, len(names))) @ root.T)
    return float(np.mean([names[k] in same for k in scores.argmax(axis=1)]))
