"""Cases: a scan as the product sees it, and apart from it the answer; both follow from split, seed and index alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.beyond import beyond
from petkin_bench.withheld.causes import KNOWN, OTHER_FORMS, UNKNOWN, Cause, draw
from petkin_bench.withheld.classes import ceiling_of, class_of, columns_of
from petkin_bench.withheld.making import Made, Scene, drawn_target, scaled, withheld_part
from petkin_bench.withheld.noise import KINDS, noisy
from petkin_bench.withheld.observe import observe
from petkin_bench.withheld.subject import Blood, Frames, Subject, draw_subject
from petkin_bench.withheld.visibility import Simulator, cosines, perpendicular

Array = NDArray[np.float64]

#: Seeds of different splits never meet; forms and unknown causes differ too.
SPLITS = {"training": 1, "scored": 2}
#: Kinds of case and their shares.
_KINDS = {"none": 0.25, "known": 0.35, "other form": 0.12, "unknown": 0.13, "pair": 0.15}
PERCENT = (1.0, 2.0, 4.0)
#: Each of a pair, alone; what the other leaves of it.
_PAIR, _PAIR_LEAST = (7.0, 14.0), 6.0
#: How often a part of the simulator is withheld in place of a cause.
_PARTS = 0.2
#: Draws of a cause at most; after so many that reach no strength within what is plausible, noise is as small as can be.
TRIES, _QUIET = 90, 30


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
        perpendicular: of what neither one nor two catalogued effects outside its classes explain, as weak ones; of an
            unknown cause, what they leave when everything of them is refitted; of a pair, the lesser beside the other.
        ceiling: probability that a matched filter names the class.
        frame: of the onset, or the one that is concerned; -1 for none.
        region: the one in which it acts; -1 for all.
        size: of one cause, without its sign; 0 for none, two, or what has no size.
        onset: of one cause, min; -1 for none.
        clean: values without noise (R, K).
        noisiness: of every region (R,).
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
    size: float
    onset: float
    clean: Array
    noisiness: Array


def case(split: str, seed: int, index: int, regions: int = 5, frames: str = "clinical") -> tuple[Scan, Answer]:
    """One case; the same arguments give the same bytes."""
    rng = np.random.default_rng([SPLITS[split], seed, index])
    kind = str(rng.choice(list(_KINDS), p=list(_KINDS.values())))
    noise = str(rng.choice(list(KINDS)))
    share, freedom = KINDS[noise]
    scene = Scene(rng, draw_subject(rng, regions, frames), Simulator(), float(rng.choice(PERCENT)), share)
    subject, simulator, answer = _answer(scene, kind, split, noise)
    noise_law = replace(scene, percent=answer.percent).law(answer.clean)
    return scan_of(subject, simulator, noisy(answer.clean, noise_law, freedom, rng)), answer


def scan_of(subject: Subject, simulator: Simulator, values: Array) -> Scan:
    """Curves (R, K) of a subject, as the product is given them."""
    names = tuple(f"region{r + 1}" for r in range(len(values)))
    parts = (("blood_volume", simulator.blood_volume), ("arterial_delay", simulator.delay))
    includes = tuple(name for name, there in parts if there)
    model = "2tcm" if simulator.second_tissue else "1tcm"
    return Scan(names, subject.frames, values, subject.blood, model, includes)


def _answer(scene: Scene, kind: str, split: str, noise: str) -> tuple[Subject, Simulator, Answer]:
    if kind == "none":
        clean = observe(scene.subject)
        rough = scene.subject.noisiness
        nothing = Answer(kind, noise, scene.percent, (), (), (), 0.0, 0.0, 0.0, -1, -1, 0.0, -1.0, clean, rough)
        return scene.subject, scene.simulator, nothing
    if kind == "pair":
        return _pair(scene, noise)
    if kind == "known" and scene.rng.random() < _PARTS:
        made = withheld_part(scene)
    else:
        causes = {"known": KNOWN, "other form": OTHER_FORMS[split], "unknown": UNKNOWN[split]}[kind]
        made = single(scene, causes, of_unknown=kind == "unknown")
    scene = replace(scene, subject=made.subject, simulator=made.simulator, percent=made.percent)
    cause = made.cause
    names, same, ceiling = (), (), 0.0
    if cause.name:
        columns = columns_of(scene, made)
        names, same = (cause.name,), class_of(made, scene.law(made.values), columns)
        finely = columns_of(scene, made, finely=True)
        left = perpendicular(made.seen.left, [c for name, c in finely if name not in same])
        ceiling = ceiling_of(made, columns, same, scene.rng)
    else:
        left = beyond(made, scene.law(made.values))
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
        perpendicular=left,
        ceiling=ceiling,
        frame=frame,
        region=region,
        size=0.0 if cause.flag else made.size,
        onset=made.drawn.onset if cause.onset else -1.0,
        clean=made.values,
        noisiness=made.subject.noisiness,
    )
    return made.subject, made.simulator, answer


def _frame_of(made: Made) -> int:
    return int(np.searchsorted(made.subject.frames.end, made.drawn.onset))


def _quieter(scene: Scene, attempt: int) -> Scene:
    return replace(scene, percent=PERCENT[0]) if attempt >= _QUIET else scene


def single(scene: Scene, causes: Sequence[Cause], *, target: float | None = None, of_unknown: bool = False) -> Made:
    """A cause that reaches its strength within what is plausible; of an unknown one, beyond all weak known ones.

    Args:
        scene: where; where none reaches it for long, in less noise.
        causes: of which it is one.
        target: d'; None for one drawn anew with every cause.
        of_unknown: whether the strength is that beyond known ones.
    """
    for attempt in range(TRIES):
        scene = _quieter(scene, attempt)
        cause = causes[int(scene.rng.integers(len(causes)))]
        wanted = drawn_target(scene) if target is None else target
        made = scaled(scene, cause, draw(scene.rng, scene.subject), wanted)
        if made is None or not of_unknown:
            if made is not None:
                return made
            continue
        left = perpendicular(made.seen.left, [c for _, c in columns_of(scene, made, finely=True)])
        stronger = scaled(scene, cause, made.drawn, wanted * made.seen.detectability / max(left, 1e-9))
        if stronger is not None:
            return stronger
    raise RuntimeError(f"No cause reached its strength in {TRIES} draws.")


def _pair(scene: Scene, noise: str) -> tuple[Subject, Simulator, Answer]:
    usual = tuple(c for c in KNOWN if not c.flag)
    for attempt in range(TRIES):
        scene = _quieter(scene, attempt)
        made: list[Made] = []
        for k in scene.rng.choice(len(usual), 2, replace=False):
            found = scaled(scene, usual[k], draw(scene.rng, scene.subject), float(scene.rng.uniform(*_PAIR)))
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
            classes=tuple(class_of(m, scene.law(m.values), columns_of(scene, m)) for m in both),
            stages=tuple(m.cause.stage for m in both),
            detectability=scene.seen(values).detectability,
            perpendicular=least,
            ceiling=0.0,
            frame=-1,
            region=-1,
            size=0.0,
            onset=-1.0,
            clean=values,
            noisiness=scene.subject.noisiness,
        )
        return scene.subject, scene.simulator, answer
    raise RuntimeError(f"No two causes reached their strengths in {TRIES} draws.")
