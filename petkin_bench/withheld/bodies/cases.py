"""Cases: pictures of several runs as the product sees them, and apart from them the answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.bodies.causes import KNOWN, Cause, Drawn, other_forms, unknown
from petkin_bench.withheld.bodies.refit import Watched, watched
from petkin_bench.withheld.bodies.rigs import RIGS, Kit, Rig
from petkin_bench.withheld.cases import SPLITS
from petkin_bench.withheld.classes import named_by_filters
from petkin_bench.withheld.making import BINS
from petkin_bench.withheld.noise import KINDS
from petkin_bench.withheld.visibility import cosines, perpendicular

Array = NDArray[np.float64]

#: The systems in turn, in place of one.
ALL = "bodies"
#: Kinds of case and their shares.
_KINDS = {"none": 0.25, "known": 0.35, "other form": 0.12, "unknown": 0.13, "pair": 0.15}
#: Standard deviations of a place, in units of the picture's half; runs of a case.
NOISE, RUNS = (0.003, 0.01, 0.02), (2, 3, 5)
#: Each of a pair alone, and what the other leaves of it.
_PAIR, _PAIR_LEAST = (7.0, 14.0), 6.0
#: Causes alike above this cosine are one class; how near a strength must be.
_SAME, _CLOSE = 0.95, 0.08
#: Draws of a cause at most; after so many that reach no strength, noise is as small as can be.
_TRIES, _QUIET = 120, 30
#: Pitches of a push that a class is asked at.
_PITCHES = (0.8, 1.3, 2.0, 3.2, 5.0)
#: A weak size, in units of the most; what sets these cases apart from those of scans of the same seed.
_WEAK, _STREAM = 0.1, 11


@dataclass(frozen=True)
class Film:
    """What the product is given: the system, and points (runs, P 2 T) in pictures."""

    system: str
    places: Array


@dataclass(frozen=True)
class FilmAnswer:
    """What was withheld; fields as of `cases.Answer`, `percent` being the noise in hundredths of the picture's half.

    Args:
        system: which.
        runs: how many.
        clean: points without noise (runs, P 2 T).
    """

    system: str
    runs: int
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
    clean: Array


@dataclass(frozen=True)
class Scene:
    """Runs before anything is withheld.

    Args:
        rng: randomness.
        rig: the system.
        starts, parameters: of its runs.
        sd: noise of a place.
        share: of its variance that all points of a picture have in common.
    """

    rng: np.random.Generator
    rig: Rig
    starts: Array
    parameters: Array
    sd: float
    share: float

    def quieter(self, attempt: int) -> Scene:
        """After many attempts, with little noise."""
        return replace(self, sd=NOISE[0]) if attempt >= _QUIET else self


@dataclass(frozen=True)
class Made:
    """A cause at its size, and what a refit leaves of it."""

    cause: Cause
    drawn: Drawn
    size: float
    seen: Watched

    @property
    def kit(self) -> Kit:
        return self.cause.kit(self.size, self.drawn)


def film_case(split: str, seed: int, index: int, system: str = ALL) -> tuple[Film, FilmAnswer]:
    """One case; the same arguments give the same bytes.

    Args:
        split, seed, index: which.
        system: which; or all, which take turns.
    """
    rng = np.random.default_rng([SPLITS[split], seed, index, _STREAM])
    rig = RIGS[list(RIGS)[index % len(RIGS)] if system == ALL else system]
    kind = str(rng.choice(list(_KINDS), p=list(_KINDS.values())))
    noise = str(rng.choice(list(KINDS)))
    share, freedom = KINDS[noise]
    starts, parameters = rig.drawn(rng, int(rng.choice(RUNS)))
    scene = Scene(rng, rig, starts, parameters, float(rng.choice(NOISE)), share)
    answer = _answer(scene, kind, split, noise)
    return Film(rig.name, answer.clean + _noise(scene, answer.percent / 100.0, freedom, answer.clean.shape)), answer


def _noise(scene: Scene, sd: float, freedom: int, shape: tuple[int, ...]) -> Array:
    """Of unit variance times sd: each point's own, and of a picture that shakes as a whole."""
    runs, frames = len(scene.starts), scene.rig.frames
    points = shape[1] // (2 * frames)

    def unit(*size: int) -> Array:
        if not freedom:
            return scene.rng.standard_normal(size)
        return np.asarray(scene.rng.standard_t(freedom, size) * np.sqrt((freedom - 2) / freedom), np.float64)

    alone, common = unit(runs, points, 2, frames), unit(runs, 1, 2, frames)
    return np.asarray(sd * (np.sqrt(1 - scene.share) * alone + np.sqrt(scene.share) * common).reshape(shape))


def _answer(scene: Scene, kind: str, split: str, noise: str) -> FilmAnswer:
    if kind == "none":
        seen = watched(scene.rig, scene.starts, scene.parameters, scene.sd, scene.share, {})
        return _told(scene, kind, noise, (), seen, perpendicular=0.0, classes=(), ceiling=0.0)
    if kind == "pair":
        return _pair(scene, noise)
    system = scene.rig.name
    causes = {"known": KNOWN[system], "other form": other_forms(split, system), "unknown": unknown(split, system)}[kind]
    scene, made = single(scene, causes, of_unknown=kind == "unknown")
    columns = columns_of(scene, made)
    if not made.cause.name:
        left = perpendicular(made.seen.left, [c for _, c in columns])
        return _told(scene, kind, noise, (made,), made.seen, perpendicular=left, classes=(), ceiling=0.0)
    same = class_of(made, columns)
    left = perpendicular(made.seen.left, [c for name, c in columns if name not in same])
    ceiling = named_by_filters(made.seen.left, made.cause.name, columns, same, scene.rng)
    return _told(scene, kind, noise, (made,), made.seen, perpendicular=left, classes=(same,), ceiling=ceiling)


