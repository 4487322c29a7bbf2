"""Effects of the input stage: the tissue sees another curve than the blood record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import torch

from petkin.dynamics import ExponentialSum, Forcing, Parameter, ParameterSet, Shifted
from petkin.effects.effect import Effect
from petkin.effects.forward_model import ForwardModel
from petkin.errors import InputError
from petkin.inputs import dispersed
from petkin.units import SECONDS_PER_MINUTE

#: Straight pieces that stand for the dispersed curve follow it this closely; formulas need none.
_TOLERANCE = 1e-5
#: A rate of the curve nearer than this share to 1/tau cancels in the formula.
_NEAREST_RATE = 1e-3


def _delay(model: ForwardModel, values: Mapping[str, float]) -> ForwardModel:
    return replace(model, input=model.input.delayed(values["delay"] / SECONDS_PER_MINUTE))


def _disperse(model: ForwardModel, values: Mapping[str, float]) -> ForwardModel:
    if values["tau"] < 0:
        raise InputError(f"dispersion={values['tau']:g}: a curve cannot be smeared by less than 0 s.")
    if values["tau"] == 0:
        return model
    tau, end = values["tau"] / SECONDS_PER_MINUTE, float(model.clock.frames.end[-1]) + 1.0
    plasma = _smeared(model.input.plasma, tau, end)
    alike = model.input.whole_blood is model.input.plasma
    whole_blood = plasma if alike else _smeared(model.input.whole_blood, tau, end)
    changed = replace(model.input, plasma=plasma, whole_blood=whole_blood, total_plasma=None, parent_fraction=None)
    return replace(model, input=changed)


def _smeared(forcing: Forcing, tau: float, end: float) -> Forcing:
    if isinstance(forcing, Shifted):
        earlier = float(torch.as_tensor(forcing.delay).detach())
        return Shifted(_smeared(forcing.forcing, tau, end - earlier), forcing.delay)
    if isinstance(forcing, ExponentialSum) and max(forcing.powers) <= 1 and forcing.coefficients.ndim == 1:
        sums = forcing.exponents + 1.0 / tau
        if bool((sums.abs() > _NEAREST_RATE / tau).all()):
            return _smeared_sum(forcing, tau)
    return dispersed(forcing, tau, end=end, tolerance=_TOLERANCE)


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
)

DISPERSION = Effect(
    name="dispersion",
    stage="input",
    parameters=ParameterSet((Parameter("tau", "s", 5.0, 0.0, 12.0, meaning="time constant of the smear"),)),
    meaning="the tissue sees the recorded curve convolved with (1/tau) e^{-t/tau}; one value a scan",
    source="Iida H et al. J Cereb Blood Flow Metab 1986;6:536-545, doi:10.1038/jcbfm.1986.99",
    change=_disperse,
)
