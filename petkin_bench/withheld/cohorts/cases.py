"""Cohort cases: scans as the product sees them, and apart from them the answer; both follow from split, seed and index.

One scanner, tracer and law of noise; every scan has a subject and a place of its own. Sizes of a shared cause
are log-normal about one size; its moment is that of each scan or, in half of the cohorts, one for all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.cases import PERCENT, SPLITS, TRIES, Scan, scan_of, single
from petkin_bench.withheld.causes import KNOWN, OTHER_FORMS, UNKNOWN, Cause, draw
from petkin_bench.withheld.classes import class_of, columns_of
from petkin_bench.withheld.making import Made, Scene, made_of
from petkin_bench.withheld.noise import KINDS, noisy
from petkin_bench.withheld.observe import observe
from petkin_bench.withheld.subject import draw_subject
from petkin_bench.withheld.visibility import Simulator

#: Scans of a cohort at least, so that some are not all, and at most, as there are no more classes of causes.
SCANS = (3, 10)
#: Kinds of cohort and their shares: no gap; a cause in all scans; in some; one in some and another in the rest; one of
#: no name in all; in every scan another. Up to seed 35 there were no two and none of no name, in seed 36
#: the rest of two may be one scan.
_KINDS = {"none": 0.2, "all": 0.25, "some": 0.2, "two": 0.15, "unnamed": 0.1, "apart": 0.1}
#: Bins of d' of the first scan's cause, and of causes that differ; how often a shared cause has another form.
BINS, _APART, _OTHER_FORM = ((2.0, 4.0), (4.0, 6.0), (6.0, 10.0)), (5.0, 10.0), 0.25
#: Causes that are there more or less.
_PLAIN: tuple[Cause, ...] = tuple(c for c in KNOWN if not c.flag)
#: Standard deviation of the logarithm of sizes; how often a scan has what only some have, and how many do at least.
SPREAD, SHARE, _LEAST = 0.25, 0.5, 2
#: How often scans have the moment (or frame) of a cause in common; up to seed 36 never.
_AT_ONCE = 0.5
#: What sets cohorts apart from single scans of the same seed.
_STREAM = 11


@dataclass(frozen=True)
class CohortAnswer:
    """What was withheld.

    Args:
        kind: none, all, some, two, unnamed, apart.
        noise, percent: of all scans; where causes differ, a scan may have less noise.
        name: in the catalogue's words; "" where nothing is shared.
        form: "known" or "other form"; "" where nothing is shared.
        same: the name and what looks the same in every scan that holds it.
        other: the same of what the rest hold, where that is another cause.
        detectability: d' of every scan, 0 where it holds nothing.
        sizes: of the shared cause in every scan; 0 where it holds nothing.
        size: what sizes are about, with its sign; 0 where nothing is shared.
    """

    kind: str
    noise: str
    percent: float
    name: str
    form: str
    same: tuple[str, ...]
    detectability: tuple[float, ...]
    sizes: tuple[float, ...]
    size: float
    other: tuple[str, ...] = ()
    onset: float = -1.0


def cohort_case(split: str, seed: int, index: int, scans: int, regions: int = 5) -> tuple[list[Scan], CohortAnswer]:
    """One cohort; the same arguments give the same bytes."""
    rng = np.random.default_rng([SPLITS[split], seed, index, _STREAM])
    kind = str(rng.choice(list(_KINDS), p=list(_KINDS.values())))
    noise = str(rng.choice(list(KINDS)))
    percent = float(rng.choice(PERCENT))
    scenes = _scenes(rng, percent, noise, scans, regions)
    if kind in ("all", "some"):
        return _shared(scenes, split, kind, noise)
    if kind == "two":
        return _two(scenes, noise)
    if kind == "unnamed":
        return _unnamed(scenes, split, noise)
    made = _apart(scenes) if kind == "apart" else [None for _ in scenes]
    answer = CohortAnswer(kind, noise, percent, "", "", (), _strengths(made), (0.0,) * scans, 0.0)
    return _scans(scenes, made, noise), answer


def _scenes(rng: np.random.Generator, percent: float, noise: str, scans: int, regions: int) -> list[Scene]:
    """Subjects in the frames of the first."""
    subjects = [draw_subject(rng, regions) for _ in range(scans)]
    alike = [replace(subject, frames=subjects[0].frames) for subject in subjects]
    return [Scene(rng, subject, Simulator(), percent, KINDS[noise][0]) for subject in alike]


def _shared(scenes: list[Scene], split: str, kind: str, noise: str) -> tuple[list[Scan], CohortAnswer]:
    """A cause of which the first scan would have its strength, at the size that all are about."""
    rng = scenes[0].rng
    form = "other form" if rng.random() < _OTHER_FORM else "known"
    causes = [c for c in (OTHER_FORMS[split] if form == "other form" else KNOWN) if not c.flag]
    holds = np.ones(len(scenes), bool) if kind == "all" else _some(rng, len(scenes))
    first = single(scenes[0], causes, target=float(rng.uniform(*BINS[int(rng.integers(len(BINS)))])))
    scenes = [replace(scene, percent=first.percent) for scene in scenes]
    at_once = bool(rng.random() < _AT_ONCE)
    made = _held(scenes, first, holds, at_once)
    answer = CohortAnswer(
        kind=kind,
        noise=noise,
        percent=first.percent,
        name=first.cause.name,
        form=form,
        same=_same(scenes, made),
        detectability=_strengths(made),
        sizes=tuple(0.0 if m is None else m.size for m in made),
        size=first.drawn.sign * first.size,
        onset=first.drawn.onset if at_once and first.cause.onset else -1.0,
    )
    return _scans(scenes, made, noise), answer


def _two(scenes: list[Scene], noise: str) -> tuple[list[Scan], CohortAnswer]:
    """One cause in some scans and in the rest another that could not be taken for it, at strengths that one shows."""
    rng = scenes[0].rng
    holds = _some(rng, len(scenes), rest=min(_LEAST, len(scenes) - _LEAST))
    at_once = bool(rng.random() < _AT_ONCE)
    for _ in range(TRIES):
        first, second = (single(scenes[0], _PLAIN, target=float(rng.uniform(*_APART))) for _ in range(2))
        percent = min(first.percent, second.percent)
        quiet = [replace(scene, percent=percent) for scene in scenes]
        one, two = _held(quiet, first, holds, at_once), _held(quiet, second, ~holds, at_once)
        same, other = _same(quiet, one), _same(quiet, two)
        if same and other and not set(same) & set(other) and first.cause is not second.cause:
            break
    else:
        raise RuntimeError(f"No two causes of classes of their own in {TRIES} draws.")
    made = [m if m is not None else n for m, n in zip(one, two, strict=True)]
    strengths, sizes = _strengths(made), tuple(0.0 if m is None else m.size for m in one)
    onset = first.drawn.onset if at_once and first.cause.onset else -1.0
    answer = CohortAnswer("two", noise, percent, first.cause.name, "known", same, strengths, sizes, 0.0, other, onset)
    return _scans(quiet, made, noise), answer


def _unnamed(scenes: list[Scene], split: str, noise: str) -> tuple[list[Scan], CohortAnswer]:
    """A cause of no name in all, of a strength beyond names that one shows."""
    target = float(scenes[0].rng.uniform(*_APART))
    at_once = bool(scenes[0].rng.random() < _AT_ONCE)
    first = single(scenes[0], UNKNOWN[split], target=target, of_unknown=True)
    scenes = [replace(scene, percent=first.percent) for scene in scenes]
    made = _held(scenes, first, np.ones(len(scenes), bool), at_once)
    sizes = (0.0,) * len(scenes)
    answer = CohortAnswer("unnamed", noise, first.percent, "", "", (), _strengths(made), sizes, 0.0)
    return _scans(scenes, made, noise), answer


def _some(rng: np.random.Generator, scans: int, *, rest: int = 1) -> NDArray[np.bool_]:
    """Which scans hold what only some do: two at least, and all but so many at most."""
    holds = np.ones(scans, bool)
    while not _LEAST <= holds.sum() <= scans - rest:
        holds = rng.random(scans) < SHARE
    return holds


def _held(scenes: list[Scene], first: Made, holds: NDArray[np.bool_], at_once: bool) -> list[Made | None]:
    """A cause in the scans that hold it, each at a place and a size of its own, and at a moment, or all at once."""
    made: list[Made | None] = []
    alike = {"sign": first.drawn.sign, "length": first.drawn.length}
    alike |= {"onset": first.drawn.onset, "frame": first.drawn.frame} if at_once else {}
    for scene, held in zip(scenes, holds, strict=True):
        drawn = replace(draw(scene.rng, scene.subject), **alike)
        size = first.size * float(np.exp(SPREAD * scene.rng.standard_normal()))
        made.append(made_of(scene, first.cause, drawn, size) if held else None)
    return made


def _same(scenes: list[Scene], made: Sequence[Made | None]) -> tuple[str, ...]:
    """What looks the same in every scan that holds something."""
    there = [(scene, m) for scene, m in zip(scenes, made, strict=True) if m is not None]
    same = [set(class_of(m, scene.law(m.values), columns_of(scene, m))) for scene, m in there]
    return tuple(sorted(set.intersection(*same)))


def _strengths(made: Sequence[Made | None]) -> tuple[float, ...]:
    return tuple(0.0 if m is None else m.seen.detectability for m in made)


def _apart(scenes: list[Scene]) -> list[Made]:
    """In every scan a cause that no other scan's could be taken for, at a strength that one scan shows."""
    found: list[Made] = []
    taken: set[str] = set()
    for scene in scenes:
        made, same = _unlike(scene, taken)
        taken |= same
        found.append(made)
    return found


def _unlike(scene: Scene, taken: set[str]) -> tuple[Made, set[str]]:
    """A cause whose class has none of these, and that class."""
    left = [c for c in _PLAIN if c.name not in taken]
    for _ in range(TRIES):
        made = single(scene, left, target=float(scene.rng.uniform(*_APART)))
        there = replace(scene, percent=made.percent)
        same = set(class_of(made, there.law(made.values), columns_of(there, made)))
        if not same & taken:
            return made, same
    raise RuntimeError(f"No cause of a class of its own in {TRIES} draws.")


def _scans(scenes: list[Scene], made: Sequence[Made | None], noise: str) -> list[Scan]:
    """What the product is given of each."""
    found = []
    for scene, m in zip(scenes, made, strict=True):
        clean = observe(scene.subject) if m is None else m.values
        law = (scene if m is None else replace(scene, percent=m.percent)).law(clean)
        found.append(scan_of(scene.subject, scene.simulator, noisy(clean, law, KINDS[noise][1], scene.rng)))
    return found
