"""Effects of the clock stage: frames that lay elsewhere than stated, and decay corrected by the wrong amount."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import Parameter, ParameterSet
from petkin.effects.effect import Change, Effect
from petkin.effects.forward_model import ForwardModel
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.units import SECONDS_PER_MINUTE

Array = NDArray[np.float64]


def _times(clock: FrameObservation, factor: Array | float) -> FrameObservation:
    return replace(clock, gain=clock.gain_or_one * factor)


def grown(clock: FrameObservation, rate: float) -> Array:
    """Decay-weighted mean of e^{rate t} over every frame (K,): what a wrong correction leaves of a constant."""
    area = FrameObservation(clock.frames, clock.decay).mean_decay_times_duration
    return FrameObservation(clock.frames, clock.decay - rate).mean_decay_times_duration / area


def _shifted(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    clock, late = model.clock, values["offset"] / SECONDS_PER_MINUTE
    true = FrameSchedule(clock.frames.start + late, clock.frames.end + late, where=clock.frames.where)
    late_clock = replace(clock, frames=true)
    return replace(model, clock=_times(late_clock, math.exp(-clock.decay * late) if clock.corrected else 1.0))


def _misjudged(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    factor = np.ones(len(model.clock.frames))
    at = int(min(max(values["frame"], 0), len(factor) - 1))
    factor[at] += values["gain"]
    if at + 1 < len(factor):
        factor[at + 1] -= values["edge"] * values["gain"] * model.clock.divisor[at] / model.clock.divisor[at + 1]
    return replace(model, clock=_times(model.clock, factor))


def _sampled(model: ForwardModel, _: Mapping[str, Any]) -> ForwardModel:
    return replace(model, clock=replace(model.clock, mid_frame=True))


def _decaying(excess: float) -> Change:
    """The change that leaves e^{excess lambda t}."""

    def change(model: ForwardModel, _: Mapping[str, Any]) -> ForwardModel:
        return replace(model, clock=_times(model.clock, grown(model.clock, excess * model.clock.decay)))

    return change


def _slower(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    return replace(model, clock=_times(model.clock, grown(model.clock, values["error"] * model.clock.decay)))


def _decays(model: ForwardModel) -> bool:
    return model.clock.decay > 0


_FLAG = ParameterSet((Parameter("flag", "flag", 1.0, 0.0, 1.0, meaning="there or not"),))
_HEADER = "the sidecar's decay factors, or a region of known activity"

FRAME_OFFSET = Effect(
    name="frame_offset",
    stage="clock",
    parameters=ParameterSet((Parameter("offset", "s", 5.0, -20.0, 20.0, meaning="by which frames truly are later"),)),
    meaning="the scanner's clock is off: the true frames are later (> 0) than stated",
    source="1 to 20 s between the clocks of injection and scan",
    change=_shifted,
    split_by="the clocks of scanner and blood counter read side by side",
)
FRAME_DURATION = Effect(
    name="frame_duration",
    stage="clock",
    parameters=ParameterSet(
        (
            Parameter("gain", "1", 0.1, -0.5, 0.5, meaning="relative excess of the frame's value"),
            Parameter("frame", "1", 10.0, 0.0, 999.0, meaning="number of the frame, from 0"),
            Parameter("edge", "1", 0.0, 0.0, 1.0, meaning="share of its excess counts that the next frame lacks"),
        )
    ),
    meaning="one frame was divided by a wrong duration: its values are too large (> 0) or too small in all regions; "
    "or its end slipped (edge 1), and the next frame lacks the counts that it has too many",
    source="header slips; any size",
    change=_misjudged,
    split_by="the list-mode record of the frame",
)
MID_FRAME_SAMPLING = Effect(
    name="mid_frame_sampling",
    stage="clock",
    parameters=_FLAG,
    meaning="values are those at mid-frame, not means over the frame",
    source="Haggstrom I et al. 2015 (frames above 15 s at the peak)",
    change=_sampled,
    split_by="the program that made the curves",
    flag=True,
)
HALF_LIFE_ERROR = Effect(
    name="half_life_error",
    stage="clock",
    parameters=ParameterSet((Parameter("error", "1", 0.02, -0.05, 0.05, meaning="relative error of lambda"),)),
    meaning="decay was corrected with a wrong half-life: the correction grows too fast (> 0) or too slowly",
    source="rounded half-lives: 0.1 to 2 %",
    change=_slower,
    split_by=_HEADER,
    suits=_decays,
)
MEAN_LIFE_SWAP = Effect(
    name="mean_life_swap",
    stage="clock",
    parameters=_FLAG,
    meaning="the half-life was taken for the mean life: curves carry e^{lambda t (1/ln 2 - 1)} too much",
    source="e^{-t/T} where e^{-t ln2 / T} is due; arXiv 2403.08194 has it",
    change=_decaying(1.0 / math.log(2.0) - 1.0),
    split_by=_HEADER,
    flag=True,
    suits=_decays,
)
DECAY_APPLIED_TWICE = Effect(
    name="decay_applied_twice",
    stage="clock",
    parameters=_FLAG,
    meaning="decay was corrected twice: curves carry e^{lambda t} too much",
    source="files whose state of correction is misread",
    change=_decaying(1.0),
    split_by=_HEADER,
    flag=True,
    suits=_decays,
)
DECAY_NOT_APPLIED = Effect(
    name="decay_not_applied",
    stage="clock",
    parameters=_FLAG,
    meaning="decay was not corrected: curves lack e^{lambda t}",
    source="files whose state of correction is misread",
    change=_decaying(-1.0),
    split_by=_HEADER,
    flag=True,
    suits=_decays,
)
