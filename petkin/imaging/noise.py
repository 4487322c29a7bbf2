"""Counting-like noise of frame values: variance after Poisson counts, a share of it common to a whole frame.

A frame of duration d_k counts N_k = c x_k d_k / g_k events for the value x_k that it reports, and reports it with

    var(x_k) = alpha^2 max(x_k, floor) g_k / d_k,      g_k = d_k / int_k e^{-lambda t} dt  (decay-corrected),
                                                       g_k = 1                             (not corrected),

so that g_k is e^{lambda t} at the frame's own effective time. Reconstruction, normalisation and motion add errors that
all voxels of a frame share; a fraction s of the variance is therefore common to the frame:

    x_ik + sd_ik (sqrt(s) z_k + sqrt(1 - s) e_ik),     z_k, e_ik standard normal.

References: Pajevic S et al. Noise characteristics of 3-D and 2-D PET images. IEEE Trans Med Imaging 1998;17:9-23.
doi:10.1109/42.668691. Wu Y, Carson RE. Noise reduction in the simplified reference tissue model for neuroreceptor
functional imaging. J Cereb Blood Flow Metab 2002;22:1440-1452. doi:10.1097/01.WCB.0000033967.83623.34 (variance law).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.imaging.frames import FrameObservation
from petkin.imaging.point_spread import blur, gaussian_kernel

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class CountingNoise:
    """How noisy frame values are.

    Args:
        percent: sd in percent of `reference`, in the frame that holds the middle of the scan; 0 is no noise.
        reference: value that `percent` speaks of (kBq/mL), usually the mean over the object in that frame.
        floor_share: `floor` of the variance law as a share of `reference`: empty voxels are noisy too.
        common_share: fraction s of the variance that all voxels of a frame share, 0 to 1.
        correlation: FWHM (mm) of the spatial correlation of e_ik; 0 is white.
        flatness: f in sd = (counting law)^(1 - f) (sd of the reference)^f; 1 is the same sd everywhere.
        bias: mean excess that a reconstruction without negative values leaves in the noisiest frame, as a share of the
            highest mean over the regions; in other frames it goes with var / value.
    """

    percent: float
    reference: float = 1.0
    floor_share: float = 0.05
    common_share: float = 0.0
    correlation: float = 0.0
    flatness: float = 0.0
    bias: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.percent) and self.percent >= 0):
            raise InputError(f"Noise of {self.percent:g} percent cannot be; give 0 or more.")
        if not 0 <= self.common_share <= 1:
            raise InputError(f"The frame-common share of the noise is {self.common_share:g}; it must lie in 0 to 1.")
        if self.correlation < 0:
            raise InputError(f"The noise correlation is {self.correlation:g} mm; it must not be negative.")
        if self.percent > 0 and not self.reference > 0:
            raise InputError(f"Noise in percent needs a reference above 0 kBq/mL; the object holds {self.reference:g}.")

    def standard_deviation(
        self, values: Float[NDArray, "*b frames"], observation: FrameObservation
    ) -> Float[NDArray, "*b frames"]:
        """sd of frame values, kBq/mL, for noise-free `values` (kBq/mL)."""
        return self.of_values(values) * self.of_frames(observation)

    def of_frames(self, observation: FrameObservation) -> Float[NDArray, " frames"]:
        """The frame's factor of the sd, alpha sqrt(g_k / d_k), (kBq/mL)^(1/2)."""
        counts = _counts_per_value(observation)
        flat = 0.01 * self.percent * math.sqrt(self.reference)
        return flat * np.sqrt(counts[reference_frame(observation)] / counts) ** (1.0 - self.flatness)

    def of_values(self, values: Float[NDArray, "*b"]) -> Float[NDArray, "*b"]:
        """The value's factor of the sd, sqrt(max(x, floor)), (kBq/mL)^(1/2)."""
        counted = np.sqrt(np.maximum(values, self.floor_share * self.reference))
        return counted ** (1.0 - self.flatness) * math.sqrt(self.reference) ** self.flatness

    def excess(self, observation: FrameObservation) -> Float[NDArray, " frames"]:
        """Mean excess of every frame as a share of the highest regional mean."""
        per_value = 1.0 / _counts_per_value(observation)
        return self.bias * per_value / per_value.max()

    def frame_common(self, rng: np.random.Generator, frames: int) -> Float[NDArray, " frames"]:
        """sqrt(s) z_k of every frame."""
        return math.sqrt(self.common_share) * rng.standard_normal(frames)

    def voxel_part(
        self, rng: np.random.Generator, shape: tuple[int, ...], voxel_size: Sequence[float] = ()
    ) -> NDArray[np.floating]:
        """sqrt(1 - s) e_ik of one frame: white, or correlated in space (round the grid, so that no edge is quieter)."""
        white: NDArray[np.floating] = rng.standard_normal(shape)
        if self.correlation > 0:
            white = _correlate(white, self.correlation, voxel_size)
        return math.sqrt(1.0 - self.common_share) * white

    def sample(
        self, values: Float[NDArray, "*b frames"], observation: FrameObservation, rng: np.random.Generator
    ) -> Float[NDArray, "*b frames"]:
        """Noisy copies of frame values (regions or voxels, white in space), kBq/mL."""
        if self.percent == 0:
            return values
        unit = self.frame_common(rng, values.shape[-1]) + self.voxel_part(rng, values.shape)
        return values + self.standard_deviation(values, observation) * unit


def reference_frame(observation: FrameObservation) -> int:
    """Index of the frame that holds the middle of the scan, or is nearest to it."""
    frames = observation.frames
    middle = 0.5 * (frames.start[0] + frames.end[-1])
    return int(np.argmin(np.maximum(frames.start - middle, 0) + np.maximum(middle - frames.end, 0)))


def _counts_per_value(observation: FrameObservation) -> NDArray[np.floating]:
    """d_k / g_k, min."""
    if observation.corrected:
        return observation.mean_decay_times_duration
    return observation.frames.duration


def _correlate(white: NDArray[np.floating], fwhm: float, voxel_size: Sequence[float]) -> NDArray[np.floating]:
    axes = [axis for axis, voxel in enumerate(voxel_size) if white.shape[axis] > 1 and voxel > 0]
    pad = [(0, 0)] * white.ndim
    for axis in axes:
        reach = gaussian_kernel(fwhm, voxel_size[axis]).size // 2
        pad[axis] = (reach, reach)
    inner = tuple(slice(p, p + n) for (p, _), n in zip(pad, white.shape))
    smooth = blur(np.pad(white, pad, mode="wrap"), fwhm, voxel_size)[inner]
    power = math.prod(float((gaussian_kernel(fwhm, voxel_size[axis]) ** 2).sum()) for axis in axes)
    return smooth / math.sqrt(power)
