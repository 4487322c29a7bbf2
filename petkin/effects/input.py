"""Effects of the input stage: the tissue sees another curve than the blood record."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from petkin.dynamics import ExponentialSum, Forcing, Parameter, ParameterSet, PiecewiseLinear, Shifted
from petkin.dynamics.arrays import alike, library
from petkin.effects.effect import Effect
from petkin.effects.forward_model import ForwardModel
from petkin.errors import InputError
from petkin.inputs import InputFunction, dispersed
from petkin.inputs.linearise import piecewise_linear
from petkin.units import SECONDS_PER_MINUTE

#: Straight pieces that stand for the dispersed curve follow it this closely; formulas need none.
_TOLERANCE = 1e-5
#: A rate of the curve nearer than this share to 1/tau cancels in the formula.
_NEAREST_RATE = 1e-3
#: Straight pieces this many are taken to follow their smeared curve as closely as they do the curve itself.
_DENSE = 300
#: The longest time constant of a sampling line, s (10 to 12: Iida, see below): no record is smeared by more.
_SLOWEST_LINE = 12.0
#: Rate at which the tissue around a vessel takes up, mL/cm3/min.
_UPTAKE = 0.1
#: How what the parent fraction lacks goes with time: by a half-time of its own, or with the recorded metabolites, which
#: come sooner than recorded, are more, have a steeper course, or are made at a higher rate.
BY_TIME, SOONER, MORE, STEEPER, FASTER = 0.0, 1.0, 2.0, 3.0, 4.0
_AS_RECORDED = (SOONER, MORE, STEEPER, FASTER)
#: The least that a recorded fraction counts as, and the least of its metabolites; one that never falls below has none;
#: the least of late tracer that is left where metabolites come sooner, and the least that a course is raised to.
_LEAST_FRACTION, _LEAST_LOST, _NEXT_TO_ALL, _LEAST_LEFT = 0.02, 1e-6, 0.98, 0.02


def _delay(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    return replace(model, input=model.input.delayed(values["delay"] / SECONDS_PER_MINUTE))


def _disperse(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    tau, end = values["tau"] / SECONDS_PER_MINUTE, _end(model)
    if tau == 0:
        return model
    return _of_all(model, lambda forcing: _smeared(forcing, tau, end))


def _end(model: ForwardModel) -> float:
    return float(model.clock.frames.end[-1]) + 1.0


def _smeared(forcing: Forcing, tau: float, end: float) -> Forcing:
    if isinstance(forcing, Shifted):
        earlier = float(torch.as_tensor(forcing.delay).detach())
        return Shifted(_smeared(forcing.forcing, tau, end - earlier), forcing.delay)
    if tau < 0:
        return _sharpened(straight(forcing, end), -tau)
    if isinstance(forcing, ExponentialSum) and max(forcing.powers) <= 1 and forcing.coefficients.ndim == 1:
        sums = forcing.exponents + 1.0 / tau
        if bool((sums.abs() > _NEAREST_RATE / tau).all()):
            return _smeared_sum(forcing, tau)
    if isinstance(forcing, PiecewiseLinear) and len(forcing.knots) >= _DENSE:
        return PiecewiseLinear(forcing.times, forcing.response(1.0 / tau, forcing.times) / tau)
    return dispersed(forcing, tau, end=end, tolerance=_TOLERANCE)


def _sharpened(curve: PiecewiseLinear, tau: float) -> PiecewiseLinear:
    """u + tau u', what entered where u came out; slopes as parabolas through neighbouring knots have them."""
    times, values = alike(curve.times, curve.values)
    slopes = np.gradient(values, times) if library(values) is np else torch.gradient(values, spacing=(times,))[0]
    return PiecewiseLinear(times, values + tau * slopes)


