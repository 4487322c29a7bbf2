"""Image cases: a scan as the product sees it, and apart from it the answer; both follow from split, seed and index."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.cases import SPLITS
from petkin_bench.withheld.images.causes import ALIKE, OTHER_FORMS, PLAIN, SPATIAL, UNKNOWN, Cause, Place
from petkin_bench.withheld.images.columns import beyond, ceiling, class_of, unit_columns
from petkin_bench.withheld.images.head import NAMES, VOXEL, draw_head
from petkin_bench.withheld.images.making import Made, Scene, at_strength, made_of, place_in, possible
from petkin_bench.withheld.images.taking import AS_ALWAYS, Scanned, taken
from petkin_bench.withheld.noise import KINDS
from petkin_bench.withheld.subject import Blood, Frames, Subject, draw_subject
from petkin_bench.withheld.visibility import Simulator

Array = NDArray[np.float64]

#: Seconds of every frame: an hour.
FRAMES_S = [15] * 4 + [30] * 4 + [60] * 3 + [180] * 3 + [300] * 9
#: Kinds of case and their shares.
_KINDS = {"none": 0.25, "known": 0.34, "other form": 0.14, "plain": 0.17, "unknown": 0.1}
#: Bins of d' from which a strength is drawn.
BINS = ((4.0, 6.0), (6.0, 10.0), (10.0, 20.0), (20.0, 50.0))
#: FWHM of scanners, mm; where it is not 0, the simulator has partial volume in it.
_WIDTHS = (0.0, 4.0, 6.0)
_PERCENT = (8.0, 15.0)
#: How often a part of the simulator is withheld in place of a plain cause.
_PARTS = 0.45
_TRIES = 40
#: What sets image cases apart from regional ones of the same seed.
_STREAM = 7


@dataclass(frozen=True)
class ImageScan:
    """What the product is given.

    Args:
        image: kBq/mL, corrected for decay [x, y, z, K].
        labels: regions 1 to R [x, y, z].
        voxel: mm.
        regions, frames, blood, model, includes: as of `cases.Scan`.
    """

    image: Array
    labels: NDArray[np.int64]
    voxel: float
    regions: tuple[str, ...]
    frames: Frames
    blood: Blood
    model: str
    includes: tuple[str, ...]


@dataclass(frozen=True)
class ImageAnswer:
    """What was withheld; fields as of `cases.Answer`.

    Args:
        size: of the effect, in mm for blur and motion.
        width: of the scanner's point spread, mm.
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
    width: float


def image_case(split: str, seed: int, index: int) -> tuple[ImageScan, ImageAnswer]:
    """One case; the same arguments give the same bytes."""
    return made_case(split, seed, index)[:2]


def made_case(split: str, seed: int, index: int) -> tuple[ImageScan, ImageAnswer, Made | None]:
    """The same with the cause at its size, None where nothing is withheld."""
    rng = np.random.default_rng([SPLITS[split], seed, index, _STREAM])
    kind = str(rng.choice(list(_KINDS), p=list(_KINDS.values())))
    noise = str(rng.choice(list(KINDS)))
    share, freedom = KINDS[noise]
    scanned = Scanned(draw_head(rng), _subject(rng), float(rng.choice(_WIDTHS)))
    scene = Scene(rng, scanned, Simulator(), float(rng.choice(_PERCENT)), share, freedom)
    made = None if kind == "none" else _withheld(scene, kind, split)
    scene, image = (scene, taken(scanned)) if made is None else (made.scene, made.image)
    answer = _answer(scene, kind, noise, made)
    noisy = scene.grain(image).drawn(image, rng)
    simulator, subject = scene.simulator, scene.scanned.subject
    parts = (
        ("blood_volume", simulator.blood_volume),
        ("arterial_delay", simulator.delay),
        ("partial_volume", scene.scanned.width > 0),
    )
    labels = scanned.head.labels
    scan = ImageScan(
        image=noisy,
        labels=np.where(labels > len(NAMES), 0, labels),
        voxel=VOXEL,
        regions=NAMES,
        frames=subject.frames,
        blood=subject.blood,
        model="2tcm" if simulator.second_tissue else "1tcm",
        includes=tuple(name for name, there in parts if there),
    )
    return scan, answer, made


