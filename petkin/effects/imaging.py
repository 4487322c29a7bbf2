"""Effects of the imaging stage: what the scanner makes of the regions' values. x is what it should show."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import Parameter, ParameterSet
from petkin.effects.effect import REGION, Change, Effect, placed
from petkin.effects.forward_model import Distortion, ForwardModel, highest, peak
from petkin.effects.responses import alike
from petkin.errors import InputError
from petkin.imaging import WAYS, FrameObservation, Motion

Array = NDArray[np.float64]
_SHARE = "share of the value that comes from what lies beside"


def after(clock: FrameObservation, onset: float) -> Array:
    """Share of every frame that lies after the onset (K,)."""
    frames = clock.frames
    return np.clip((frames.end - onset) / frames.duration, 0.0, 1.0)


def _distorting(build: Callable[[ForwardModel, Mapping[str, Any]], Distortion]) -> Change:
    """The change that adds one distortion to the camera."""

    def change(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
        camera = replace(model.imaging, distortions=(*model.imaging.distortions, build(model, values)))
        return replace(model, imaging=camera)

    return change


def _around(x: Any, beside: int) -> Any:
    """What lies beside each region (..., regions, frames): one of them, or the mean of the others, as of that one."""
    count = x.shape[-2]
    others, one = (x.sum(axis=-2)[..., None, :] - x) / max(count - 1, 1), beside - 1
    if one < 0:
        return others
    itself = alike(np.arange(count)[:, None] == one, x)
    return others * itself + x[..., one : one + 1, :] * ~itself


def _factor(change: Any, x: Any) -> Any:
    """1 + change, by frame or by region and frame."""
    return alike(1.0 + np.asarray(change), x)


def _by_region(model: ForwardModel, values: Mapping[str, Any], symbol: str) -> Array:
    return np.asarray(placed(model, values, symbol))[..., None]


def _mixing(course: Callable[[FrameObservation, Mapping[str, Any]], Array | float]) -> Change:
    """The change that mixes each region with what lies beside, by a share that follows a course over the frames."""

    def build(model: ForwardModel, values: Mapping[str, Any]) -> Distortion:
        share, beside, count = _by_region(model, values, "share"), values["beside"], len(model.regions)
        if beside not in range(count + 1):
            raise InputError(f"beside={beside:g}: there are regions 1 to {count}; 0 is the mean of the others.")
        return lambda x, clock: x + (_around(x, int(beside)) - x) * alike(share * course(clock, values), x)

    return _distorting(build)


def _moving(course: Callable[[FrameObservation, Mapping[str, Any]], tuple[Array, Array]]) -> Change:
    """The change that moves the picture, by a course over the frames of how far and of the share of the frame."""

    def change(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
        way = values["axis"]
        if way not in range(WAYS):
            raise InputError(f"axis={way:g}: 0, 1, 2 move along that axis of the image, 3, 4, 5 turn in a plane.")

        def motion(clock: FrameObservation) -> Motion:
            return Motion(int(way), *course(clock, values))

        camera = replace(model.imaging, motions=(*model.imaging.motions, motion))
        return replace(model, imaging=camera)

    return change


def _blurred(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    camera = replace(model.imaging, point_spread=math.hypot(model.imaging.point_spread, values["fwhm"]))
    return replace(model, imaging=camera)


def _passed(clock: FrameObservation) -> Array:
    """Share of the scan that has passed in the middle of every frame (K,)."""
    return clock.frames.mid / clock.frames.end[-1]


def _of_every_frame(clock: FrameObservation) -> Array:
    return np.ones(len(clock.frames))


def _attenuated(model: ForwardModel, values: Mapping[str, Any]) -> Distortion:
    gain = _by_region(model, values, "gain")
    return lambda x, clock: x * _factor(gain * after(clock, values["onset"]), x)


def _scattered(_: ForwardModel, values: Mapping[str, Any]) -> Distortion:
    return lambda x, clock: x + float(values["share"]) * x.mean(axis=-2)[..., None, :]


def _offset(_: ForwardModel, values: Mapping[str, Any]) -> Distortion:
    def distort(x: Any, clock: FrameObservation) -> Any:
        growth = np.exp(clock.decay * (clock.frames.mid - clock.frames.end[-1]))
        return x + alike(float(values["share"]) * peak(x) * growth, x)

    return distort


def _dead(_: ForwardModel, values: Mapping[str, Any]) -> Distortion:
    def distort(x: Any, clock: FrameObservation) -> Any:
        rate = x.mean(axis=-2)[..., None, :] * alike(np.exp(-clock.decay * clock.frames.mid), x)
        return x * (1.0 - float(values["loss"]) * rate / alike(highest(rate), x))

    return distort


def _drifting(_: ForwardModel, values: Mapping[str, Any]) -> Distortion:
    return lambda x, clock: x * _factor(values["gain"] * _passed(clock), x)


def _stepping(_: ForwardModel, values: Mapping[str, Any]) -> Distortion:
    return lambda x, clock: x * _factor(values["gain"] * after(clock, values["onset"]), x)


def _share(start: float, top: float, meaning: str, low: float = 0.0) -> Parameter:
    return Parameter("share", "1", start, low, top, meaning=meaning)


def _told(model: ForwardModel) -> bool:
    """Whether a picture tells what motion brings into regions."""
    return model.imaging.moves is not None


def _several(model: ForwardModel) -> bool:
    return len(model.regions) > 1


_ONSET = Parameter("onset", "min", 30.0, 0.0, 600.0, meaning="when it sets in")
_TRACKER = "the head tracker's record"
_BEFORE_AND_AFTER = _TRACKER + ", or images reconstructed before and after the onset"
_GEOMETRY = "a segmentation from magnetic resonance and the scanner's point spread"

_EVERYWHERE = replace(REGION, start=0.0)
_BESIDE = replace(
    REGION, symbol="beside", start=0.0, meaning="number of the region that lies beside; 0 is the others' mean"
)
_GAIN = Parameter("gain", "1", 0.05, -0.3, 0.3, meaning="relative change of a region's values")
_MOVED = Parameter("moved", "mm", 3.0, -10.0, 10.0, meaning="how far the head moves, or its rim where it turns")
_AXIS = Parameter("axis", "1", 0.0, 0.0, WAYS - 1.0, meaning="0 to 2: along x, y, z; 3 to 5: turned in xy, xz, yz")

BLUR = Effect(
    name="partial_volume",
    stage="imaging",
    parameters=ParameterSet((Parameter("fwhm", "mm", 5.0, 0.0, 15.0, meaning="full width at half maximum"),)),
    meaning="the picture is less sharp than the scanner's point spread has it",
    source="2.5 to 7 mm of scanners and reconstructions; Cysouw MCF et al. EJNMMI Res 2019",
    change=_blurred,
    split_by=_GEOMETRY,
    suits=lambda model: False,
)
MOTION = Effect(
    name="motion_step",
    stage="imaging",
    parameters=ParameterSet((_MOVED, _ONSET, _AXIS)),
    meaning="the head moves once, at `onset`: what lies beside a region enters it on one side, and leaves on another",
    source="Jin X et al. Phys Med Biol 2013: 2 to 20 mm",
    change=_moving(lambda clock, v: (v["moved"] * _of_every_frame(clock), after(clock, v["onset"]))),
    folded=True,
    split_by=_BEFORE_AND_AFTER,
    suits=_told,
)
SLOW_MOTION = Effect(
    name="motion_drift",
    stage="imaging",
    parameters=ParameterSet((_MOVED, _AXIS)),
    meaning="the head drifts: it moves evenly over the scan, so far by its end",
    source="1 to 5 mm an hour",
    change=_moving(lambda clock, v: (v["moved"] * _passed(clock), _of_every_frame(clock))),
    folded=True,
    split_by=_TRACKER,
    suits=_told,
)
PARTIAL_VOLUME = Effect(
    name="partial_volume",
    stage="imaging",
    parameters=ParameterSet((_share(0.1, 0.3, _SHARE), _BESIDE, _EVERYWHERE)),
    meaning="regions hold a share of what lies beside them, the same in every frame",
    source="Rousset OG et al. J Nucl Med 1998;39:904-911 (mixing of regions); shares up to 0.3 (small structures)",
    change=_mixing(lambda clock, v: 1.0),
    split_by=_GEOMETRY,
    regional=("share",),
    suits=_several,
    imaged=BLUR,
)
MOTION_STEP = Effect(
    name="motion_step",
    stage="imaging",
    parameters=ParameterSet((_share(0.1, 0.3, _SHARE), _ONSET, _BESIDE, _EVERYWHERE)),
    meaning="the head moves once: from `onset` on, regions hold a share of what lies beside them",
    source="Jin X et al. Phys Med Biol 2013, motion of 5 mm: 5 to 10 % in regions",
    change=_mixing(lambda clock, v: after(clock, v["onset"])),
    split_by=_BEFORE_AND_AFTER,
    regional=("share",),
    suits=_several,
    imaged=MOTION,
)
MOTION_DRIFT = Effect(
    name="motion_drift",
    stage="imaging",
    parameters=ParameterSet((_share(0.1, 0.3, _SHARE + " at the end"), _BESIDE, _EVERYWHERE)),
    meaning="the head drifts: the share of what lies beside a region grows linearly over the scan",
    source="range as motion_step",
    change=_mixing(lambda clock, v: _passed(clock)),
    split_by=_TRACKER,
    regional=("share",),
    suits=_several,
    imaged=SLOW_MOTION,
)
ATTENUATION_MISMATCH = Effect(
    name="attenuation_mismatch",
    stage="imaging",
    parameters=ParameterSet((_GAIN, _ONSET, REGION)),
    meaning="from `onset` on the attenuation map no longer fits: values of some regions change by a factor",
    source="McCord ME et al. J Nucl Med 1992;33:1209-1214: up to 30 % at 2 cm",
    change=_distorting(_attenuated),
    split_by="a second transmission or CT scan after the onset",
    regional=("gain",),
    suits=_several,
)
SCATTER_BACKGROUND = Effect(
    name="scatter_background",
    stage="imaging",
    parameters=ParameterSet((_share(0.03, 0.15, "share of the mean over regions that is added to each", -0.05),)),
    meaning="scatter that was not taken out adds a share of the mean over all regions to each of them",
    source="5 to 15 % without correction; below 5 % after it",
    change=_distorting(_scattered),
    split_by="a region without tracer, or the scatter estimate of the reconstruction",
    suits=_several,
)
RANDOMS_OFFSET = Effect(
    name="randoms_offset",
    stage="imaging",
    parameters=ParameterSet(
        (_share(0.02, 0.05, "offset in the last frame as a share of the highest mean over regions", -0.05),)
    ),
    meaning="a constant background that decay correction lets grow is added to every region",
    source="0 to 3 % of the peak; 5 % taken as the bound",
    change=_distorting(_offset),
    split_by="the scanner's singles and randoms rates, or air outside the head",
)
DEAD_TIME = Effect(
    name="dead_time",
    stage="imaging",
    parameters=ParameterSet((Parameter("loss", "1", 0.05, 0.0, 0.3, meaning="share lost at the highest count rate"),)),
    meaning="the scanner loses counts in proportion to the count rate",
    source="residual errors up to 5 % after correction, factors 1.1 to 2.5 before it",
    change=_distorting(_dead),
    split_by="the scanner's singles rates",
)
GAIN_DRIFT = Effect(
    name="gain_drift",
    stage="imaging",
    parameters=ParameterSet((Parameter("gain", "1", 0.03, -0.05, 0.05, meaning="relative excess at the end"),)),
    meaning="the scanner's sensitivity drifts: values are too large by a share that grows linearly; > 0: too large",
    source="daily quality control: 1 to 3 %",
    change=_distorting(_drifting),
    split_by="a phantom of long half-life scanned over the same time",
)
GAIN_STEP = Effect(
    name="gain_step",
    stage="imaging",
    parameters=ParameterSet(
        (Parameter("gain", "1", 0.05, -0.1, 0.1, meaning="relative excess from the onset on"), _ONSET)
    ),
    meaning="from `onset` on all values are too large (> 0) or too small by a factor",
    source="1 to 5 % between bed positions or scans",
    change=_distorting(_stepping),
    split_by="a phantom scanned before and after, or the scanner's log",
)