def _told(
    scene: Scene,
    kind: str,
    noise: str,
    made: Sequence[Made],
    seen: Watched,
    *,
    perpendicular: float,
    classes: tuple[tuple[str, ...], ...],
    ceiling: float,
) -> FilmAnswer:
    return FilmAnswer(
        system=scene.rig.name,
        runs=len(scene.starts),
        kind=kind,
        noise=noise,
        percent=100.0 * scene.sd,
        names=tuple(m.cause.name for m in made if m.cause.name),
        classes=classes,
        stages=tuple(m.cause.stage for m in made),
        detectability=seen.detectability if made else 0.0,
        perpendicular=perpendicular,
        ceiling=ceiling,
        frame=-1,
        region=-1,
        size=made[0].size if len(made) == 1 and made[0].cause.name else 0.0,
        clean=seen.values,
    )


def single(scene: Scene, causes: Sequence[Cause], *, of_unknown: bool) -> tuple[Scene, Made]:
    """A cause that reaches its strength within what is plausible; of an unknown one, beyond all weak known ones."""
    for attempt in range(_TRIES):
        scene = scene.quieter(attempt)
        cause = causes[int(scene.rng.integers(len(causes)))]
        target = float(scene.rng.uniform(*BINS[int(scene.rng.integers(len(BINS)))]))
        drawn = cause.draw(scene.rng, scene.rig)
        made = scaled(scene, cause, drawn, target)
        if made is None or not of_unknown:
            if made is not None:
                return scene, made
            continue
        left = perpendicular(made.seen.left, [c for _, c in columns_of(scene, made)])
        made = scaled(scene, cause, drawn, target * made.seen.detectability / max(left, 1e-9))
        if made is not None:
            return scene, made
    raise RuntimeError(f"No cause reached its strength in {_TRIES} draws.")


def scaled(scene: Scene, cause: Cause, drawn: Drawn, target: float) -> Made | None:
    """A cause as large as a d' asks, None where that is not plausible."""
    sign = float(scene.rng.choice([-1.0, 1.0])) if cause.signed else 1.0
    size = 0.1 * cause.most
    for _ in range(7):
        seen = watched(scene.rig, scene.starts, scene.parameters, scene.sd, scene.share, cause.kit(sign * size, drawn))
        reached = seen.detectability
        if abs(reached / target - 1.0) < _CLOSE:
            return Made(cause, drawn, sign * size, seen)
        wanted = size * target / max(reached, 1e-6)
        if wanted > 3.0 * cause.most or (size >= cause.most and reached < target):
            return None
        size = min(wanted, cause.most)
    return None


def columns_of(scene: Scene, made: Made) -> list[tuple[str, Array]]:
    """What the refit leaves of every catalogued effect at a weak size, with its name, at several pitches."""
    found = []
    for cause in KNOWN[scene.rig.name]:
        shapes: list[Drawn] = [{}]
        if cause.name == "forcing":
            fast = 4.0 if scene.rig.turning else 1.0
            shapes = [{"pitch": fast * pitch, "phase": phase} for pitch in _PITCHES for phase in (0.0, np.pi / 2)]
        if cause.name == made.cause.name and made.drawn and made.cause.knob == cause.knob:
            shapes.insert(0, made.drawn)
        for drawn in shapes:
            size = _WEAK * cause.most
            change = made.seen.change(cause.kit(size, drawn)) / size
            left = made.seen.project(change)
            if np.linalg.norm(left) > 1e-3 * np.linalg.norm(change):
                found.append((cause.name, left))
    return found


def class_of(made: Made, columns: list[tuple[str, Array]]) -> tuple[str, ...]:
    """The name and all that looks the same."""
    alike = cosines(np.stack([made.seen.left, *(c for _, c in columns)], axis=1))[0, 1:]
    same = {name for (name, _), c in zip(columns, alike, strict=True) if c >= _SAME}
    return tuple(sorted({made.cause.name} | same))


def _pair(scene: Scene, noise: str) -> FilmAnswer:
    usual = KNOWN[scene.rig.name]
    for attempt in range(_TRIES):
        scene = scene.quieter(attempt)
        made: list[Made] = []
        for k in scene.rng.choice(len(usual), 2, replace=False):
            drawn = usual[k].draw(scene.rng, scene.rig)
            found = scaled(scene, usual[k], drawn, float(scene.rng.uniform(*_PAIR)))
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
        kit = {**both[0].kit, **both[1].kit}
        seen = watched(scene.rig, scene.starts, scene.parameters, scene.sd, scene.share, kit)
        classes = tuple(class_of(m, columns_of(scene, m)) for m in both)
        return _told(scene, "pair", noise, both, seen, perpendicular=least, classes=classes, ceiling=0.0)
    raise RuntimeError(f"No two causes reached their strengths in {_TRIES} draws.")
