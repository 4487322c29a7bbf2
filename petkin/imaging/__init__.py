"""Imaging: frames, decay, point spread, counting noise."""

from petkin.imaging.decay import NUCLIDES, Nuclide, decay_constant, half_life, nuclide
from petkin.imaging.frames import FrameObservation, FrameSchedule
from petkin.imaging.noise import CountingNoise, reference_frame
from petkin.imaging.point_spread import FWHM_PER_SIGMA, blur, gaussian_kernel
from petkin.imaging.schedules import SCHEDULES, frame_schedule, in_seconds, parse_schedule

__all__ = [
    "FWHM_PER_SIGMA",
    "NUCLIDES",
    "SCHEDULES",
    "CountingNoise",
    "FrameObservation",
    "FrameSchedule",
    "Nuclide",
    "blur",
    "decay_constant",
    "frame_schedule",
    "gaussian_kernel",
    "half_life",
    "in_seconds",
    "nuclide",
    "parse_schedule",
    "reference_frame",
]