def straight(forcing: Forcing, end: float) -> PiecewiseLinear:
    """A curve in straight pieces up to `end`: itself where it is, else close to it."""
    if isinstance(forcing, PiecewiseLinear):
        return forcing
    knots = np.asarray(forcing.knots)
    first = np.concatenate([knots[knots < end], np.linspace(float(knots[0]), end, 64)])
    return piecewise_linear(lambda t: np.asarray(forcing(t)), first, tolerance=_TOLERANCE)


def _scale(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    factor = 1.0 + values["scale"]

    def scaled(forcing: Forcing, end: float) -> Forcing:
        if isinstance(forcing, Shifted):
            return Shifted(scaled(forcing.forcing, end - float(forcing.delay)), forcing.delay)
        if isinstance(forcing, ExponentialSum):
            return replace(forcing, coefficients=forcing.coefficients * factor)
        curve = straight(forcing, end)
        values, by = alike(curve.values, factor)
        return replace(curve, values=values * by)

    return _of_all(model, lambda forcing: scaled(forcing, _end(model)))


def _of_all(model: ForwardModel, change: Callable[[Forcing], Forcing]) -> ForwardModel:
    """Plasma, its total and whole blood changed alike."""
    before = model.input
    plasma = change(before.plasma)
    blood = plasma if before.whole_blood is before.plasma else change(before.whole_blood)
    total = None if before.total_plasma is None else change(before.total_plasma)
    return replace(model, input=replace(before, plasma=plasma, whole_blood=blood, total_plasma=total))


def _metabolised(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    """C_P (1 - a h(t)), or C_P / (1 + h(t) a / (1 - a)) where metabolites come sooner: what runs k times as fast, of a
    fraction 1 / (1 + (t / tau)^b), has odds k^b times as large; what is k times as steep has them to the power k. What
    has k times the rate of metabolism, -dP/dt / P, is the fraction to the power k."""
    loss, half, course = values["loss"], values["half_time"], values["course"]
    if not loss <= 1:
        raise InputError(
            f"parent_fraction={loss:g}: no more than all of the tracer can be metabolised; give at most 1."
        )
    if course not in (BY_TIME, *_AS_RECORDED):
        raise InputError(f"parent_fraction: course={course:g}: give 0, 1, 2, 3 or 4.")
    before, end = model.input, _end(model)
    if course != BY_TIME and before.parent_fraction is None:
        raise InputError(f"parent_fraction: course={course:g}: there is no parent fraction in this blood; give 0.")
    fraction = before.parent_fraction or _all_parent(end)
    most = _most_of_metabolites(fraction, course, float(model.clock.frames.end[-1]))

    def kept(forcing: Forcing, fraction: Forcing, end: float) -> Forcing:
        if isinstance(forcing, Shifted):
            early = float(forcing.delay)
            inside = fraction.forcing if isinstance(fraction, Shifted) else Shifted(fraction, -early)
            return Shifted(kept(forcing.forcing, inside, end - early), forcing.delay)
        curve = straight(forcing, end)
        t = curve.times.clip(min=0.0)
        t, share, before, lost, late = alike(t, fraction(t), curve.values, loss, half)
        if course == BY_TIME:
            return PiecewiseLinear(curve.times, before * (1.0 - lost * t**2 / (t**2 + late**2)))
        return PiecewiseLinear(curve.times, before * _left(share, lost, course, most))

    changed = replace(
        before,
        plasma=kept(before.plasma, fraction, end),
        total_plasma=before.total_plasma or before.plasma,
        parent_fraction=kept(_finely(fraction, end), fraction, end),
        parent_fraction_fit=None,
    )
    return replace(model, input=changed)


@lru_cache(maxsize=8)
def _all_parent(end: float) -> Forcing:
    return PiecewiseLinear(np.array([0.0, end]), np.ones(2))


@lru_cache(maxsize=8)
def _finely(fraction: Forcing, end: float) -> Forcing:
    return PiecewiseLinear(t := np.linspace(0.0, end, 512), fraction(t))


@lru_cache(maxsize=32)
def _most_of_metabolites(fraction: Forcing, course: float, end: float) -> float:
    """The largest h of a record until the end of a scan, with its sign."""
    record, delay = (fraction.forcing, float(fraction.delay)) if isinstance(fraction, Shifted) else (fraction, 0.0)
    h = _of_metabolites(record(np.linspace(0.0, end - delay, 512)), course)
    return float(h[abs(h).argmax()]) or 1e-12


def _of_metabolites(fraction: Any, course: float) -> Any:
    """h of a parent fraction P: 1 - P, (1 - P) / P, (1 - P) ln((1 - P) / P), or -ln P."""
    share, odds = _share_and_odds(fraction)
    if course == MORE:
        return odds
    if course == FASTER:
        return -library(share).log(share)
    return (1.0 - share) * (library(odds).log(odds) if course == STEEPER else 1.0)


def _left(fraction: Any, lost: Any, course: float, most: float) -> Any:
    """Part of a parent fraction that is left where its metabolites are others: 1 - a h to first order in a."""
    if course == STEEPER:
        share, odds = _share_and_odds(fraction)
        return 1.0 / (share * (1.0 + odds ** (1.0 + lost / most).clip(min=_LEAST_LEFT)))
    h = _of_metabolites(fraction, course) / most
    if course == FASTER:
        return (1.0 - lost).clip(min=_LEAST_LEFT) ** h
    return 1.0 / (1.0 + lost / (1.0 - lost).clip(min=_LEAST_LEFT) * h) if course == SOONER else 1.0 - lost * h


def _share_and_odds(fraction: Any) -> tuple[Any, Any]:
    """P, kept from 0 and 1, and (1 - P) / P."""
    share = fraction.clip(min=_LEAST_FRACTION, max=1.0 - _LEAST_LOST)
    return share, (1.0 - share) / share


def _with_metabolites(blood: InputFunction) -> tuple[dict[str, float], ...]:
    """Courses that go as the recorded metabolites do, where there are any."""
    fraction = blood.parent_fraction
    if fraction is None or float(fraction(fraction.knots).min()) > _NEXT_TO_ALL:
        return ()
    return tuple({"half_time": 10.0, "course": course} for course in _AS_RECORDED)


def _spilled(model: ForwardModel, values: Mapping[str, Any]) -> ForwardModel:
    """C - m T, T = K e^{-k t} * C the tissue around the vessel."""
    share, washout = values["share"], values["washout"]

    def cleared(forcing: Forcing, end: float) -> Forcing:
        if isinstance(forcing, Shifted):
            return Shifted(cleared(forcing.forcing, end - float(forcing.delay)), forcing.delay)
        curve = straight(forcing, end)
        around = _UPTAKE * curve.response(washout, curve.times)
        recorded, around, share_of_it = alike(curve.values, around, share)
        return replace(curve, values=recorded - share_of_it * around)

    return _of_all(model, lambda forcing: cleared(forcing, _end(model)))


def _smeared_sum(curve: ExponentialSum, tau: float) -> ExponentialSum:
    """b e^{-b s} * curve with b = 1/tau, again a sum of exponentials:

    b e^{-b s} * e^{l s} = b (e^{l s} - e^{-b s}) / q,  b e^{-b s} * s e^{l s} = b s e^{l s} / q - that / q,  q = l + b.
    """
    b, powers = 1.0 / tau, torch.tensor(curve.powers)
    gain = curve.coefficients * b / (curve.exponents + b)
    steady = torch.where(powers == 1, -gain / (curve.exponents + b), gain)
    ramp = powers == 1
    coefficients = torch.cat([gain[ramp], steady, -steady.sum()[None]])
    exponents = torch.cat([curve.exponents[ramp], curve.exponents, torch.full_like(gain[:1], -b)])
    return ExponentialSum(coefficients, exponents, (1,) * int(ramp.sum()) + (0,) * (len(powers) + 1), curve.onset)


ARTERIAL_DELAY = Effect(
    name="arterial_delay",
    stage="input",
    parameters=ParameterSet((Parameter("delay", "s", 5.0, -15.0, 50.0, meaning="time by which the tissue lags"),)),
    meaning="the tissue lags the blood record by `delay`, in plasma and whole blood alike; one value a scan",
    source="Iida H et al. J Cereb Blood Flow Metab 1988;8:285-288 (delay between sampling site and tissue)",
    change=_delay,
    split_by="the clocks of scanner and blood counter, or early frames of 5 s or less over a vessel",
)

DISPERSION = Effect(
    name="dispersion",
    stage="input",
    parameters=ParameterSet(
        (Parameter("tau", "s", 5.0, -_SLOWEST_LINE, _SLOWEST_LINE, meaning="time constant of the smear"),)
    ),
    meaning="the tissue sees the recorded curve convolved with (1/tau) e^{-t/tau}, or (< 0) the record is so convolved",
    source="Iida H et al. J Cereb Blood Flow Metab 1986;6:536-545, doi:10.1038/jcbfm.1986.99",
    change=_disperse,
    split_by="a step of activity passed through the sampling line, or a vessel in early frames of 5 s or less",
    least=-_SLOWEST_LINE,
)

PARENT_FRACTION = Effect(
    name="parent_fraction",
    stage="input",
    parameters=ParameterSet(
        (
            Parameter(
                "loss", "1", 0.3, -0.5, 0.95, meaning="share by which late plasma holds less tracer than recorded"
            ),
            Parameter("half_time", "min", 10.0, 1.0, 60.0, meaning="when half of that is lost, of course 0"),
            Parameter(
                "course",
                "1",
                BY_TIME,
                BY_TIME,
                FASTER,
                meaning="0: by half_time; metabolites come 1: sooner, 2: to more, 3: more steeply, 4: at a higher rate",
            ),
        )
    ),
    meaning="less (> 0) of the plasma is unchanged tracer than recorded, or more: C_P (1 - a h), "
    "h = t^2 / (t^2 + t50^2), or (1 - P) / P of the recorded fraction P (course 2); or these odds change by a factor "
    "(course 1) or a power (course 3), or the fraction by a power (course 4)",
    source="Tonietto M et al. J Cereb Blood Flow Metab 2016;36:326-339, doi:10.1177/0271678X15610585",
    change=_metabolised,
    split_by="parent fraction measured in more samples, or a second measurement of them",
    grid={"half_time": (3.0, 8.0, 20.0)},
    besides=_with_metabolites,
    trust=0.1,
)

INPUT_SCALE = Effect(
    name="input_scale",
    stage="input",
    parameters=ParameterSet(
        (Parameter("scale", "1", 0.05, -0.1, 0.1, meaning="by which blood is larger than recorded"),)
    ),
    meaning="scanner and blood counter disagree: true blood is larger (> 0) than recorded by a factor",
    source="cross-calibration within 5 %, accreditation within 10 %",
    change=_scale,
    split_by="a phantom measured in scanner and blood counter, or blood beside a late venous region",
)

INPUT_PARTIAL_VOLUME = Effect(
    name="input_partial_volume",
    stage="input",
    parameters=ParameterSet(
        (
            Parameter("share", "1", 0.1, -0.1, 0.5, meaning="of the tissue around it in the record"),
            Parameter("washout", "min^-1", 0.1, 0.005, 0.5, meaning="rate at which that tissue lets go"),
        )
    ),
    meaning="the recorded input holds a share of the tissue around the vessel: C - a T, T = 0.1 e^{-k t} * C",
    source="Zanotti-Fregonara P et al. J Cereb Blood Flow Metab 2011;31:1986-1998 (image-derived input)",
    change=_spilled,
    split_by="a few blood samples late in the scan",
    grid={"washout": (0.02, 0.1)},
)
