"""What motion adds to voxels and to the means of regions."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from petkin.imaging import WAYS, Exchange, Leg
from petkin.study.diagnosis.gone import PARTS, Gone
from petkin.study.diagnosis.picture import Voxels
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.scene import Scene, laid

Array = NDArray[np.float64]

#: How far regions are seen to move, mm. A mixture of their curves that is weaker than this share of the strongest tells
#: nothing of what motion brings.
_FAR_MM, _TOLD = (-20.0, -15.0, -10.0, -4.0, -1.5, 0.0, 1.5, 4.0, 10.0, 15.0, 20.0), 0.01
#: Share of what a long way adds to regions by which it errs: 0.03 to 0.09 where scans of another maker went 9 to 20 mm.
_MISPLACED = 0.05


def moving(simulator: RegionalSimulator, voxels: Voxels) -> RegionalSimulator:
    """The simulator that knows what motion adds to regions, and how well a way that they have gone tells it."""
    simulator = replace(simulator, moves=moves(voxels))
    if voxels.gone is None:
        return simulator
    expected, _ = apart(voxels, voxels.gone)
    assert expected.expected is not None
    return replace(simulator, misplaced=_MISPLACED * (expected.expected - voxels.fit.values))


def moves(voxels: Voxels) -> Exchange:
    """What motion adds to regions, as the picture tells; along a way that it has gone, with what it goes beside it.

        mean over region r of x as it has moved, less x = sum_s D_rs x_s

    D has no more in it than the curves of the regions tell apart.
    """
    picture, seen, gone = voxels.picture, voxels.seen, voxels.gone
    tried = np.unique([*_FAR_MM, *(() if gone is None else gone.mm * np.array(PARTS))])
    shares = np.linalg.pinv(voxels.fit.values @ picture.courses.T, rcond=_TOLD)
    count = len(voxels.fit.values)
    found = np.zeros((WAYS, len(tried), count, count))
    for way, (n, far) in product(Scene(voxels).motions, enumerate(tried)):
        legs = gone.along(far) if gone is not None and gone.way == way else (Leg(way, far),)
        found[way, n] = voxels.mean_over(laid(picture, legs) - seen) @ shares
    return Exchange(tried, found)


def apart(voxels: Voxels, gone: Gone) -> tuple[Voxels, Voxels]:
    """Voxels that are expected to move, and the same less what that adds."""
    still, scene, name, way = voxels, Scene(voxels), gone.name, gone.way
    for maps, course in zip(scene.parts(name, way), scene.courses(name, way, gone.course), strict=True):
        still = less(still, maps, gone.mm * course)
    return replace(voxels, expected=voxels.fit.values + voxels.means - still.means), still


def less(voxels: Voxels, maps: Array, course: Array) -> Voxels:
    """Voxels less maps (N, M) that follow the courses and one of their own (K,)."""
    curves = voxels.picture.curves - (maps @ (voxels.picture.courses * course)).T.astype(np.float32)
    return replace(voxels, picture=replace(voxels.picture, curves=curves))
