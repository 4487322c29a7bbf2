"""Image cases: a scan as the product sees it, and apart from it the answer; both follow from split, seed and index."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld import causes as regional
from petkin_bench.withheld.cases import SPLITS
from petkin_bench.withheld.causes import draw
from petkin_bench.withheld.classes import same_of_its_size
from petkin_bench.withheld.images.causes import ALIKE, KNOWN, OTHER_FORMS, PLAIN, SPATIAL, UNKNOWN, Cause, Place
from petkin_bench.withheld.images.head import NAMES, VOXEL, draw_head
from petkin_bench.withheld.images.strength import Filter, matched
from petkin_bench.withheld.images.taking import AS_ALWAYS, Grain, Scanned, Shot, grain, means, pieces, retaken, taken
from petkin_bench.withheld.making import Made as MadeCurves
from petkin_bench.withheld.noise import KINDS, law
from petkin_bench.withheld.observe import Change, observe
from petkin_bench.withheld.subject import Blood, Frames, Subject, draw_subject
from petkin_bench.withheld.visibility import Simulator, cosines, perpendicular, seen

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
_TRIES, _CLOSE, _SAME, _FILTERED = 40, 0.1, 0.95, 400
#: Share of a cause's largest size at which columns are taken: what is weak is linear.
WEAK = 0.15
#: kBq/mL of a frame before the tracer is there.
_NOTHING = 1e-9
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


@dataclass(frozen=True)
class _Scene:
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
    scene: _Scene
    image: Array
    filter: Filter
    fitted: Subject
    left: Array
    detectability: float

    @property
    def of_simulator(self) -> bool:
        """Whether the cause is a part that the simulator lacks."""
        return self.scene.simulator != Simulator()


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
    scene = _Scene(rng, scanned, Simulator(), float(rng.choice(_PERCENT)), share, freedom)
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


def _withheld(scene: _Scene, kind: str, split: str) -> Made:
    if kind == "plain" and scene.rng.random() < _PARTS:
        return _withheld_part(scene)
    choice = {"known": SPATIAL, "other form": OTHER_FORMS[split], "plain": PLAIN, "unknown": UNKNOWN[split]}[kind]
    return _single(scene, choice, of_unknown=kind == "unknown")


def _answer(scene: _Scene, kind: str, noise: str, made: Made | None) -> ImageAnswer:
    width = scene.scanned.width
    if made is None:
        return ImageAnswer(kind, noise, scene.percent, (), (), (), 0, 0, 0, -1, -1, 0, width)
    cause, columns = made.cause, _columns(made)
    names = (cause.name,) if cause.name else ()
    same = _class(made, [*columns, *_columns(made, ALIKE)]) if names else ()
    drawn, frames = made.place.drawn, scene.scanned.subject.frames
    return ImageAnswer(
        kind=kind,
        noise=noise,
        percent=scene.percent,
        names=names,
        classes=(same,) if names else (),
        stages=(cause.stage,),
        detectability=made.detectability,
        perpendicular=_beyond(made, [c for name, c in columns if name not in same]),
        ceiling=_ceiling(made, columns, same, scene.rng) if names else 0.0,
        frame=int(np.searchsorted(frames.end, drawn.onset)) if cause.onset else -1,
        region=drawn.region if cause.local else -1,
        size=made.size,
        width=width,
    )


def _place(scene: _Scene) -> Place:
    drawn = draw(scene.rng, scene.scanned.subject)
    drawn = replace(drawn, region=int(scene.rng.integers(len(NAMES))))
    return Place(drawn, int(scene.rng.integers(3)), scene.scanned.head)


def _possible(cause: Cause, scene: _Scene) -> bool:
    """Blur is withheld only where the simulator has none; a head moves only where there is some, else voxels jump."""
    blurred = scene.scanned.width > 0
    return not blurred if cause.name == "partial_volume" else blurred or not cause.name.startswith("motion")


def _single(scene: _Scene, causes: tuple[Cause, ...], *, of_unknown: bool) -> Made:
    """A cause that reaches its strength within what is plausible; of an unknown one, beyond all known ones."""
    causes = tuple(c for c in causes if _possible(c, scene))
    for _ in range(_TRIES):
        cause = causes[int(scene.rng.integers(len(causes)))]
        place, target = _place(scene), _target(scene)

        def make(size: float, cause: Cause = cause, place: Place = place) -> Made:
            return _made(scene, cause, place, size)

        made = _at_strength(make, cause.most, target)
        if made is None or not of_unknown:
            if made is not None:
                return made
            continue
        beyond = _beyond(made, [c for _, c in _columns(made)])
        made = _at_strength(make, cause.most, target * made.detectability / max(beyond, 1e-9))
        if made is not None:
            return made
    raise RuntimeError(f"No cause reached its strength in {_TRIES} draws.")


def _target(scene: _Scene) -> float:
    return float(scene.rng.uniform(*BINS[int(scene.rng.integers(len(BINS)))]))


def _at_strength(make: Callable[[float], Made], most: float, target: float) -> Made | None:
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


def _made(scene: _Scene, cause: Cause, place: Place, size: float, shot: Shot | None = None) -> Made:
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


def _fitted(scene: _Scene, shot: Shot) -> Subject:
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


def _withheld_part(scene: _Scene) -> Made:
    """A part of the simulator that the subject has and the simulator lacks, made as weak as its strength asks."""
    which = int(scene.rng.integers(3))
    simulator = Simulator(which != 0, which != 1, which != 2)
    name = ("second_tissue", "blood_volume", "arterial_delay")[which]
    cause = Cause(name, ("tissue", "vascular", "input")[which], lambda size, place: AS_ALWAYS, 1.5, spatial=False)
    place, late = _place(scene), float(scene.rng.choice([-1.0, 1.0]))

    def make(size: float) -> Made:
        subject = scene.scanned.subject
        if which == 0:
            subject = replace(subject, rates=subject.rates * np.array([1.0, 1.0, size, 1.0]))
        elif which == 1:
            subject = replace(subject, vB=subject.vB * size)
        else:
            subject = replace(subject, delay=late * size / 3.0)
        there = replace(scene, scanned=replace(scene.scanned, subject=subject), simulator=simulator)
        return _made(there, cause, place, size, AS_ALWAYS)

    return _at_strength(make, 1.5, _target(scene)) or make(1.0)


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
        if not _possible(cause, made.scene):
            continue
        for place in _places(made, cause, onsets if cause.onset else ()):
            change = retaken(scanned, cause.build(WEAK * cause.most, place), plain) - plain
            left = made.filter.left(change)
            if np.linalg.norm(left) > 1e-6:
                yield cause.name, left


def _columns(made: Made, causes: tuple[Cause, ...] = KNOWN) -> list[tuple[str, Array]]:
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


def _class(made: Made, columns: list[tuple[str, Array]]) -> tuple[str, ...]:
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
    curves = MadeCurves(part, made.place.drawn, Change(), subject, scene.simulator, values, refitted, scene.percent)
    return same_of_its_size(curves, noise)


def _beyond(made: Made, others: list[Array]) -> float:
    """Share of d' that no one and no two of the others explain, times d'."""
    return made.detectability * perpendicular(made.left, others) / max(float(np.linalg.norm(made.left)), 1e-300)


def _ceiling(made: Made, columns: list[tuple[str, Array]], same: tuple[str, ...], rng: np.random.Generator) -> float:
    """Share of noise draws in which the best matched filter, one a name and place, is one of the class."""
    own = made.left / np.linalg.norm(made.left)
    unit = np.stack([own, *(c for _, c in columns)], axis=1)
    names = [made.cause.name, *(name for name, _ in columns)]
    gram = unit.T @ unit
    values, vectors = np.linalg.eigh(gram)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    scores = np.abs(made.detectability * gram[0] + rng.standard_normal((_FILTERED, len(names))) @ root.T)
    return float(np.mean([names[k] in same for k in scores.argmax(axis=1)]))
