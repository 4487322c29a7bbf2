"""Imaging: frames, decay, point spread, counting noise."""

from petkin.imaging.decay import NUCLIDES, decay_constant, half_life
from petkin.imaging.frames import FrameObservation, FrameSchedule

__all__ = ["NUCLIDES", "FrameObservation", "FrameSchedule", "decay_constant", "half_life"]
