"""Imaging: frames, decay, point spread and its correction, motion, counting noise, denoising."""

from petkin.imaging.decay import NUCLIDES, Nuclide, decay_constant, half_life, nuclide
from petkin.imaging.frames import FrameObservation, FrameSchedule
from petkin.imaging.hypr import composite_image, hypr_lr
from petkin.imaging.motion import PLANES, WAYS, Exchange, Leg, Motion, middle_and_rim, moved, origin, origins
from petkin.imaging.noise import CountingNoise, reference_frame
from petkin.imaging.point_spread import FWHM_PER_SIGMA, blur, gaussian_kernel
from petkin.imaging.schedules import SCHEDULES, frame_schedule, in_seconds, parse_schedule
from petkin.imaging.transfer_matrix import TransferMatrix, background_rim, transfer_matrix

__all__ = [
    "FWHM_PER_SIGMA",
    "NUCLIDES",
    "PLANES",
    "SCHEDULES",
    "WAYS",
    "CountingNoise",
    "Exchange",
    "FrameObservation",
    "FrameSchedule",
    "Leg",
    "Motion",
    "Nuclide",
    "TransferMatrix",
    "background_rim",
    "blur",
    "composite_image",
    "decay_constant",
    "frame_schedule",
    "gaussian_kernel",
    "half_life",
    "hypr_lr",
    "in_seconds",
    "middle_and_rim",
    "moved",
    "nuclide",
    "origin",
    "origins",
    "parse_schedule",
    "reference_frame",
    "transfer_matrix",
]
