"""A way that a picture has gone, and frames laid back where they would be without it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from petkin.imaging import Leg, origins

Array = NDArray[np.float64]

#: Effects that move the picture: at once, by and by.
STEP, DRIFT = "motion_step", "motion_drift"
#: Parts of a long way at which what it adds is drawn, the first none of it.
PARTS = (0.0, 0.25, 0.5, 0.75, 1.0)


def between(at: Array, nodes: Sequence[float]) -> Array:
    """Weights (n, K) of what is known at nodes (n,), ascending, for what lies between them at (K,): linear."""
    return np.stack([np.interp(at, nodes, each) for each in np.eye(len(nodes))])


@dataclass(frozen=True)
class Gone:
    """A way that a picture has gone.

    Args:
        name: of the effect that it is.
        way: of moving, as of `Motion`.
        mm: how far, at most.
        course: of what moves at once the share of every frame, of what drifts the part of its way (K,).
        setting: of the effect.
        beside: other ways that it goes as well, by mm for each mm of the first.
        told: of every motion that was looked for, by name, its settings with their log evidence.
    """

    name: str
    way: int
    mm: float
    course: Array
    setting: Mapping[str, float] = field(default_factory=dict)
    beside: tuple[Leg, ...] = ()
    told: Mapping[str, Sequence[tuple[Mapping[str, float], float]]] = field(default_factory=dict)

    def legs(self, part: float = 1.0) -> tuple[Leg, ...]:
        """A part of it."""
        return self.along(part * self.mm)

    def along(self, mm: float) -> tuple[Leg, ...]:
        """The same way, so far."""
        return Leg(self.way, mm), *(Leg(leg.way, mm * leg.far) for leg in self.beside)

    def back(self, part: float) -> tuple[Leg, ...]:
        """What undoes a part of it."""
        return tuple(Leg(leg.way, -leg.far) for leg in reversed(self.legs(part)))

    def aside(self, way: int, share: float) -> Gone:
        """The same, along another way as well."""
        return replace(self, beside=(*self.beside, Leg(way, share)))

    def is_that(self, other: Gone | None) -> bool:
        """Whether another is the same way."""
        if other is None or (self.name, self.legs()) != (other.name, other.legs()):
            return False
        return bool(np.array_equal(self.course, other.course))

    @property
    def gradual(self) -> bool:
        return self.name == DRIFT

    @property
    def most(self) -> float:
        """No voxel has moved further, mm."""
        return sum(abs(leg.far) for leg in self.legs())


@dataclass(frozen=True)
class Undone:
    """Frames laid back where they would be at rest, in the box of a picture.

    Args:
        gone: what is undone.
        labelled: mask of what moves, in the wide box.
        box: what is laid back.
        wide: the box with as much beside it as comes in.
        at: places of the box in the wide one (3, n).
        size: voxel edges, mm.
    """

    gone: Gone
    labelled: NDArray[np.bool_]
    box: tuple[slice, ...]
    wide: tuple[slice, ...]
    at: Array
    size: tuple[float, ...]

    @classmethod
    def of(
        cls,
        gone: Gone,
        labelled: NDArray[np.bool_],
        box: tuple[slice, ...],
        size: tuple[float, ...],
        more: Sequence[int],
    ) -> Undone:
        wide = tuple(slice(max(each.start - m, 0), each.stop + m) for each, m in zip(box, more, strict=True))
        inner = [each.start - around.start for each, around in zip(box, wide, strict=True)]
        at = np.indices(labelled[box].shape, float).reshape(3, -1) + np.array(inner, float)[:, None]
        return cls(gone, labelled[wide], box, wide, at, size)

    def __call__(self, frame: NDArray[np.float32], k: int) -> NDArray[np.float32]:
        """Frame k; where what moves at once does so during it, it is where it is for longer."""
        part = float(self.gone.course[k])
        part = part if self.gone.gradual else float(part >= 0.5)
        if part == 0.0:
            return frame
        laid = frame.copy()
        went = origins(self.at, self.gone.back(part), self.size, self.labelled)
        there = map_coordinates(frame[self.wide], went, mode="constant")
        laid[self.box] = there.reshape(laid[self.box].shape)
        return laid
