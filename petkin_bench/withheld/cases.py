"""Cases: a scan as the product sees it, and apart from it the answer; both follow from split, seed and index alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.causes import KNOWN, OTHER_FORMS, UNKNOWN, Cause, draw
from petkin_bench.withheld.changes import Draw
from petkin_bench.withheld.noise import KINDS, NoiseLaw, law, noisy
from petkin_bench.withheld.observe import Change, observe
from petkin_bench.withheld.subject import Blood, Frames, Subject, draw_subject
from petkin_bench.withheld.visibility import Seen, Simulator, cosines, perpendicular, seen

Array = NDArray[np.float64]

#: Seeds of different splits never meet; forms and unknown causes differ too.
SPLITS = {"training": 1, "scored": 2}
#: Kinds of case and their shares.
_KINDS = {"none": 0.25, "known": 0.35, "other form": 0.12, "unknown": 0.13, "pair": 0.15}
#: Bins of d' from which a strength is drawn.
BINS = ((4.0, 5.0), (6.0, 8.0), (8.0, 12.0), (12.0, 20.0))
_PERCENT = (1.0, 2.0, 4.0)
#: Each of a pair, alone; what the other leaves of it.
_PAIR, _PAIR_LEAST = (7.0, 14.0), 6.0
#: How often a part of the simulator is withheld in place of a cause, and by which factor it is made weaker at most.
_PARTS = 0.2
#: A strength is right within this; causes alike above this cosine are one class. After so many draws that reach no
#: strength within what is plausible, noise is as small as it gets.
_CLOSE, _SAME = 0.08, 0.95
_TRIES, _QUIET, _FILTERED = 90, 30, 400


@dataclass(frozen=True)
class Scan:
    """What the product is given.

    Args:
        regions: names.
        frames: with the decay constant.
        values: corrected for decay (R, K).
        blood: the record.
        model: tissue model of the simulator.
        includes: effects that it has.
    """

    regions: tuple[str, ...]
    frames: Frames
    values: Array
    blood: Blood
    model: str
    includes: tuple[str, ...]


@dataclass(frozen=True)
class Answer:
    """What was withheld.

    Args:
        kind: none, known, other form, unknown, pair.
        noise, percent: of the scan.
        names: in the catalogue's words; empty for none and unknown.
        classes: of every name, itself and what looks the same after the refit.
        stages: of every name.
        detectability: d' of all together.
        perpendicular: of what neither one nor two catalogued effects outside its classes explain; of a pair, the lesser
            beside the other.
        ceiling: probability that a matched filter names the class.
        frame: of the onset, or the one that is concerned; -1 for none.
        region: the one in which it acts; -1 for all.
        clean: values without noise (R, K).
    """

    kind: str
    noise: str
    percent: float
    names: tuple[str, ...]
    classes: tuple[tuple[str, ...], ...]
    stages: tuple[str, ...]
    detectability: float
    perpendicular: float
    ceiling: float
    frame: int
    region: int
    clean: Array


@dataclass(frozen=True)
class _Scene:
    rng: np.random.Generator
    subject: Subject
    simulator: Simulator
    percent: float
    share: float

    def law(self, values: Array) -> NoiseLaw:
        return law(values, self.subject.frames, self.percent, self.share)

    def seen(self, values: Array) -> Seen:
        return seen(values, self.simulator, self.subject, self.law(values))


@dataclass(frozen=True)
class _Made:
    """A cause at its size: the curves with it, and what a refit leaves of them."""

    cause: Cause
    drawn: Draw
    change: Change
    subject: Subject
    simulator: Simulator
    values: Array
    seen: Seen
    percent: float


def case(split: str, seed: int, index: int, regions: int = 5) -> tuple[Scan, Answer]:
    """One case; the same arguments give the same bytes."""
    rng = np.random.default_rng([SPLITS[split], seed, index])
    kind = str(rng.choice(list(_KINDS), p=list(_KINDS.values())))
    noise = str(rng.choice(list(KINDS)))
    share, freedom = KINDS[noise]
    scene = _Scene(rng, draw_subject(rng, regions), Simulator(), float(rng.choice(_PERCENT)), share)
    subject, simulator, answer = _answer(scene, kind, split, noise)
    noise_law = replace(scene, percent=answer.percent).law(answer.clean)
    values = noisy(answer.clean, noise_law, freedom, rng)
    names = tuple(f"region{r + 1}" for r in range(regions))
    parts = (("blood_volume", simulator.blood_volume), ("arterial_delay", simulator.delay))
    includes = tuple(name for name, there in parts if there)
    model = "2tcm" if simulator.second_tissue else "1tcm"
    return Scan(names, subject.frames, values, subject.blood, model, includes), answer


def _answer(scene: _Scene, kind: str, split: str, noise: str) -> tuple[Subject, Simulator, Answer]:
    if kind == "none":
        clean = observe(scene.subject)
        nothing = Answer(kind, noise, scene.percent, (), (), (), 0.0, 0.0, 0.0, -1, -1, clean)
        return scene.subject, scene.simulator, nothing
    if kind == "pair":
        return _pair(scene, noise)
    if kind == "known" and scene.rng.random() < _PARTS:
        made = _withheld_part(scene)
    else:
        causes = {"known": KNOWN, "other form": OTHER_FORMS[split], "unknown": UNKNOWN[split]}[kind]
        made = _single(scene, causes, of_unknown=kind == "unknown")
    scene = replace(scene, subject=made.subject, simulator=made.simulator, percent=made.percent)
    cause = made.cause
    columns = _columns(scene, made, finely=kind == "unknown")
    names = (cause.name,) if cause.name else ()
    same = _class(cause.name, made.seen.left, columns) if names else ()
    finely = _columns(scene, made, finely=True) if names else columns
    beyond = perpendicular(made.seen.left, [c for name, c in finely if name not in same])
    ceiling = _ceiling(made, columns, same, scene.rng) if names else 0.0
    frame = made.drawn.frame if cause.framed else _frame_of(made) if cause.onset else -1
    region = made.drawn.region if cause.local else -1
    answer = Answer(
        kind=kind,
        noise=noise,
        percent=scene.percent,
        names=names,
        classes=(same,) if names else (),
        stages=(cause.stage,),
        detectability=made.seen.detectability,
        perpendicular=beyond,
        ceiling=ceiling,
        frame=frame,
        region=region,
        clean=made.values,
    )
    return made.subject, made.simulator, answer


def _frame_of(made: _Made) -> int:
    return int(np.searchsorted(made.subject.frames.end, made.drawn.onset))


def _quieter(scene: _Scene, attempt: int) -> _Scene:
    return replace(scene, percent=_PERCENT[0]) if attempt >= _QUIET else scene


def _target(scene: _Scene) -> float:
    return float(scene.rng.uniform(*BINS[int(scene.rng.integers(len(BINS)))]))


def _single(scene: _Scene, causes: tuple[Cause, ...], *, of_unknown: bool = False) -> _Made:
    """A cause that reaches its strength within what is plausible; of an unknown one, beyond all known ones."""
    for attempt in range(_TRIES):
        scene = _quieter(scene, attempt)
        cause = causes[int(scene.rng.integers(len(causes)))]
        target = _target(scene)
        made = _scaled(scene, cause, draw(scene.rng, scene.subject), target)
        if made is None or not of_unknown:
            if made is not None:
                return made
            continue
        beyond = perpendicular(made.seen.left, [c for _, c in _columns(scene, made, finely=True)])
        stronger = _scaled(scene, cause, made.drawn, target * made.seen.detectability / max(beyond, 1e-9))
        if stronger is not None:
            return stronger
    raise RuntimeError(f"No cause reached its strength in {_TRIES} draws.")


def _made(scene: _Scene, cause: Cause, drawn: Draw, size: float) -> _Made:
    change = cause.build(size, drawn)
    values = observe(scene.subject, (change,))
    return _Made(cause, drawn, change, scene.subject, scene.simulator, values, scene.seen(values), scene.percent)


def _scaled(scene: _Scene, cause: Cause, drawn: Draw, target: float) -> _Made | None:
    if cause.flag:
        made = _made(scene, cause, drawn, 1.0)
        return made if made.seen.detectability >= BINS[0][0] else None
    return _at_strength(lambda size: _made(scene, cause, drawn, size), cause.most, target)


def _at_strength(make: Callable[[float], _Made], most: float, target: float) -> _Made | None:
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


def _withheld_part(scene: _Scene) -> _Made:
    """A part of the simulator that the subject has and the simulator lacks, made as weak as its strength asks."""
    which = int(scene.rng.integers(3))
    simulator = Simulator(which != 0, which != 1, which != 2)
    name = ("second_tissue", "blood_volume", "arterial_delay")[which]
    cause = Cause(name, ("tissue", "vascular", "input")[which], lambda size, d: Change(), 1.0)
    drawn, late = draw(scene.rng, scene.subject), float(scene.rng.choice([-1.0, 1.0]))

    def make(size: float) -> _Made:
        subject = scene.subject
        if which == 0:
            subject = replace(subject, rates=subject.rates * np.array([1.0, 1.0, size, 1.0]))
        elif which == 1:
            subject = replace(subject, vB=subject.vB * size)
        else:
            subject = replace(subject, delay=late * size / 3.0)
        there = replace(scene, subject=subject, simulator=simulator)
        values = observe(subject)
        return _Made(cause, drawn, Change(), subject, simulator, values, there.seen(values), scene.percent)

    target = _target(scene)
    return _at_strength(make, 1.5, target) or make(1.0)


def _columns(scene: _Scene, made: _Made, *, finely: bool = False) -> list[tuple[str, Array]]:
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


def _shapes(scene: _Scene, made: _Made, cause: Cause, finely: bool) -> list[Draw]:
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


def _class(name: str, left: Array, columns: list[tuple[str, Array]]) -> tuple[str, ...]:
    """The name and all whose columns look the same."""
    alike = cosines(np.stack([left, *(c for _, c in columns)], axis=1))[0, 1:]
    return tuple(sorted({name} | {other for (other, _), c in zip(columns, alike) if c >= _SAME}))


def _ceiling(made: _Made, columns: list[tuple[str, Array]], same: tuple[str, ...], rng: np.random.Generator) -> float:
    """Share of noise draws in which the best matched filter, one a name, is one of the class."""
    if made.cause.flag:
        return 1.0
    first: dict[str, Array] = {}
    for name, column in columns:
        first.setdefault(name, column)
    first[made.cause.name] = made.seen.left
    unit = np.stack([c / np.linalg.norm(c) for c in first.values()], axis=1)
    scores = np.abs((made.seen.left + rng.standard_normal((_FILTERED, len(unit)))) @ unit)
    names = list(first)
    return float(np.mean([names[k] in same for k in scores.argmax(axis=1)]))


def _pair(scene: _Scene, noise: str) -> tuple[Subject, Simulator, Answer]:
    usual = tuple(c for c in KNOWN if not c.flag)
    for attempt in range(_TRIES):
        scene = _quieter(scene, attempt)
        made: list[_Made] = []
        for k in scene.rng.choice(len(usual), 2, replace=False):
            found = _scaled(scene, usual[k], draw(scene.rng, scene.subject), float(scene.rng.uniform(*_PAIR)))
            if found is None:
                break
            made.append(found)
        if len(made) < 2:
            continue
        left = [m.seen.left for m in made]
        alike = cosines(np.stack(left, axis=1))[0, 1]
        least = float(min(np.linalg.norm(c) for c in left) * np.sqrt(1.0 - alike**2))
        if least < _PAIR_LEAST:
            continue
        both = sorted(made, key=lambda m: m.cause.name)
        values = observe(scene.subject, tuple(m.change for m in both))
        answer = Answer(
            kind="pair",
            noise=noise,
            percent=scene.percent,
            names=tuple(m.cause.name for m in both),
            classes=tuple(_class(m.cause.name, m.seen.left, _columns(scene, m)) for m in both),
            stages=tuple(m.cause.stage for m in both),
            detectability=scene.seen(values).detectability,
            perpendicular=least,
            ceiling=0.0,
            frame=-1,
            region=-1,
            clean=values,
        )
        return scene.subject, scene.simulator, answer
    raise RuntimeError(f"No two causes reached their strengths in {_TRIES} draws.")
