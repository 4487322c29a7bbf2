"""Imaging: frames, decay, point spread, counting noise."""

from petkin.imaging.frames import FrameObservation, FrameSchedule

__all__ = ["FrameObservation", "FrameSchedule"]