def _subject(rng: np.random.Generator) -> Subject:
    """A subject whose last region is the scalp, in the frames of image cases."""
    subject = draw_subject(rng, len(NAMES) + 1)
    edges = np.concatenate([[0.0], np.cumsum(FRAMES_S)]) / 60.0
    return replace(subject, frames=Frames(edges[:-1], edges[1:], subject.frames.decay))


def _withheld(scene: Scene, kind: str, split: str) -> Made:
    if kind == "plain" and scene.rng.random() < _PARTS:
        return _withheld_part(scene)
    choice = {"known": SPATIAL, "other form": OTHER_FORMS[split], "plain": PLAIN, "unknown": UNKNOWN[split]}[kind]
    return _single(scene, choice, of_unknown=kind == "unknown")


def _answer(scene: Scene, kind: str, noise: str, made: Made | None) -> ImageAnswer:
    width = scene.scanned.width
    if made is None:
        return ImageAnswer(kind, noise, scene.percent, (), (), (), 0, 0, 0, -1, -1, 0, width)
    cause, columns = made.cause, unit_columns(made)
    names = (cause.name,) if cause.name else ()
    same = class_of(made, [*columns, *unit_columns(made, ALIKE)]) if names else ()
    drawn, frames = made.place.drawn, scene.scanned.subject.frames
    return ImageAnswer(
        kind=kind,
        noise=noise,
        percent=scene.percent,
        names=names,
        classes=(same,) if names else (),
        stages=(cause.stage,),
        detectability=made.detectability,
        perpendicular=beyond(made, [c for name, c in columns if name not in same]),
        ceiling=ceiling(made, columns, same, scene.rng) if names else 0.0,
        frame=int(np.searchsorted(frames.end, drawn.onset)) if cause.onset else -1,
        region=drawn.region if cause.local else -1,
        size=made.size,
        width=width,
    )


def _single(scene: Scene, causes: tuple[Cause, ...], *, of_unknown: bool) -> Made:
    """A cause that reaches its strength within what is plausible; of an unknown one, beyond all known ones."""
    causes = tuple(c for c in causes if possible(c, scene))
    for _ in range(_TRIES):
        cause = causes[int(scene.rng.integers(len(causes)))]
        place, target = place_in(scene, scene.rng), _target(scene)

        def make(size: float, cause: Cause = cause, place: Place = place) -> Made:
            return made_of(scene, cause, place, size)

        made = at_strength(make, cause.most, target)
        if made is None or not of_unknown:
            if made is not None:
                return made
            continue
        left = beyond(made, [c for _, c in unit_columns(made)])
        made = at_strength(make, cause.most, target * made.detectability / max(left, 1e-9))
        if made is not None:
            return made
    raise RuntimeError(f"No cause reached its strength in {_TRIES} draws.")


def _target(scene: Scene) -> float:
    return float(scene.rng.uniform(*BINS[int(scene.rng.integers(len(BINS)))]))


def _withheld_part(scene: Scene) -> Made:
    """A part of the simulator that the subject has and the simulator lacks, made as weak as its strength asks."""
    which = int(scene.rng.integers(3))
    simulator = Simulator(which != 0, which != 1, which != 2)
    name = ("second_tissue", "blood_volume", "arterial_delay")[which]
    cause = Cause(name, ("tissue", "vascular", "input")[which], lambda size, place: AS_ALWAYS, 1.5, spatial=False)
    place, late = place_in(scene, scene.rng), float(scene.rng.choice([-1.0, 1.0]))

    def make(size: float) -> Made:
        subject = scene.scanned.subject
        if which == 0:
            subject = replace(subject, rates=subject.rates * np.array([1.0, 1.0, size, 1.0]))
        elif which == 1:
            subject = replace(subject, vB=subject.vB * size)
        else:
            subject = replace(subject, delay=late * size / 3.0)
        there = replace(scene, scanned=replace(scene.scanned, subject=subject), simulator=simulator)
        return made_of(there, cause, place, size, AS_ALWAYS)

    return at_strength(make, 1.5, _target(scene)) or make(1.0)
