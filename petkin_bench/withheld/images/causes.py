"""What is withheld from images: spatial effects of the catalogue's words, other forms of them, and causes of no name.

Sizes are mm of blur or motion, or relative; a cause's size is scaled to a detectability.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from petkin_bench.withheld import causes as regional
from petkin_bench.withheld.changes import Draw, hot, later, passed
from petkin_bench.withheld.images.head import GRID, NAMES, VOXEL, Head, Pose
from petkin_bench.withheld.images.taking import STEP_MM, Shot
from petkin_bench.withheld.subject import Frames

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Place:
    """What a cause draws besides: an axis of the grid, and the head that it acts in."""

    drawn: Draw
    axis: int
    head: Head


#: Causes of curves alone that are withheld from images too.
PLAIN_NAMES = (
    "arterial_delay",
    "dispersion",
    "parent_fraction",
    "vascular_trapping",
    "time_varying_kinetics",
    "flow_change",
    "half_life_error",
)

#: Size and what was drawn -> what changes of the picture.
Build = Callable[[float, Place], Shot]


@dataclass(frozen=True)
class Cause:
    """One cause: as in `causes.Cause`; `spatial` where it differs within regions."""

    name: str
    stage: str
    build: Build
    most: float
    onset: bool = False
    local: bool = False
    spatial: bool = True


def _camera(change: Callable[[Array, Frames, float, Place], Array]) -> Build:
    return lambda size, place: Shot(camera=lambda x, f: change(x, f, size, place))


def _along(place: Place) -> Array:
    """-1 to 1 along the axis over the brain's width, on the grid."""
    axis = (np.arange(GRID) - (GRID - 1) / 2) * VOXEL / float(place.head.radii[place.axis])
    shape = [1, 1, 1]
    shape[place.axis] = GRID
    return np.asarray(place.drawn.sign * axis.reshape(shape)[..., None], np.float64)


def _moved(size: float, place: Place) -> Pose:
    x, y, z = (place.drawn.sign * size if axis == place.axis else 0.0 for axis in range(3))
    return Pose((x, y, z))


def _on_the_way(pose: Callable[[float, Place], Pose], place: Place, at: Array) -> tuple[tuple[Array, Pose], ...]:
    """Poses with their share of every frame, of a head that has moved so far (K,): steps at which no edge jumps."""
    nodes = STEP_MM * np.arange(int(np.ceil(at.max() / STEP_MM - 1e-9)) + 1)
    hats = [np.interp(at, nodes, row) for row in np.eye(nodes.size)]
    return tuple((hat, pose(float(node), place) if node else Pose()) for hat, node in zip(hats, nodes, strict=True))


def _step(pose: Callable[[float, Place], Pose]) -> Build:
    def build(size: float, place: Place) -> Shot:
        def poses(f: Frames) -> tuple[tuple[Array, Pose], ...]:
            after = later(f, place.drawn.onset)
            there = _on_the_way(pose, place, np.full(1, size))
            return (1.0 - after, Pose()), *((after * float(share[0]), each) for share, each in there)

        return Shot(poses=poses)

    return build


def _drift(course: Callable[[Array], Array]) -> Build:
    def build(size: float, place: Place) -> Shot:
        return Shot(poses=lambda f: _on_the_way(_moved, place, size * course(passed(f))))

    return build


def _turned(size: float, place: Place) -> Pose:
    """A turn of the head that moves its rim by the size."""
    return Pose(turned=place.drawn.sign * size / float(place.head.radii[:2].mean()))


def _region(place: Place) -> Array:
    return (place.head.labels == place.drawn.region + 1).astype(float)[..., None]


def _regional_gain(x: Array, f: Frames, size: float, place: Place) -> Array:
    return x * (1.0 + place.drawn.sign * size * _region(place) * later(f, place.drawn.onset))


def _tilted(x: Array, f: Frames, size: float, place: Place) -> Array:
    return x * (1.0 + size * _along(place) * later(f, place.drawn.onset))


def _dome(x: Array, f: Frames, size: float, place: Place) -> Array:
    """One side of the head, from beyond a third of the radius on, all the more the further out."""
    return x * np.exp(-size * np.clip(_along(place) - 0.33, 0.0, None) * 1.5 * later(f, place.drawn.onset))


def _shell(x: Array, f: Frames, size: float, place: Place) -> Array:
    """The outer part of one half."""
    side = 1.0 / (1.0 + np.exp(-6.0 * _along(place)))
    return x * (1.0 - size * side * later(f, place.drawn.onset))


def _mean(x: Array, place: Place) -> Array:
    labels = place.head.labels
    return x[(labels > 0) & (labels <= len(NAMES))].mean(axis=0)


def _scattered(x: Array, f: Frames, size: float, place: Place) -> Array:
    return x + size * _mean(x, place)


def _smeared(x: Array, f: Frames, size: float, place: Place) -> Array:
    wide = 35.0 / VOXEL
    return x + size * 2.0 * gaussian_filter(x, (wide, wide, wide, 0.0), mode="constant", truncate=2.0)


def _offset(x: Array, f: Frames, size: float, place: Place) -> Array:
    level = place.drawn.sign * size * float(_mean(x, place).max())
    return x + level * np.exp(f.decay * (f.mid - f.end[-1]))


