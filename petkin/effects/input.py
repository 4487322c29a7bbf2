"""Effects of the input stage: the tissue sees another curve than the blood record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from petkin.dynamics import Forcing, Parameter, ParameterSet
from petkin.effects.effect import Effect
from petkin.effects.forward_model import ForwardModel
from petkin.errors import InputError
from petkin.inputs import dispersed
from petkin.units import SECONDS_PER_MINUTE

#: Straight pieces that stand for the dispersed curve follow it to this share of its peak.
_TOLERANCE = 1e-6


def _delay(model: ForwardModel, values: Mapping[str, float]) -> ForwardModel:
    return replace(model, input=model.input.delayed(values["delay"] / SECONDS_PER_MINUTE))


def _disperse(model: ForwardModel, values: Mapping[str, float]) -> ForwardModel:
    if values["tau"] < 0:
        raise InputError(f"dispersion={values['tau']:g}: a curve cannot be smeared by less than 0 s.")
    if values["tau"] == 0:
        return model
    tau, end = values["tau"] / SECONDS_PER_MINUTE, float(model.clock.frames.end[-1]) + 1.0

    def smeared(forcing: Forcing) -> Forcing:
        return dispersed(forcing, tau, end=end, tolerance=_TOLERANCE)

    plasma = smeared(model.input.plasma)
    alike = model.input.whole_blood is model.input.plasma
    whole_blood = plasma if alike else smeared(model.input.whole_blood)
    changed = replace(model.input, plasma=plasma, whole_blood=whole_blood, total_plasma=None, parent_fraction=None)
    return replace(model, input=changed)


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
