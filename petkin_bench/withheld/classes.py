"""What else a cause could be taken for, and how often a matched filter finds it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.beyond import equals
from petkin_bench.withheld.causes import KNOWN, Cause
from petkin_bench.withheld.changes import Draw
from petkin_bench.withheld.making import Made, Scene
from petkin_bench.withheld.noise import NoiseLaw
from petkin_bench.withheld.observe import Change, observe
from petkin_bench.withheld.subject import Subject
from petkin_bench.withheld.visibility import cosines

Array = NDArray[np.float64]

#: Causes alike above this cosine are one class; draws of noise that a filter sees.
_SAME, _FILTERED = 0.95, 400
#: The same as a share of d' that is left.
_APART = float(np.sqrt(1.0 - _SAME**2))


def columns_of(scene: Scene, made: Made, *, finely: bool = False) -> list[tuple[str, Array]]:
    """What the refit leaves of every catalogued effect at a weak size, with its name, at several shapes each.

    Args:
        scene: of the subject.
        made: the case; its own onset, region and length are the first shape.
        finely: onsets and regions on a grid.
    """
    subject, noise = made.seen.fitted, scene.law(made.values)
    here = observe(subject)
    found = []
    for cause in KNOWN:
        for drawn in _shapes(scene, made, cause, finely):
            size = 1.0 if cause.flag else 0.1 * cause.most
            change = noise.whiten(_changed(subject, here, cause.build(size, drawn)) - here) / size
            left = made.seen.project(change[:, None])[:, 0]
            if np.linalg.norm(left) > 1e-4 * np.linalg.norm(change):
                found.append((cause.name, left))
    return found


def _changed(subject: Subject, here: Array, change: Change) -> Array:
    """Values with a change, which starts from those without one where it is the scanner's alone."""
    if change.scanner is not None and replace(change, scanner=None) == Change():
        return change.scanner(here, subject.frames)
    return observe(subject, (change,))


def _shapes(scene: Scene, made: Made, cause: Cause, finely: bool) -> list[Draw]:
    found = [made.drawn]
    regions = range(len(scene.subject.rates))
    end = float(scene.subject.frames.end[-1])
    if finely and cause.onset:
        found += [replace(made.drawn, onset=o) for o in np.linspace(0.1, 0.85, 6) * end]
    if finely and cause.local:
        found = [replace(d, region=r) for d in found for r in regions]
    if cause.name in ("parent_fraction", "time_varying_kinetics"):
        found += [replace(found[0], length=x) for x in (5.0, 20.0)]
    if finely and cause.framed:
        found += [replace(made.drawn, frame=k) for k in range(4, scene.subject.frames.start.size)]
    return found


def class_of(made: Made, law: NoiseLaw, columns: list[tuple[str, Array]]) -> tuple[str, ...]:
    """The name and all that looks the same: as a column, or, of what has a size and nothing else, as large as it is."""
    alike = cosines(np.stack([made.seen.left, *(c for _, c in columns)], axis=1))[0, 1:]
    same = {name for (name, _), c in zip(columns, alike) if c >= _SAME}
    return tuple(sorted({made.cause.name} | same | same_of_its_size(made, law)))


def same_of_its_size(made: Made, law: NoiseLaw) -> set[str]:
    """Names of what has a size and nothing else, and looks the same as large as it is."""
    return set(equals(made, law, _APART))


def ceiling_of(made: Made, columns: list[tuple[str, Array]], same: tuple[str, ...], rng: np.random.Generator) -> float:
    """Share of noise draws in which the best matched filter, one a name, is one of the class."""
    if made.cause.flag:
        return 1.0
    return named_by_filters(made.seen.left, made.cause.name, columns, same, rng)


def named_by_filters(
    left: Array, name: str, columns: list[tuple[str, Array]], same: tuple[str, ...], rng: np.random.Generator
) -> float:
    """The same for what a refit leaves of a cause (n,), whatever it is a cause in."""
    first: dict[str, Array] = {}
    for other, column in columns:
        first.setdefault(other, column)
    first[name] = left
    unit = np.stack([c / np.linalg.norm(c) for c in first.values()], axis=1)
    scores = np.abs((left + rng.standard_normal((_FILTERED, len(unit)))) @ unit)
    names = list(first)
    return float(np.mean([names[k] in same for k in scores.argmax(axis=1)]))