def _from_regions(cause: regional.Cause) -> Cause:
    """A cause that changes curves, the same in every voxel of a region."""
    return Cause(
        cause.name,
        cause.stage,
        lambda size, place: Shot(change=cause.build(size, place.drawn)),
        cause.most,
        cause.onset,
        cause.local,
        spatial=False,
    )


def _everywhere(
    name: str, change: Callable[[Array, Frames, float, Place], Array], most: float, *, onset: bool = False
) -> Cause:
    return Cause(name, "imaging", _camera(change), most, onset=onset, spatial=False)


#: Blur, motion and gains that differ across the head.
SPATIAL: tuple[Cause, ...] = (
    Cause("partial_volume", "imaging", lambda size, place: Shot(wider=size), 14.0),
    Cause("motion_step", "imaging", _step(_moved), 12.0, onset=True),
    Cause("motion_drift", "imaging", _drift(lambda passed: passed), 12.0),
    Cause("attenuation_mismatch", "imaging", _camera(_tilted), 0.4, onset=True),
    Cause("attenuation_mismatch", "imaging", _camera(_regional_gain), 0.4, onset=True, local=True),
)
#: What is the same throughout a region or the head: told from those by the image's silence.
PLAIN: tuple[Cause, ...] = (
    *(_from_regions(c) for c in regional.KNOWN if c.name in PLAIN_NAMES),
    _everywhere("scatter_background", _scattered, 0.25),
    _everywhere("randoms_offset", _offset, 0.08),
    _everywhere("dead_time", lambda x, f, s, p: x * (1.0 - s * hot(_mean(x, p)[None], f)), 0.4),
    _everywhere("gain_drift", lambda x, f, s, p: x * (1.0 + p.drawn.sign * s * passed(f)), 0.1),
    _everywhere(
        "gain_step", lambda x, f, s, p: x * (1.0 + p.drawn.sign * s * later(f, p.drawn.onset)), 0.2, onset=True
    ),
)
KNOWN = (*SPATIAL, *PLAIN)
#: What is withheld from no image, but may look like what is: a clock that is off like late blood, a bias like randoms.
ALIKE: tuple[Cause, ...] = tuple(
    _from_regions(c) for c in regional.KNOWN if not c.flag and c.name not in {known.name for known in KNOWN}
)

#: The same effects in another form: seen in training, and kept for the score.
OTHER_FORMS: dict[str, tuple[Cause, ...]] = {
    "training": (
        Cause("attenuation_mismatch", "imaging", _camera(_shell), 0.4, onset=True),
        Cause("motion_drift", "imaging", _drift(np.sqrt), 12.0),
    ),
    "scored": (
        Cause("motion_step", "imaging", _step(_turned), 14.0, onset=True),
        Cause("motion_drift", "imaging", _drift(lambda passed: passed**2), 14.0),
        Cause("attenuation_mismatch", "imaging", _camera(_dome), 0.4, onset=True),
        Cause("partial_volume", "imaging", lambda size, place: Shot(wider=size, tailed=True), 10.0),
        _everywhere("scatter_background", _smeared, 0.25),
    ),
}


def _slab(place: Place) -> Array:
    """A few planes across the head."""
    along = _along(place)
    return (np.abs(along - 0.25 * place.drawn.weights[0]) < 0.25).astype(float)


def _flickering(x: Array, f: Frames, size: float, place: Place) -> Array:
    """Detectors whose gain swings with their temperature."""
    return x * (1.0 + size * _slab(place) * np.sin(2.0 * np.pi * f.mid / (2.5 * place.drawn.length)))


def _fading(x: Array, f: Frames, size: float, place: Place) -> Array:
    """Detectors that fail for a while."""
    d = place.drawn
    return x * (1.0 - size * _slab(place) * np.exp(-0.5 * ((f.mid - d.onset) / d.length) ** 2))


def _striped(x: Array, f: Frames, size: float, place: Place) -> Array:
    """Every other plane too large, the others too small, more and less over the scan."""
    shape = [1, 1, 1, 1]
    shape[place.axis] = GRID
    planes = (-1.0) ** np.arange(GRID).reshape(shape)
    return x * (1.0 + size * planes * np.cos(2.0 * np.pi * passed(f) + place.drawn.weights[0]))


def _leaking(x: Array, f: Frames, size: float, place: Place) -> Array:
    """Tracer collects beside the head and shines into it, then leaves."""
    distance = np.clip(1.3 - _along(place), 0.0, None)
    filled = (f.mid / 20.0) ** 2 * np.exp(2.0 * (1.0 - f.mid / 20.0))
    return x + size * _mean(x, place).mean() * np.exp(-((distance / 0.4) ** 2)) * filled


def _swinging(x: Array, f: Frames, size: float, place: Place) -> Array:
    return x * (1.0 + size * np.sin(2.0 * np.pi * f.mid / (2.5 * place.drawn.length) + place.drawn.weights[0]))


#: Causes that no entry of the catalogue is: seen in training, and kept for the score.
UNKNOWN: dict[str, tuple[Cause, ...]] = {
    "training": (
        Cause("", "imaging", _camera(_fading), 0.7),
        Cause("", "imaging", _camera(_swinging), 0.4, spatial=False),
    ),
    "scored": (
        Cause("", "imaging", _camera(_flickering), 0.7),
        Cause("", "imaging", _camera(_striped), 0.5),
        Cause("", "imaging", _camera(_leaking), 1.0),
    ),
}
