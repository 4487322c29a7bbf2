"""Noise of a scan: counts, with a share common to each frame or with heavy tails."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.subject import Frames

Array = NDArray[np.float64]

#: Kind -> share common to a frame, degrees of freedom of Student's t (0: normal).
KINDS: dict[str, tuple[float, int]] = {
    "iid": (0.0, 0),
    "common 0.3": (0.3, 0),
    "common 0.6": (0.6, 0),
    "heavy": (0.0, 4),
}
_LATE = 20.0


@dataclass(frozen=True)
class NoiseLaw:
    """sd (R, K) and the share common to a frame."""

    sd: Array
    share: float

    def whiten(self, values: Array) -> Array:
        """(..., R, K) in units of the noise, flattened to (..., R K)."""
        count = len(self.sd)
        every = np.full((count, count), 1.0 / count)
        root = (np.eye(count) - every) / np.sqrt(1 - self.share) + every / np.sqrt(1 + (count - 1) * self.share)
        return np.einsum("rs,...sk->...rk", root, values / self.sd).reshape(*values.shape[:-2], -1)


def law(values: Array, frames: Frames, percent: float, share: float, noisiness: Array | float = 1.0) -> NoiseLaw:
    """Of counts, so large that late values scatter by so many percent in each region's median; noisier ones more."""
    shape = np.sqrt(np.maximum(values, 0.02 * values.max(axis=1, keepdims=True)) / frames.counted)
    late = frames.mid > _LATE
    size = noisiness * percent / 100.0 / np.median(shape[:, late] / values[:, late], axis=1)
    return NoiseLaw(size[:, None] * shape, share)


def noisy(values: Array, noise: NoiseLaw, freedom: int, rng: np.random.Generator) -> Array:
    """One draw."""

    def unit(shape: tuple[int, ...]) -> Array:
        if not freedom:
            return rng.standard_normal(shape)
        return rng.standard_t(freedom, shape) * np.sqrt((freedom - 2) / freedom)

    alone, common = unit(values.shape), unit((values.shape[1],))
    return values + noise.sd * (np.sqrt(1 - noise.share) * alone + np.sqrt(noise.share) * common)
