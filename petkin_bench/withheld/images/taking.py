"""Taking a picture: the head in its poses, point spread, what the camera adds, noise; what causes change of that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from petkin_bench.withheld.images.head import GRID, NAMES, REST, VOXEL, Head, Pose, painted
from petkin_bench.withheld.observe import Change, observe
from petkin_bench.withheld.subject import Frames, Subject

Array = NDArray[np.float64]

#: Full width at half maximum over standard deviation.
FWHM = 2.0 * np.sqrt(2.0 * np.log(2.0))
#: Activity of the scalp, as a share of what its kinetics would give.
_SCALP = 0.35
_QUOTIENT = 1e-4
#: Points along the edge of a voxel where there is a point spread; a picture without one has sharp labels. By one step
#: from point to point an edge moves without a jump; between such steps poses are mixed.
_FINE = 3
STEP_MM = VOXEL / _FINE
#: Noise that neighbours share: its width, mm, and its share of the variance.
SHARED_MM, SHARED = 8.0, 0.5
#: A voxel scatters as the root of its mean value, but as no less than this share of the head's.
_LEAST = 0.15


_NO_CHANGE = Change()


@dataclass(frozen=True)
class Shot:
    """What a cause changes of how the picture comes about; what is not given is as always.

    Args:
        change: of blood, tissue, clock, or of the regions' values one by one.
        poses: of the head, each with its share of every frame; none is at rest.
        wider: FWHM by which the point spread is wider, mm; `tailed`: with a tail of twice that width.
        camera: image [x, y, z, K] -> what the camera makes of it.
    """

    change: Change = _NO_CHANGE
    poses: Callable[[Frames], tuple[tuple[Array, Pose], ...]] | None = None
    wider: float = 0.0
    tailed: bool = False
    camera: Callable[[Array, Frames], Array] | None = None


AS_ALWAYS = Shot()


@dataclass(frozen=True)
class Scanned:
    """Who is scanned and how: one more region of the subject is the scalp; `width` is the scanner's FWHM, mm."""

    head: Head
    subject: Subject
    width: float


def taken(scanned: Scanned, shot: Shot = AS_ALWAYS, *, varied: bool = True) -> Array:
    """The picture without noise [x, y, z, K], with kinetics that vary within regions or without."""
    curves, derivatives = pieces(scanned.subject, shot.change, varied=varied)
    frames, fine = scanned.subject.frames, _FINE if scanned.width else 1
    poses = ((np.ones(len(frames.start)), REST),) if shot.poses is None else shot.poses(frames)
    image = np.zeros((GRID, GRID, GRID, len(frames.start)))
    for share, pose in poses:
        image += share * painted(scanned.head, pose, curves, derivatives, fine=fine)
    image = spread_out(image, scanned.width)
    image = spread_out(image, shot.wider)
    if shot.tailed:
        image = 0.7 * image + 0.3 * spread_out(image, 2.0 * shot.wider)
    return image if shot.camera is None else shot.camera(image, frames)


def retaken(scanned: Scanned, shot: Shot, plain: Array) -> Array:
    """As `taken` without variation, from the picture without the cause where that is all that it changes."""
    if shot.camera is None or shot.change is not AS_ALWAYS.change:
        return taken(scanned, shot, varied=False)
    return shot.camera(plain, scanned.subject.frames)


def pieces(subject: Subject, change: Change, *, varied: bool = True) -> tuple[Array, Array]:
    """Curves (R + 1, K), and their derivatives by the logarithms of rates and vB (R + 1, P, K), no P if not varied."""
    changes = (change,)
    here = observe(subject, changes)
    weight = np.ones((len(here), 1))
    weight[-1] = _SCALP
    if not varied:
        return here * weight, np.zeros((len(here), 0, here.shape[1]))
    found = []
    for p in range(4):
        factor = np.where(np.arange(4) == p, 1.0 + _QUOTIENT, 1.0)
        found.append(observe(replace(subject, rates=subject.rates * factor), changes) - here)
    found.append(observe(replace(subject, vB=subject.vB * (1.0 + _QUOTIENT)), changes) - here)
    derivatives = np.stack(found, axis=1) / _QUOTIENT
    return here * weight, derivatives * weight[:, :, None]


def spread_out(image: Array, width: float) -> Array:
    """Through a point spread of this FWHM, mm."""
    if width <= 0:
        return image
    sigma = width / FWHM / VOXEL
    return gaussian_filter(image, (sigma, sigma, sigma, 0.0), mode="constant")


def means(image: Array, head: Head) -> Array:
    """Means over the labelled regions (R, K)."""
    labels = head.labels
    return np.stack([image[labels == r + 1].mean(axis=0) for r in range(len(NAMES))])


@dataclass(frozen=True)
class Grain:
    """Noise of a picture: sd of a voxel is m(v) a(k); a share of it is common to its neighbours, and a jitter of the
    whole frame, relative to its values, is common to all.

    Args:
        m: [x, y, z].
        a: (K,).
        jitter: relative sd of a frame's values (K,).
        freedom: of Student's t of the frames' scales; 0 for normal noise.
    """

    m: Array
    a: Array
    jitter: Array
    freedom: int

    def mixed(self, fields: Array) -> Array:
        """Covariance of a frame's noise, in units of m a, applied to fields [x, y, z, ...]."""
        sigma = SHARED_MM / FWHM / VOXEL * np.sqrt(2.0)
        gain = (2.0 * np.sqrt(np.pi) * SHARED_MM / FWHM / VOXEL) ** 3
        width = (sigma, sigma, sigma, *(0.0 for _ in fields.shape[3:]))
        return (1.0 - SHARED) * fields + SHARED * gain * gaussian_filter(fields, width, mode="constant")

    def drawn(self, image: Array, rng: np.random.Generator) -> Array:
        """The picture with noise."""
        sigma = SHARED_MM / FWHM / VOXEL
        gain = (2.0 * np.sqrt(np.pi) * sigma) ** 1.5
        noisy = np.empty_like(image)
        for k in range(image.shape[-1]):
            white, smooth = rng.standard_normal((2, GRID, GRID, GRID))
            unit = np.sqrt(1.0 - SHARED) * white + np.sqrt(SHARED) * gain * gaussian_filter(smooth, sigma, mode="wrap")
            scale = np.sqrt((self.freedom - 2) / rng.chisquare(self.freedom)) if self.freedom else 1.0
            common = 1.0 + self.jitter[k] * rng.standard_normal() * scale
            noisy[..., k] = image[..., k] * common + self.m * self.a[k] * unit * scale
        return noisy


def grain(image: Array, head: Head, frames: Frames, percent: float, share: float, freedom: int) -> Grain:
    """Noise of counts: a voxel of the brain scatters by so many percent in the median of late frames.

    Args:
        image: without noise.
        head: whose brain is meant.
        frames: of the scan.
        percent: of a voxel.
        share: of the variance of a region's mean that is common to a frame.
        freedom: of the frames' scales.
    """
    brain = (head.labels > 0) & (head.labels <= len(NAMES))
    curve = image[brain].mean(axis=0)
    weight = frames.counted / frames.counted.sum()
    mean = image @ weight
    m = np.sqrt(np.maximum(mean, _LEAST * mean[brain].mean()) / mean[brain].mean())
    a = np.sqrt(np.maximum(curve, 0.02 * curve.max()) / frames.counted)
    late = frames.mid > 20.0
    a = a * percent / 100.0 / np.median((a / np.maximum(curve, 1e-9))[late])
    sigma = SHARED_MM / FWHM / VOXEL
    together = (1.0 - SHARED) + SHARED * (2.0 * np.sqrt(np.pi) * sigma) ** 3
    alone = a / np.maximum(curve, 1e-9) * np.sqrt(together / (brain.sum() / len(NAMES)))
    return Grain(m, a, np.minimum(np.sqrt(share / (1.0 - share)) * alone, 0.2), freedom)
